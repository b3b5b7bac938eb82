"""From a job's store to planes of cells over (Ω, Γ): the mode map, and where bouncing begins and ends."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.params import Outcome
from kernel.threshold import threshold
from service.errors import InvalidRequest
from service.results.diagram import MAX_READ, Sweep, check_points, direction_of, nearest_index, read, thinning

#: The arrays of a mode map.
MODE_ARRAYS: Final = ("outcome", "bounces", "periods")

#: Outcomes of a cell that bounces.
BOUNCING: Final = (Outcome.PERIODIC, Outcome.APERIODIC)


@dataclass(frozen=True)
class Plane:
    """Arrays over (omega, gamma) at one xi and direction."""

    xi: float
    direction: str
    omega: NDArray[np.float64]
    gamma: NDArray[np.float64]
    arrays: Mapping[str, NDArray[Any]]  # each (n_omega, n_gamma)
    every: int = 1  # the cells are every n-th of both axes

    @property
    def complete(self) -> bool:
        """Whether every cell is computed."""
        return bool(np.all(self.arrays["outcome"] != Outcome.MISSING))


@dataclass(frozen=True)
class Thresholds:
    """Per Ω at one xi; NaN where nothing bounces or the sweep has no such direction."""

    xi: float
    omega: NDArray[np.float64]
    analytic: NDArray[np.float64]
    up: NDArray[np.float64]
    down: NDArray[np.float64]
    complete: bool


def modes(sweep: Sweep, xi: float | None, direction: str | None, max_points: int, every: int = 1) -> Plane:
    """The mode map at one xi: outcome, bounces and periods of cells, every n-th of both axes.

    Raises as `diagram`.
    """
    lengths = [len(sweep.spec.axis_values(axis)) for axis in ("omega", "gamma")]
    omegas, gammas = (-(-n // every) for n in lengths)
    what = f"{omegas:,} values of omega × {gammas:,} of gamma"
    check_points(omegas * gammas, max_points, what, thinning(lengths, 1, max_points))
    part = slice(None, None, every)
    found = plane(sweep, xi, direction_of(sweep.spec, direction), MODE_ARRAYS, part, part)
    return replace(found, every=every)


def plane(
    sweep: Sweep,
    xi: float | None,
    direction: str,
    names: tuple[str, ...],
    omega: slice = slice(None),
    gamma: slice = slice(None),
) -> Plane:
    """The named arrays over a part of (omega, gamma) at the grid's xi nearest to the one given.

    Raises InvalidRequest as `diagram`.
    """
    spec = sweep.spec
    place, value = nearest_index(spec, "xi", xi)
    arrays = read(sweep, names, direction, {"xi": place, "omega": omega, "gamma": gamma})
    return Plane(value, direction, spec.axis_values("omega")[omega], spec.axis_values("gamma")[gamma], arrays)


def thresholds(sweep: Sweep, xi: float | None, max_points: int) -> Thresholds:
    """Where bouncing begins on the way up (or from rest) and ends on the way down, per Ω, to the grid in Γ.

    Raises InvalidRequest for a sweep ramped along another axis than gamma, and as `diagram`.
    """
    spec = sweep.spec
    if spec.ramp_axis not in (None, "gamma"):
        rule = f"is {spec.ramp_axis}; thresholds in gamma need a sweep from rest or ramped along gamma"
        raise InvalidRequest.of("protocol.axis", rule)
    omega = spec.axis_values("omega")
    check_points(len(omega), max_points, f"{len(omega):,} values of omega", None)
    _, value = nearest_index(spec, "xi", xi)
    nowhere = np.full(len(omega), np.nan)
    found, complete = {"up": nowhere, "down": nowhere}, True
    for direction in spec.directions:
        lowest, whole = _lowest_bouncing(sweep, xi, direction)
        found["down" if direction == "down" else "up"] = lowest
        complete = complete and whole
    return Thresholds(value, omega, threshold(omega, value), complete=complete, **found)


def _lowest_bouncing(sweep: Sweep, xi: float | None, direction: str) -> tuple[NDArray[np.float64], bool]:
    """(n_omega,) the lowest Γ that bounces, NaN where none does; and whether every cell is computed."""
    omegas, gammas = (len(sweep.spec.axis_values(axis)) for axis in ("omega", "gamma"))
    rows = max(1, MAX_READ // gammas)
    parts = [
        plane(sweep, xi, direction, ("outcome",), slice(low, low + rows)) for low in range(0, omegas, rows)
    ]
    return np.concatenate([_lowest(part) for part in parts]), all(part.complete for part in parts)


def _lowest(plane: Plane) -> NDArray[np.float64]:
    bounces = np.isin(plane.arrays["outcome"], BOUNCING)
    lowest = plane.gamma[np.argmax(bounces, axis=1)]
    return np.where(bounces.any(axis=1), lowest, np.nan)
