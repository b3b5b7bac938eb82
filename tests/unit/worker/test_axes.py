"""Axes by themselves: which numbers, lists and ranges are accepted, to the last one, and their values."""

from typing import Annotated, Any

import numpy as np
import pytest
from pydantic import AfterValidator, TypeAdapter, ValidationError
from tables import for_each

from worker.spec.axes import NUMBER, WHOLE, Axis, Range, values_of, within

AXIS = TypeAdapter(Annotated[Axis, AfterValidator(within(1e-6, 1e6))])
FROM_ZERO = TypeAdapter(Annotated[Axis, AfterValidator(within(0.0, 1e6))])


def refusal(axis: Any, adapter: TypeAdapter[Any] = AXIS) -> str:
    with pytest.raises(ValidationError) as caught:
        adapter.validate_python(axis)
    [problem] = caught.value.errors()
    error = problem["ctx"]["error"]
    return f"{error.field}: {error.rule}" if error.field else str(error.rule)


@for_each(
    ("axis", "rule"),
    [
        (np.nextafter(1e-6, 0.0), "must be at least 1e-06"),
        (np.nextafter(1e6, 2e6), "must be at most 1e+06"),
        ({"start": 1e-7, "stop": 1.0, "num": 3}, "start: must be at least 1e-06"),
        (2**1023, "must be at most 1e+06, not 8.98846567431158e+307"),
        (-(2**1023), "must be at least 1e-06"),
        (2**1024, "must be finite, not a whole number of about 309 digits"),
        (np.array(2.0), "must be a number, a list of numbers, or a range"),
        ((), "must hold at least one number"),
        ([3.0, 1.0, 2.0], "must increase, but 3.0 at [0] is followed by 1.0"),
    ],
)
def test_axis_is_refused(axis: Any, rule: str):
    assert refusal(axis).startswith(rule)


def test_positive_numbers_are_not_too_small_to_compute_with():
    assert FROM_ZERO.validate_python([0.0, 1e-30, 1.0]) == (0.0, 1e-30, 1.0)
    assert FROM_ZERO.validate_python(1e-30) == 1e-30
    assert refusal(1e-31, FROM_ZERO) == "must be 0 or at least 1e-30, not 1e-31"
    assert refusal([0.0, 1e-40, 1e-35, 1.0], FROM_ZERO) == "must be 0 or at least 1e-30, not 1e-40"


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
