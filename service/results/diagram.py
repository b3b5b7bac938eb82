"""Bifurcation diagrams: the flights of all cells along one axis of the grid."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kernel.params import Outcome
from kernel.recount import counted
from service.results.counting import recounted, shortest
from service.results.selection import (
    MAX_READ,
    Sweep,
    check_points,
    fixed_axes,
    read,
    resolve_direction,
    thinning,
)
from worker import schema
from worker.spec import SweepSpec


def diagram_arrays(spec: SweepSpec) -> tuple[schema.Array, ...]:
    """The stored arrays of a diagram: one value per flight, per exponent, or per cell."""
    return tuple(array for array in schema.arrays(spec) if array is not schema.END_STATE)


@dataclass(frozen=True)
class Diagram:
    """n cells along one axis; of each the last `keep` flights, NaN where there are fewer."""

    along: str
    fixed: Mapping[str, float]
    direction: str
    values: NDArray[np.float64]  # (n,) of the axis `along`
    #: By name: (n, keep) per flight, (n, exponents), (n,) per cell; outcome and mode by the flights that
    #: count, and `counting.LABEL` where there are exponents.
    arrays: Mapping[str, NDArray[Any]]
    min_flight: float = 0.0  # rad; shorter flights do not count, unless all of a cell are
    every: int = 1  # the cells are every n-th of the axis
    repairing: bool = False  # of the sweep

    @property
    def flight_time(self) -> NDArray[np.float64]:
        """(n, keep) rad."""
        return self.arrays["flight_time"]

    @property
    def outcome(self) -> NDArray[np.uint8]:
        """(n,) members of `kernel.params.Outcome`."""
        return self.arrays["outcome"]

    @cached_property
    def shown(self) -> NDArray[np.bool_]:
        """(n, keep) whether an entry is a flight that counts: see `kernel.recount.counted`."""
        return counted(self.flight_time, self.arrays["flights"], self.min_flight)

    @property
    def missing(self) -> int:
        """Cells that are not computed yet."""
        return int(np.count_nonzero(self.outcome == Outcome.MISSING))

    @property
    def complete(self) -> bool:
        """Whether every cell is computed, and the sweep undamaged."""
        return self.missing == 0 and not self.repairing


def diagram(
    sweep: Sweep,
    along: str,
    values: Mapping[str, float | None],
    direction: str | None,
    min_flight: float | None,
    max_points: int,
    every: int = 1,
) -> Diagram:
    """The cells along `along`, every n-th of them, at the grid values nearest to `values` of the other axes.

    Reads only the chunks that hold these cells. `min_flight` is in rad; None is the sweep's `micro_flight`.
    Raises InvalidRequest naming a parameter that is missing, unknown or outside its axis, TooLarge for more
    than `max_points` flights.
    """
    spec = sweep.spec
    fixed = fixed_axes(spec, along, values)
    direction = resolve_direction(spec, direction)
    axis = spec.axis_values(along)
    cells = len(axis[::every])
    what = f"{cells:,} values of {along} × keep {spec.keep:,}"
    check_points(cells * spec.keep, max_points, what, thinning((len(axis),), spec.keep, max_points))
    indices = {name: point.index for name, point in fixed.items()} | {along: slice(None, None, every)}
    arrays = read(sweep, [array.name for array in diagram_arrays(spec)], direction, indices)
    arrays |= recounted(spec, arrays, min_flight)
    fixed_values = {name: point.value for name, point in fixed.items()}
    shorter = shortest(spec, min_flight)
    values_along = axis[::every]
    return Diagram(along, fixed_values, direction, values_along, arrays, shorter, every, sweep.repairing)


def diagrams(
    sweep: Sweep,
    along: str,
    values: Mapping[str, float | None],
    direction: str | None,
    min_flight: float | None,
    max_points: int,
    every: int = 1,
) -> list[Diagram]:
    """`diagram` in one direction, or with None in each direction of the sweep; `max_points` is for all."""
    directions = sweep.spec.directions if direction is None else (direction,)
    share = max_points // len(directions)
    return [diagram(sweep, along, values, name, min_flight, share, every) for name in directions]


def diagrams_to_draw(
    sweep: Sweep,
    along: str,
    values: Mapping[str, float | None],
    direction: str | None,
    min_flight: float | None,
    every: int = 1,
) -> list[Diagram]:
    """`diagrams` for a picture: a line with more flights than MAX_READ is thinned instead of refused."""
    spec = sweep.spec
    cells = len(spec.axis_values(along))
    fitting = thinning((cells,), spec.keep, MAX_READ // len(spec.directions))
    return diagrams(sweep, along, values, direction, min_flight, MAX_READ, max(every, fitting or cells))
