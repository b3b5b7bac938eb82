"""From a job's store to the arrays people look at: one line of cells, or one plane of them."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.params import Outcome
from kernel.threshold import threshold
from service.errors import InvalidRequest, TooLarge
from worker import layout, store
from worker.problems import one_of
from worker.spec import AXES, SweepSpec

#: The arrays of a diagram, by their names in the store.
LINE_ARRAYS: Final = ("flight_time", "takeoff_phase", "flights", "outcome", "bounces", "periods")

#: The arrays of a mode map.
MODE_ARRAYS: Final = ("outcome", "bounces", "periods")

#: Outcomes of a cell that bounces.
BOUNCING: Final = (Outcome.PERIODIC, Outcome.APERIODIC)

#: A value may lie outside an axis by rounding, relative to the axis's own size.
SLACK: Final = 1e-9

#: Where on the grid: an index drops its axis, a slice keeps it.
Places = Mapping[str, int | slice]


@dataclass(frozen=True)
class Sweep:
    """A job's specification and where its results are."""

    spec: SweepSpec
    url: str
    promised: bool = False  # all of them are there: the job is done


@dataclass(frozen=True)
class Diagram:
    """The flights of n cells along one axis; the last `keep` flights of each cell, NaN beyond."""

    along: str
    fixed: Mapping[str, float]
    direction: str
    values: NDArray[np.float64]  # (n,)
    flight_time: NDArray[np.float64]  # (n, keep) rad
    takeoff_phase: NDArray[np.float64]  # (n, keep) rad, modulo 2 pi
    flights: NDArray[np.int32]  # (n,)
    outcome: NDArray[np.uint8]  # (n,)
    bounces: NDArray[np.int16]  # (n,)
    periods: NDArray[np.int16]  # (n,)
    min_flight: float = 0.0  # rad; shorter flights are left out of `shown`

    @cached_property
    def shown(self) -> NDArray[np.bool_]:
        """(n, keep) which entries are flights that count."""
        kept = np.arange(self.flight_time.shape[1]) < self.flights[:, None]
        finite = np.isfinite(self.flight_time) & np.isfinite(self.takeoff_phase)
        return kept & finite & (self.flight_time >= self.min_flight)

    @property
    def missing(self) -> int:
        """Cells that are not computed yet."""
        return int(np.count_nonzero(self.outcome == Outcome.MISSING))

    @property
    def complete(self) -> bool:
        """Whether every cell is computed."""
        return self.missing == 0


@dataclass(frozen=True)
class Plane:
    """Arrays over (omega, gamma) at one xi and direction."""

    xi: float
    direction: str
    omega: NDArray[np.float64]
    gamma: NDArray[np.float64]
    arrays: Mapping[str, NDArray[Any]]  # each (n_omega, n_gamma)

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


def diagram(
    sweep: Sweep,
    along: str,
    given: Mapping[str, float | None],
    direction: str | None,
    min_flight: float,
    max_points: int,
) -> Diagram:
    """The line of cells along `along` through the grid values nearest to those given for the other axes.

    Reads only the chunks that the line touches. Raises InvalidRequest naming a parameter that is missing,
    unknown or outside its axis, TooLarge for more than `max_points` flights.
    """
    spec = sweep.spec
    fixed = fixed_places(spec, along, given)
    chosen = direction_of(spec, direction)
    values = spec.axis_values(along)
    what = f"{len(values):,} values of {along} × keep {spec.keep:,}"
    check_points(len(values) * spec.keep, max_points, what)
    arrays = read(sweep, LINE_ARRAYS, chosen, {axis: place for axis, (place, _) in fixed.items()})
    fixed_values = {axis: value for axis, (_, value) in fixed.items()}
    return Diagram(along, fixed_values, chosen, values, min_flight=min_flight, **arrays)


def diagrams(
    sweep: Sweep,
    along: str,
    given: Mapping[str, float | None],
    direction: str | None,
    min_flight: float,
    max_points: int,
) -> list[Diagram]:
    """The same line in the direction asked for, or in every direction the sweep has."""
    wanted = sweep.spec.directions if direction is None else (direction,)
    share = max_points // len(wanted)
    return [diagram(sweep, along, given, one, min_flight, share) for one in wanted]


def modes(sweep: Sweep, xi: float | None, direction: str | None, max_points: int) -> Plane:
    """The mode map at one xi: outcome, bounces and periods of every cell. Raises as `diagram`."""
    return plane(sweep, xi, direction_of(sweep.spec, direction), MODE_ARRAYS, max_points)


