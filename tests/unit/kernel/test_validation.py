"""Arguments that the kernel refuses, and the messages."""

import math
from typing import Any

import numpy as np
import pytest
from kernel_runs import Model, run_line
from tables import for_each

from kernel import line
from kernel.params import Cell, KernelInputError, Line

ONE = np.ones(3)


def call(**changed: Any) -> Line:
    cells = {"gamma": 1.5 * ONE, "omega": 0.5 * ONE, "xi": 0.26 * ONE}
    model = Model.SOFT if "penetration" in changed else Model.RIGID
    plate = {"model": model, "restitution": 0.0 * ONE, "penetration": 1e-3 * ONE, "adhesive": True}
    arguments = cells | plate | {"carry": False, "settle": 2, "observe": 3, "keep": 4} | changed
    return run_line(*[arguments.pop(name) for name in cells], **arguments)


ARRAYS = ("gamma", "omega", "xi", "restitution", "penetration")


@for_each("name", ARRAYS)
@for_each("bad", [math.nan, math.inf, -math.inf, -1.0, -1e-300])
def test_numbers_outside_their_range(name, bad):
    array = ONE.copy()
    array[1] = bad
    with pytest.raises(KernelInputError, match=rf"^{name}: .*got {bad}.* at index 1$") as refused:
        call(**{name: array})
    assert refused.value.argument == name
    assert isinstance(refused.value, ValueError)


@for_each("name", ARRAYS)
@for_each(("bad", "why"), [
    (ONE.astype(np.float32), "float64 array, got float32"),
    ([1.0, 1.0, 1.0], "float64 array, got list"),
    (1.5, "float64 array, got float"),
    (np.array(1.5), "shape"),
    (np.ones(4), "shape"),
])  # fmt: skip
def test_arrays_of_another_kind_or_shape(name, bad, why):
    with pytest.raises(KernelInputError, match=why) as refused:
        call(**{name: bad})
    # a gamma of another length makes the next array the odd one
    assert refused.value.argument == name or (name == "gamma" and refused.value.argument == "omega")


@for_each("bad", ["soft", None, Cell(1.0, 1.0, 0.0)])
def test_plates_of_an_unknown_type(bad):
    with pytest.raises(KernelInputError, match=rf"^plate: .*not a {type(bad).__name__}$") as refused:
        line.run_line(1.5 * ONE, ONE, ONE, plate=bad, carry=False, settle=2, observe=3, keep=4)
    assert refused.value.argument == "plate"


@for_each("name", ["gamma", "omega", "xi", "penetration"])
@for_each("bad", [1.1e30, 1e300, 0.9e-30, 5e-324])
def test_numbers_whose_products_overflow(name, bad):
    with pytest.raises(KernelInputError) as refused:
        call(**{name: bad * ONE})
    rule = f"must lie within 1e-30 and 1e30{', or be 0' if name == 'xi' else ''}"
    assert str(refused.value) == f"{name}: {rule}, got {bad} at index 0"
