"""A window of a sweep's map, as the specification of an adaptive sweep on a finer grid."""

import math
from typing import Annotated, ClassVar, Final, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from worker.spec.axes import WHOLE, AxisValue, Number, Range
from worker.spec.errors import BrokenRuleError, Problem, SpecInvalid, describe
from worker.spec.refine import Margin
from worker.spec.specification import Document
from worker.sweep import SweepSpec
from worker.sweep.protocols import Rest
from worker.sweep.specification import EarlierSweep

#: Minimum values of a window along an axis.
FEWEST_VALUES: Final = 129

#: Finest grid of a window, in multiples of the map's.
MAX_FINER: Final = 64


def _pair(value: object) -> object:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise BrokenRuleError("", f"must be two numbers, the smaller first, not {describe(value)}")
    return value


def _increasing(ends: list[float]) -> list[float]:
    if not ends[0] < ends[1]:
        raise BrokenRuleError("", f"must be two numbers, the smaller first, not {ends[0]:g} and {ends[1]:g}")
    return ends


Ends = Annotated[
    list[Number], Field(min_length=2, max_length=2), AfterValidator(_increasing), BeforeValidator(_pair)
]


class Window(Document):
    """A part of a map over gamma and omega at one xi, and how to compute it.

    `gamma`, `omega`: its ends; null along an axis of one value. `xi`: nearest value of the map; null if it
    has only one. `finer`: how many times as fine as the map. `by` and `margin` as in `Refine`.
    """

    WHAT: ClassVar = "a window"

    gamma: Ends | None = None
    omega: Ends | None = None
    xi: Number | None = None
    finer: Annotated[int, Field(ge=1, le=MAX_FINER), WHOLE] = 4
    by: Literal["mode", "bouncing"] = "mode"
    margin: Margin = False

    def of(self, spec: SweepSpec, job: str) -> SweepSpec:
        """The adaptive sweep of this window of the map of `spec`, which job `job` computed.

        Raises `SpecInvalid` for the map of a ramp, and for a window outside the map.
        """
        if not isinstance(spec.protocol, Rest):
            rule = f"must be 'rest' to refine a window, and is {spec.protocol.kind!r} in this sweep"
            raise SpecInvalid([Problem("protocol.kind", rule)])
        spec = spec.today() if isinstance(spec, EarlierSweep) else spec
        axes = {axis: self._axis(spec, axis) for axis in ("gamma", "omega")}
        name = f"Window of {spec.name or 'sweep ' + job[:8]}"[:200]
        fields = {"name": name, "xi": self._xi(spec), "parent": job, "refine": {"by": self.by}}
        return SweepSpec.parse(spec.as_submitted() | fields | axes)

    def _axis(self, spec: SweepSpec, name: str) -> AxisValue:
        ends: list[float] | None = getattr(self, name)
        values = spec.axis_values(name)
        low, high = float(values[0]), float(values[-1])
        if len(values) == 1:
            if ends is not None and not ends[0] <= low <= ends[1]:
                raise SpecInvalid([Problem(name, f"must enclose {low:g}, the only value of this sweep")])
            return low
        first, last = (low, high) if ends is None else (max(ends[0], low), min(ends[1], high))
        if not first < last:
            raise SpecInvalid([Problem(name, f"must overlap the sweep, which is from {low:g} to {high:g}")])
        inside = int(np.count_nonzero((values >= first) & (values <= last)))
        num = max(self.finer * (inside - 1) + 1, FEWEST_VALUES)
        axis = getattr(spec, name)
        return Range(start=first, stop=last, num=num, spacing=getattr(axis, "spacing", "linear"))

    def _xi(self, spec: SweepSpec) -> float:
        values = spec.axis_values("xi")
        if self.xi is None:
            if len(values) > 1:
                raise SpecInvalid([Problem("xi", f"is required: the sweep has {len(values):,} values")])
            return float(values[0])
        if not math.isclose(self.xi, float(values[0])) and not values[0] <= self.xi <= values[-1]:
            ends = f"from {values[0]:g} to {values[-1]:g}"
            raise SpecInvalid([Problem("xi", f"must be within the sweep, which is {ends}, not {self.xi:g}")])
        return float(values[np.argmin(np.abs(values - self.xi))])
