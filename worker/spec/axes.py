"""Axes of a sweep: a number, a list of numbers, or a range."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)

from worker.spec.errors import BrokenRuleError, SpecInvalid, describe, did_you_mean, one_of, problems_of

#: Range of gamma and omega, and upper bound of xi: beyond any physical experiment, well within double
#: precision.
SMALLEST: Final = 1e-6
LARGEST: Final = 1e6

#: Checked before any value of a range is computed.
MAX_AXIS_VALUES: Final = 100_000


class Strict(BaseModel):
    """A frozen value object: no coercion, no unknown fields; invalid ones raise `SpecInvalid`."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    if not TYPE_CHECKING:  # editors and type checkers see the fields

        def __init__(self, /, **data: object) -> None:
            try:
                super().__init__(**data)
            except ValidationError as error:
                fields = {cls.tag(): tuple(cls.model_fields) for cls in _subclasses(Strict)}
                own = type(self).model_fields
                for name, field in own.items():
                    if isinstance(field.annotation, type) and issubclass(field.annotation, Strict):
                        fields[name] = tuple(field.annotation.model_fields)
                fields[""] = tuple(own)
                raise SpecInvalid(problems_of(error, fields)) from None

        #: With pydantic's own mark it is not called for a field's value, whose errors keep their whole path.
        __init__.__pydantic_base_init__ = True

        def __setattr__(self, name: str, value: object) -> None:
            raise AttributeError(f"{name}: cannot be changed: make another {type(self).__name__}")

    @classmethod
    def tag(cls) -> str:
        """The tag of this class in unions: it leads from an error to the names of its fields."""
        return f"<{cls.__name__}>"


def _subclasses(cls: type[Strict]) -> Iterator[type[Strict]]:
    for subclass in cls.__subclasses__():
        yield subclass
        yield from _subclasses(subclass)


def kind_of(value: object, default: str | None = None) -> Any:
    """The `kind` of an object or of its fields; `default` for fields without one."""
    return value.get("kind", default) if isinstance(value, dict) else getattr(value, "kind", None)


def check_kind(
    value: object, table: Mapping[str, object], offered: Collection[str], default: str | None = None
) -> object:
    """The value, whose `kind` is in the table. Raises BrokenRuleError, which names the kinds offered."""
    if not isinstance(value, dict | Strict):
        example = value if isinstance(value, str) and value in offered else next(iter(table))
        rule = f'must be a group of fields, as {{kind = "{example}"}}, not {describe(value)}'
        raise BrokenRuleError("", rule)
    kind = kind_of(value, default)
    if isinstance(kind, str) and kind in table:
        return value
    if isinstance(kind, str) and kind in offered:
        rule = f"{kind!r} is a study of its own, not a sweep: submit it as a mapping or a file"
        raise BrokenRuleError("kind", rule)
    if kind is None and "kind" not in dict(value):
        raise BrokenRuleError("kind", f"is required: {one_of(offered)}")
    rule = f"must be {one_of(offered)}, not {describe(kind)}{did_you_mean(kind, table)}"
    raise BrokenRuleError("kind", rule)


def _plain(value: object) -> object:
    """Convert a numpy scalar to a Python number; return any other value unchanged."""
    return value.item() if isinstance(value, np.generic) else value


def _to_float(value: object) -> object:
    """Reject non-finite numbers, and convert -0.0 to 0.0, which defines the same sweep."""
    value = _plain(value)
    infinite = isinstance(value, float) and not np.isfinite(value)
    if infinite or (isinstance(value, int) and abs(value) > 2**1023):
        raise BrokenRuleError("", f"must be finite, not {describe(value)}")
    return value + 0.0 if isinstance(value, float) else value


def _to_int(value: object, validate: ValidatorFunctionWrapHandler) -> object:
    """Convert a float without a fractional part to int; the error for 200.5 proposes those near it."""
    value = _plain(value)
    if not isinstance(value, float) or not np.isfinite(value):
        return validate(value)
    if value == int(value):
        return validate(int(value))
    near = []
    for number in (int(np.floor(value)), int(np.ceil(value))):
        with suppress(ValidationError):
            near.append(str(validate(number)))
    proposed = f": {' or '.join(near)}" if near else ""
    raise BrokenRuleError("", f"must be a whole number{proposed}, not {describe(value)}", "type")


#: Last item of an `Annotated[float, ...]`: a finite number; text and booleans are rejected.
NUMBER: Final = BeforeValidator(_to_float)
#: Last item of an `Annotated[int, ...]`: a whole number; 200.0 is accepted.
WHOLE: Final = WrapValidator(_to_int)

Number = Annotated[float, NUMBER]


