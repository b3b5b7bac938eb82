"""Axes by themselves: which numbers, lists and ranges are accepted, to the last one, and their values."""

from typing import Annotated, Any

import numpy as np
import pytest
from pydantic import AfterValidator, TypeAdapter, ValidationError

from worker.spec.axes import NUMBER, WHOLE, Axis, Range, values_of, within

AXIS = TypeAdapter(Annotated[Axis, AfterValidator(within(1e-6, 1e6))])


def refusal(axis: Any, adapter: TypeAdapter[Any] = AXIS) -> str:
    with pytest.raises(ValidationError) as caught:
        adapter.validate_python(axis)
    [problem] = caught.value.errors()
    error = problem["ctx"]["error"]
    return f"{error.field}: {error.rule}" if error.field else str(error.rule)


def test_the_values_of_an_axis():
    assert values_of(2.0).tolist() == [2.0]
    assert values_of((1.0, 2.0)).tolist() == [1.0, 2.0]
    assert values_of(Range(start=1.0, stop=2.0, num=5)).tolist() == [1.0, 1.25, 1.5, 1.75, 2.0]
    log = values_of(Range(start=0.3, stop=2.7, num=3, spacing="log"))
    assert log.tolist() == pytest.approx([0.3, 0.9, 2.7])
    assert (log[0], log[-1]) == (0.3, 2.7)
    for num in range(2, 50):
        ends = values_of(Range(start=0.1, stop=0.7, num=num, spacing="log"))[[0, -1]]
        assert ends.tolist() == [0.1, 0.7]
    assert {values_of(axis).dtype for axis in (2, (1, 2), Range(start=1, stop=2, num=2))} == {
        np.dtype(np.float64)
    }


def test_numbers_and_whole_numbers():
    number, whole = TypeAdapter(Annotated[float, NUMBER]), TypeAdapter(Annotated[int, WHOLE])
    assert str(number.validate_python(-0.0)) == "0.0"
    assert number.validate_python(np.float32(0.5)) == 0.5
    assert number.validate_python(3) == 3.0
    assert whole.validate_python(200.0) == 200
    assert whole.validate_python(np.int64(-3)) == -3
    assert whole.validate_python(np.float64(-3.0)) == -3
    for wrong, rule in ((2.5, "2 or 3 would do"), (-2.5, "-3 or -2 would do")):
        assert refusal(wrong, whole).endswith(rule)
    for wrong in (float("inf"), float("nan"), "three", None):
        with pytest.raises(ValidationError):
            whole.validate_python(wrong)
