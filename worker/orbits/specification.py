"""The specification of orbits: a grid of springs, and the modes whose branches are computed.

The study has cycles in closed form and the events on their branches, for the rigid contact without
restitution. A cell is a spring, one (xi, omega). Its branches have the same number of points in all cells.
"""

import math
import re
from collections.abc import Sequence
from typing import Annotated, ClassVar, Final, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from kernel.cycles.events import POINTS
from worker.spec.axes import LARGEST, NUMBER, SMALLEST, WHOLE, Axis, Strict, within
from worker.spec.errors import BrokenRuleError, describe
from worker.spec.specification import Specification

#: Maximum modes of a specification or an answer, and maximum plate periods of a mode.
MAX_MODES: Final = 6
MAX_PERIODS: Final = 12

#: Maximum flight times per branch. The cost grows with their square, to 0.4 s at this limit. A branch of one
#: period reaches it at about Omega = 0.04.
MAX_GRID: Final = 2_000

#: Maximum stored points of a branch and maximum stored events of a cell.
MAX_POINTS: Final = 1_000
MAX_EVENTS: Final = 1_000

DIMS: Final = ("xi", "omega")
_Many = TypeVar("_Many", bound=Sequence[str | int])
_MODE: Final = re.compile(r"([1-9][0-9]{0,3})-([1-9][0-9]{0,3})")


def read_mode(text: str) -> int:
    """The plate periods of a mode of one bounce, which is written as `1-2`. Raises BrokenRuleError."""
    match = _MODE.fullmatch(text)
    if match is None:
        raise BrokenRuleError("", f"must be like 1-2 (bounces-periods), not {describe(text)}")
    if match[1] != "1":
        rule = "must have one bounce, as 1-1 or 1-2: other modes are found from the cells of a sweep"
        raise BrokenRuleError("", f"{rule}, not {text}")
    periods = int(match[2])
    if periods > MAX_PERIODS:
        raise BrokenRuleError("", f"must have at most {MAX_PERIODS} periods, not {periods}")
    return periods


def check_modes(modes: _Many) -> _Many:
    """The modes. Raises BrokenRuleError for too many or repeated ones."""
    if len(set(modes)) < len(modes):
        raise BrokenRuleError("", "must not name a mode twice")
    if not 1 <= len(modes) <= MAX_MODES:
        raise BrokenRuleError("", f"must be 1 to {MAX_MODES} modes, not {len(modes)}")
    return modes


def grid_points(omega: NDArray[np.float64], periods: int) -> NDArray[np.float64]:
    """Approximate number of flight times of an undamped spring's branch, at each omega (n,).

    See `kernel.cycles.events.flight_times`; fewer with damping, except near both ends.
    """
    rate = 1.0 + (1.0 + math.sqrt(2.0)) / omega
    return np.maximum(2.0 * math.pi * periods * rate / 0.2, POINTS)


Modes = Annotated[
    tuple[Annotated[str, AfterValidator(lambda name: f"1-{read_mode(name)}")], ...],
    BeforeValidator(lambda value: tuple(value) if isinstance(value, list) else value),
    AfterValidator(check_modes),
]


class Orbits(Strict):
    """The protocol; its kind selects the study."""

    kind: Literal["orbits"]


class OrbitsSpec(Specification):
    """A grid of springs, the modes of the branches, and the length of the records.

    `OrbitsSpec(omega=..., xi=..., protocol=...)` raises `SpecInvalid`, which names each field and rule.
    """

    AXES: ClassVar = DIMS

    omega: Annotated[Axis, AfterValidator(within(SMALLEST, LARGEST))]
    xi: Annotated[Axis, AfterValidator(within(0.0, LARGEST))]
    protocol: Orbits
    modes: Annotated[Modes, Field(description="Bounces-periods, of one bounce.")] = ("1-1", "1-2")
    gamma_max: Annotated[
        float, Field(gt=0.0, le=LARGEST, title="largest Γ", description="Of a branch."), NUMBER
    ] = 8.0
    points: Annotated[int, Field(ge=10, le=MAX_POINTS, description="Of a branch, at most."), WHOLE] = 128
    events: Annotated[int, Field(ge=1, le=MAX_EVENTS, description="Of a spring, at most."), WHOLE] = 128

    @model_validator(mode="after")
    def _rules(self) -> Self:
        longest = max(self.periods)
        lowest = self.axis_values("omega")[:1]
        if grid_points(lowest, longest)[0] > MAX_GRID:
            rate = MAX_GRID * 0.2 / (2.0 * math.pi * longest) - 1.0
            needed = math.ceil(1000.0 * (1.0 + math.sqrt(2.0)) / rate) / 1000.0
            rule = f"must be at least {needed:g} for 1-{longest}, whose branch takes too many points below"
            raise BrokenRuleError("omega", f"{rule}, not {float(lowest[0])!r}")
        return self

    @property
    def periods(self) -> tuple[int, ...]:
        """The plate periods of the modes, in the order of the dimension `branch`."""
        return tuple(read_mode(name) for name in self.modes)
