"""From a job's store to the arrays people look at: lines of cells; `mode_map` has planes of them."""

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.params import Outcome
from service.errors import InvalidRequest, TooLarge
from worker import schema, store
from worker.spec import AXES, SweepSpec
from worker.spec.errors import one_of

#: The arrays of a diagram, by their names in the store.
LINE_ARRAYS: Final = ("flight_time", "takeoff_phase", "flights", "outcome", "bounces", "periods")

#: Flights, or outcomes, read at once for what is drawn or summed up; of more, every n-th cell is.
MAX_READ: Final = 8_000_000

#: A value may lie outside an axis by rounding, relative to the axis's own size.
SLACK: Final = 1e-9

#: Where on the grid: an index drops its axis, a slice keeps it.
Places = Mapping[str, int | slice]


@dataclass(frozen=True)
class Sweep:
    """A job's specification and where its results are."""

    spec: SweepSpec
    url: str
    complete: bool = False  # all of them are there: the job is done


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
    every: int = 1  # the cells are every n-th of the axis

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


def diagram(
    sweep: Sweep,
    along: str,
    given: Mapping[str, float | None],
    direction: str | None,
    min_flight: float,
    max_points: int,
    every: int = 1,
) -> Diagram:
    """The line of cells along `along` through the grid values nearest to those given for the other axes.

    Every n-th cell of it; reads only the chunks that these lie in. Raises InvalidRequest naming a parameter
    that is missing, unknown or outside its axis, TooLarge for more than `max_points` flights.
    """
    spec = sweep.spec
    fixed = fixed_places(spec, along, given)
    chosen = direction_of(spec, direction)
    values = spec.axis_values(along)
    fits = thinning((len(values),), spec.keep, max_points)
    what = f"{len(values[::every]):,} values of {along} × keep {spec.keep:,}"
    check_points(len(values[::every]) * spec.keep, max_points, what, fits)
    where = {axis: place for axis, (place, _) in fixed.items()} | {along: slice(None, None, every)}
    arrays = read(sweep, LINE_ARRAYS, chosen, where)
    fixed_values = {axis: value for axis, (_, value) in fixed.items()}
    return Diagram(along, fixed_values, chosen, values[::every], **arrays, min_flight=min_flight, every=every)


def diagrams(
    sweep: Sweep,
    along: str,
    given: Mapping[str, float | None],
    direction: str | None,
    min_flight: float,
    max_points: int,
    every: int = 1,
) -> list[Diagram]:
    """The same line in the direction asked for, or in every direction the sweep has."""
    wanted = sweep.spec.directions if direction is None else (direction,)
    share = max_points // len(wanted)
    return [diagram(sweep, along, given, one, min_flight, share, every) for one in wanted]


def pictured(
    sweep: Sweep,
    along: str,
    given: Mapping[str, float | None],
    direction: str | None,
    min_flight: float,
    every: int = 1,
) -> list[Diagram]:
    """As `diagrams`, for drawing: of a very long line only as many cells as can be read for a picture."""
    spec = sweep.spec
    share = MAX_READ // len(spec.directions)
    needed = thinning((len(spec.axis_values(along)),), spec.keep, share)
    every = max(every, needed or len(spec.axis_values(along)))
    return diagrams(sweep, along, given, direction, min_flight, MAX_READ, every)


def thinning(lengths: Sequence[int], each: int, most: int) -> int | None:
    """The least n for which every n-th along all the axes, `each` points a cell, are at most `most` points.

    None if even a single cell is too much.
    """
    steps = range(1, max(lengths) + 1)
    found = bisect_left(steps, True, key=lambda every: each * prod(-(-n // every) for n in lengths) <= most)
    return steps[found] if found < len(steps) else None


def fixed_places(
    spec: SweepSpec, along: str, given: Mapping[str, float | None]
) -> dict[str, tuple[int, float]]:
    """Place and value on every axis but `along`."""
    if given.get(along) is not None:
        raise InvalidRequest.of(along, "is the axis the diagram goes along; leave it out")
    return {axis: nearest_index(spec, axis, given.get(axis)) for axis in reversed(AXES) if axis != along}


def nearest_index(spec: SweepSpec, axis: str, value: float | None) -> tuple[int, float]:
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


def read(sweep: Sweep, names: Sequence[str], direction: str, places: Places) -> dict[str, NDArray[Any]]:
    """The named arrays at one direction and `places`, whole along the other axes."""
    where = {"direction": sweep.spec.directions.index(direction), **places}
    try:
        return store.read_slice(sweep.url, names, **where, complete=sweep.complete)
    except store.StoreMissing as error:
        if sweep.complete:
            raise store.StoreDamaged(str(error)) from error
        # The job is still queued.
        wanted = [array for array in schema.arrays(sweep.spec) if array.name in names]
        return {array.name: _nothing(sweep.spec, array, where) for array in wanted}


def _nothing(spec: SweepSpec, array: schema.Array, where: Places) -> NDArray[Any]:
    """What an array reads as before anything is computed."""
    length = schema.sizes(spec)
    kept = {dim: where.get(dim, slice(None)) for dim in array.dims}
    shape = [len(range(length[dim])[part]) for dim, part in kept.items() if isinstance(part, slice)]
    return np.full(shape, array.fill, array.dtype)


def check_points(points: int, max_points: int, what: str, every: int | None) -> None:
    """Raise TooLarge for more points than one answer may hold; `every` says what would fit."""
    if points > max_points:
        fits = "" if every is None else f"every={every} asks for as many as fit, a picture for all, and "
        raise TooLarge(
            f"the answer would hold up to {points:,} points ({what}), at most {max_points:,} are sent: "
            f"{fits}opening the store itself has no such limit"
        )
