"""Mode maps: outcome and mode of the cells of an (Ω, Γ) plane at one ξ and direction."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import prod
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.params import Outcome
from service.errors import InvalidRequest
from service.results.counting import FLIGHT_ARRAYS, arrays_of_modes, needs_flights, recounted, shortest
from service.results.hysteresis import Hysteresis, check_both_ways, compare
from service.results.selection import (
    MAX_READ,
    Stored,
    nearest_index,
    read,
    resolve_direction,
)
from worker import schema
from worker.spec import SweepSpec

#: Flights of both directions that are compared at a time, and bytes of memory of each: time and phase, what
#: counts, and their order.
_COMPARED: Final = MAX_READ // 4
_PER_COMPARED: Final = 48


@dataclass(frozen=True)
class Plane:
    """Stored arrays over (omega, gamma) at one xi and direction."""

    xi: float
    direction: str
    omega: NDArray[np.float64]
    gamma: NDArray[np.float64]
    arrays: Mapping[str, NDArray[Any]]  # each (n_omega, n_gamma)
    every: int = 1  # the cells are every n-th of both axes
    min_flight: float = 0.0  # rad; shorter flights do not count for the mode, unless all of a cell are
    repairing: bool = False  # of the sweep
    computed: float | None = (
        None  # of an adaptive map, the share of the plane's cells done that were computed
    )
    compared: bool = True  # with `hysteresis` among the arrays: every cell is computed in both directions

    @property
    def complete(self) -> bool:
        """Whether every cell is computed, and the sweep undamaged."""
        done = bool(np.all(self.arrays["outcome"] != Outcome.MISSING))
        return done and self.compared and not self.repairing


def modes(
    sweep: Stored[SweepSpec],
    xi: float | None,
    direction: str | None,
    *,
    every: int = 1,
    min_flight: float | None = None,
    hysteresis: bool = False,
    omega: range | None = None,
    gamma: range | None = None,
) -> Plane:
    """The mode map at the grid's xi nearest to `xi`, every n-th cell of both axes.

    `omega` and `gamma` are the indices of a part of the axes; None is all.

    `min_flight` is in rad; None is the sweep's `micro_flight`, whose modes are stored, for another value the
    flights are read. With `hysteresis`, of a sweep ramped both ways, the array of that name is a `Hysteresis`
    for each cell. Raises InvalidRequest as `selection.nearest_index` and `check_min_flight`.
    """
    spec = sweep.spec
    axes = (omega or range(len(spec.axis_values("omega"))), gamma or range(len(spec.axis_values("gamma"))))
    parts = [slice(part.start, part.stop, every) for part in axes]
    found = _recounted_plane(sweep, xi, direction, min_flight, *parts)
    if hysteresis:
        found = _compared(sweep, found, min_flight, *parts)
    return replace(found, every=every, computed=_computed_share(sweep, xi, found.direction))


def plane(
    sweep: Stored[SweepSpec],
    xi: float | None,
    direction: str,
    names: tuple[str, ...],
    omega: slice = slice(None),
    gamma: slice = slice(None),
) -> Plane:
    """The named arrays over a part of (omega, gamma) at the grid's xi nearest to `xi`.

    Raises InvalidRequest as `selection.nearest_index`.
    """
    spec = sweep.spec
    point = nearest_index(spec, "xi", xi)
    arrays = read(sweep, names, direction, {"xi": point.index, "omega": omega, "gamma": gamma})
    omegas, gammas = spec.axis_values("omega")[omega], spec.axis_values("gamma")[gamma]
    return Plane(point.value, direction, omegas, gammas, arrays, repairing=sweep.repairing)


def plane_size(spec: SweepSpec, min_flight: float | None, max_points: int, every: int = 1) -> tuple[int, int]:
    """The most cells of an answer, and the most flights read for it."""
    cells = prod(-(-len(spec.axis_values(axis)) // every) for axis in ("omega", "gamma"))
    cells = min(cells, most_cells(spec, min_flight, max_points))
    return cells, cells * spec.keep if needs_flights(spec, min_flight) else 0


def comparison_memory(spec: SweepSpec) -> int:
    """Bytes of memory that comparing the directions of a plane takes at most."""
    cells = prod(len(spec.axis_values(axis)) for axis in ("omega", "gamma"))
    row = len(spec.directions) * spec.keep * len(spec.axis_values("gamma"))
    return min(cells * len(spec.directions) * spec.keep, max(_COMPARED, row)) * _PER_COMPARED


def most_cells(spec: SweepSpec, min_flight: float | None, max_points: int) -> int:
    """The most cells of one answer: where their flights are read, as many as MAX_READ flights belong to."""
    return min(max_points, max(1, MAX_READ // spec.keep)) if needs_flights(spec, min_flight) else max_points


def check_min_flight(spec: SweepSpec, min_flight: float | None) -> None:
    """Raise InvalidRequest for an adaptive map whose modes would have to be found from other flights."""
    if spec.refine is not None and needs_flights(spec, min_flight):
        rule = (
            f"must be the sweep's, {spec.micro_flight:g}: an adaptive map is refined where modes of these "
            "flights change, and those of others change elsewhere; submit the map with micro_flight "
            f"{min_flight:g} instead, or read diagrams, which count other flights where cells are computed"
        )
        raise InvalidRequest.of("min_flight", rule)


def _recounted_plane(
    sweep: Stored[SweepSpec],
    xi: float | None,
    direction: str | None,
    min_flight: float | None,
    omega: slice,
    gamma: slice,
) -> Plane:
    """Outcome and mode over a part of (omega, gamma) if flights longer than `min_flight` (rad) count."""
    spec = sweep.spec
    check_min_flight(spec, min_flight)
    names = arrays_of_modes(spec, min_flight)
    cells = plane(sweep, xi, resolve_direction(spec, direction), names, omega, gamma)
    arrays = recounted(spec, cells.arrays, min_flight)
    return replace(cells, arrays=arrays, min_flight=shortest(spec, min_flight))


def _compared(
    sweep: Stored[SweepSpec], found: Plane, min_flight: float | None, omega: slice, gamma: slice
) -> Plane:
    """A part of a plane with the array `hysteresis`. Raises InvalidRequest for a sweep of one direction.

    Cells that are not computed in both directions have none. The flights are read some rows at a time.
    """
    spec = sweep.spec
    check_both_ways(spec)
    names = {*arrays_of_modes(spec, min_flight), *FLIGHT_ARRAYS}
    result = np.full(found.arrays["outcome"].shape, Hysteresis.NONE, np.uint8)
    rows = range(len(spec.axis_values("omega")))[omega]
    at_once = max(1, _COMPARED // (len(spec.directions) * spec.keep * len(found.gamma)))
    compared = True
    for first in range(0, len(rows), at_once):
        some = rows[first : first + at_once]
        part = slice(some.start, some.stop, some.step)
        up, down = (
            plane(sweep, found.xi, direction, tuple(names), part, gamma).arrays
            for direction in spec.directions
        )
        up, down = ({**arrays, **recounted(spec, arrays, min_flight)} for arrays in (up, down))
        compared &= all(bool(np.all(cells["outcome"] != Outcome.MISSING)) for cells in (up, down))
        result[first : first + at_once] = compare(spec, up, down, min_flight)
    return replace(found, arrays={**found.arrays, "hysteresis": result}, compared=compared)


def _computed_share(sweep: Stored[SweepSpec], xi: float | None, direction: str) -> float | None:
    """Of an adaptive map, the share of its cells at one xi that were computed, of those done; else None.

    Of every cell, also where an answer is thinned: rows and columns of a thinned one are those of blocks'
    corners, most of which are computed.
    """
    spec = sweep.spec
    if spec.refine is None:
        return None
    done = computed = 0
    omegas, gammas = (len(spec.axis_values(axis)) for axis in ("omega", "gamma"))
    rows = max(1, MAX_READ // gammas)
    for low in range(0, omegas, rows):
        names = (schema.OUTCOME.name, schema.COMPUTED.name)
        part = plane(sweep, xi, direction, names, slice(low, low + rows)).arrays
        done += int(np.count_nonzero(part[schema.OUTCOME.name] != Outcome.MISSING))
        computed += int(np.count_nonzero(part[schema.COMPUTED.name]))
    return computed / done if done else 0.0