def plane(sweep: Sweep, xi: float | None, direction: str, names: tuple[str, ...], max_points: int) -> Plane:
    """The named arrays over all (omega, gamma) at the grid's xi nearest to the one given.

    Raises as `diagram`.
    """
    spec = sweep.spec
    place, value = place_of(spec, "xi", xi)
    omega, gamma = spec.axis_values("omega"), spec.axis_values("gamma")
    what = f"{len(omega):,} values of omega × {len(gamma):,} of gamma"
    check_points(len(omega) * len(gamma), max_points, what)
    arrays = read(sweep, names, direction_of(spec, direction), {"xi": place})
    return Plane(value, direction, omega, gamma, arrays)


def thresholds(sweep: Sweep, xi: float | None, max_points: int) -> Thresholds:
    """Where bouncing begins on the way up (or from rest) and ends on the way down, per Ω, to the grid in Γ.

    Raises InvalidRequest for a sweep ramped along another axis than gamma, and as `plane`.
    """
    spec = sweep.spec
    if spec.ramp_axis not in (None, "gamma"):
        rule = f"is {spec.ramp_axis}; thresholds in gamma need a sweep from rest or ramped along gamma"
        raise InvalidRequest.of("protocol.axis", rule)
    planes = [plane(sweep, xi, direction, ("outcome",), max_points) for direction in spec.directions]
    first = planes[0]
    nowhere = np.full(len(first.omega), np.nan)
    found = {"up": nowhere, "down": nowhere} | {
        "down" if one.direction == "down" else "up": _lowest_bouncing(one) for one in planes
    }
    complete = all(one.complete for one in planes)
    return Thresholds(first.xi, first.omega, threshold(first.omega, first.xi), complete=complete, **found)


def _lowest_bouncing(plane: Plane) -> NDArray[np.float64]:
    """(n_omega,) the lowest Γ that bounces, NaN where none does."""
    bounces = np.isin(plane.arrays["outcome"], BOUNCING)
    lowest = plane.gamma[np.argmax(bounces, axis=1)]
    return np.where(bounces.any(axis=1), lowest, np.nan)


def fixed_places(
    spec: SweepSpec, along: str, given: Mapping[str, float | None]
) -> dict[str, tuple[int, float]]:
    """Place and value on every axis but `along`."""
    if given.get(along) is not None:
        raise InvalidRequest.of(along, "is the axis the diagram goes along; leave it out")
    return {axis: place_of(spec, axis, given.get(axis)) for axis in reversed(AXES) if axis != along}


def place_of(spec: SweepSpec, axis: str, value: float | None) -> tuple[int, float]:
    """Index and value of the grid value nearest to the one given; the only one needs no giving."""
    values = spec.axis_values(axis)
    low, high = float(values[0]), float(values[-1])
    if value is None:
        if len(values) > 1:
            rule = f"is required: the sweep has {len(values):,} values from {low:g} to {high:g}"
            raise InvalidRequest.of(axis, rule)
        return 0, low
    slack = SLACK * max(abs(low), abs(high))
    if not low - slack <= value <= high + slack:
        reach = f"from {low!r} to {high!r}" if len(values) > 1 else f"at {low!r} alone"
        raise InvalidRequest.of(axis, f"must be within the sweep, which is {reach}, not {value!r}")
    place = int(np.argmin(np.abs(values - value)))
    return place, float(values[place])


def direction_of(spec: SweepSpec, direction: str | None) -> str:
    """The direction asked for, or the sweep's first. Raises InvalidRequest."""
    if direction is None:
        return spec.directions[0]
    if direction not in spec.directions:
        raise InvalidRequest.of("direction", f"must be {one_of(spec.directions)} in this sweep")
    return direction


def read(sweep: Sweep, names: tuple[str, ...], direction: str, places: Places) -> dict[str, NDArray[Any]]:
    """The named arrays at one direction and `places`, whole along the other axes."""
    where = {"direction": sweep.spec.directions.index(direction), **places}
    try:
        return store.read_slice(sweep.url, names, **where, promised=sweep.promised)
    except store.StoreMissing as error:
        if sweep.promised:
            raise store.StoreDamaged(str(error)) from error
        # The job is still queued.
        wanted = [array for array in layout.arrays(sweep.spec) if array.name in names]
        return {array.name: _nothing(sweep.spec, array, where) for array in wanted}


def _nothing(spec: SweepSpec, array: layout.Array, where: Places) -> NDArray[Any]:
    """What an array reads as before anything is computed."""
    length = layout.sizes(spec)
    kept = {dim: where.get(dim, slice(None)) for dim in array.dims}
    shape = [len(range(length[dim])[part]) for dim, part in kept.items() if isinstance(part, slice)]
    return np.full(shape, array.fill, array.dtype)


def check_points(points: int, max_points: int, what: str) -> None:
    """Raise TooLarge for more points than one answer may hold."""
    if points > max_points:
        raise TooLarge(
            f"the answer would hold up to {points:,} points ({what}), at most {max_points:,} are sent; "
            f"{max_points / points:.1%} as many fit, and opening the store itself has no such limit"
        )