class Range(Strict):
    """`num` values from `start` to `stop`, both included, at equal steps or equal ratios."""

    start: Number
    stop: Number
    num: Annotated[int, Field(ge=1, le=MAX_AXIS_VALUES), WHOLE]
    spacing: Literal["linear", "log"] = "linear"

    @model_validator(mode="after")
    def _rules(self) -> "Range":
        if self.start > self.stop:
            rule = "must not be above stop: swap the two; a ramp down has the direction 'down'"
            raise BrokenRuleError("start", rule)
        if self.num == 1 and self.start < self.stop:
            raise BrokenRuleError("num", "must be at least 2 to reach from start to stop")
        if self.num > 1 and self.start == self.stop:
            raise BrokenRuleError("num", "must be 1 where start equals stop")
        if self.spacing == "log" and self.start <= 0:
            rule = f"must be above 0 for spacing 'log', not {describe(self.start)}; 'linear' may start there"
            raise BrokenRuleError("start", rule)
        return self


def _to_tuple(value: object) -> object:
    """Convert a list or a numpy array to a tuple; checks the length before pydantic checks the elements."""
    if isinstance(value, np.ndarray):
        if value.ndim != 1:
            raise BrokenRuleError("", f"must have one dimension, not {value.ndim}")
        value = value.tolist()
    values: Any = value
    if not values:
        raise BrokenRuleError("", "must hold at least one number")
    if len(values) > MAX_AXIS_VALUES:
        raise BrokenRuleError("", f"must hold at most {MAX_AXIS_VALUES:,} numbers, not {len(values):,}")
    return tuple(values)


def _increasing(values: tuple[float, ...]) -> tuple[float, ...]:
    for value, following in pairwise(values):
        if not value < following:
            rule = f"must increase, but {value!r} is followed by {following!r}; sort and drop repeats"
            raise BrokenRuleError("", rule)
    return values


def _form(value: object) -> str:
    if isinstance(value, dict | Range):
        return Range.tag()
    if isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim > 0):
        return "<list>"
    return "<number>"


def _number_or_forms(value: object) -> object:
    if isinstance(_plain(value), bool) or not isinstance(_plain(value), int | float):
        forms = "a number, a list of numbers, or a range with start, stop, num and spacing"
        raise BrokenRuleError("", f"must be {forms}, not {describe(value)}", "type")
    return value


if TYPE_CHECKING:  # what becomes a number, a tuple or a range
    Axis = float | Sequence[float] | NDArray[np.float64] | Range
else:
    Axis = Annotated[
        Annotated[Number, BeforeValidator(_number_or_forms), Tag("<number>")]
        | Annotated[
            tuple[Number, ...], BeforeValidator(_to_tuple), AfterValidator(_increasing), Tag("<list>")
        ]
        | Annotated[Range, Tag(Range.tag())],
        Discriminator(_form),
    ]


#: An axis after validation: a number, its values, or a range.
AxisValue = float | tuple[float, ...] | Range


def length_of(axis: AxisValue) -> int:
    """The number of values of an axis; allocates none."""
    if isinstance(axis, Range):
        return axis.num
    return len(axis) if isinstance(axis, tuple) else 1


def values_of(axis: AxisValue) -> NDArray[np.float64]:
    """The values of an axis, (n,) increasing; the first and last value of a range are exactly its ends.

    Specification, store and task all expand ranges with this function, so their values agree to the last
    digit.
    """
    if not isinstance(axis, Range):
        return np.atleast_1d(np.asarray(axis, dtype=np.float64))
    space = np.geomspace if axis.spacing == "log" else np.linspace
    values = np.asarray(space(axis.start, axis.stop, axis.num), dtype=np.float64)
    values[0], values[-1] = axis.start, axis.stop
    return values


#: The smallest positive number that kernels accept (`kernel.params`).
SMALLEST_POSITIVE: Final = 1e-30


def within(low: float, high: float) -> Callable[[AxisValue], AxisValue]:
    """A validator that raises BrokenRuleError unless all values are distinct and lie in [low, high]."""

    def check(axis: AxisValue) -> AxisValue:
        for field, value in _ends(axis):
            if value < low:
                raise BrokenRuleError(field, f"must be at least {low:g}, not {describe(value)}")
            if value > high:
                raise BrokenRuleError(field, f"must be at most {high:g}, not {describe(value)}")
        values = values_of(axis)
        too_small = values[(values > 0.0) & (values < SMALLEST_POSITIVE)]
        if len(too_small):
            rule = f"must be 0 or at least {SMALLEST_POSITIVE:g}, not {float(too_small[0])!r}"
            raise BrokenRuleError("", rule)
        if isinstance(axis, Range) and not np.all(np.diff(values) > 0):
            rule = f"must be small enough for distinct values: {axis.start!r} and {axis.stop!r} are too close"
            raise BrokenRuleError("num", rule)
        return axis

    return check


def _ends(axis: AxisValue) -> list[tuple[str, float]]:
    if isinstance(axis, Range):
        return [("start", axis.start), ("stop", axis.stop)]
    values = axis if isinstance(axis, tuple) else (axis,)
    return [("", values[0]), ("", values[-1])]
