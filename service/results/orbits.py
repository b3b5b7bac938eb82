"""Cycles of the rigid plate in closed form: branches at one spring, and curves of their events over a range.

What takes AT_ONCE_SECONDS at most is computed while the caller waits, the rest and curves by the workers. All
are of the rigid contact without restitution.
"""

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from kernel.branches.curves import CURVES, Curve, Parameter, curves
from kernel.branches.curves import Curves as KernelCurves
from kernel.branches.energy import Energy, energy
from kernel.branches.events import Branch, Events, Kind, branch_and_events, flight_times, join_events
from kernel.params import KernelInputError
from service.background import Background
from service.errors import InvalidRequest
from service.jobs.model import JobRecord
from service.jobs.on_demand import Caller, OnDemandCache
from service.results.selection import Sweep, check_metadata, nearest_index, resolve_direction
from worker.analysis.prediction import branch_seconds
from worker.analysis.words import Words, continue_words
from worker.orbits import MAX_GRID, Mode, check_modes, read_mode
from worker.spec.errors import BrokenRuleError, one_of

#: Answers kept: the least recently used one makes room.
KEPT: Final = 32

#: Core-seconds that are computed while the caller waits, and that one answer of curves may take.
AT_ONCE_SECONDS: Final = 1.0
MAX_CURVES_SECONDS: Final = 60.0

#: Core-seconds of the curves of one mode, over the flight times of its branch at the range's smaller omega.
CURVES_SECONDS: Final = 0.01

Record = TypeVar("Record", Branch, Curve, Events)


@dataclass(frozen=True)
class Orbits:
    """Branches at one spring, cut where Γ leaves [0, gamma_max], and the events on them."""

    omega: float
    xi: float
    gamma_max: float
    branches: tuple[Branch, ...]  # connected pieces, by mode and flight time
    energy: tuple[Energy, ...]  # of each piece
    events: Events


@dataclass(frozen=True)
class WordOrbits:
    """Branches of words, continued from the cells of a sweep at one spring."""

    omega: float
    xi: float
    direction: str
    gamma_max: float
    found: Words
    complete: bool  # the sweep is done


@dataclass(frozen=True)
class EventCurves:
    """Curves of events in two parameters, cut where Γ leaves [0, gamma_max], and the points on them."""

    parameter: Parameter  # that varies
    fixed: float  # value of the other one
    curves: tuple[Curve, ...]  # connected pieces
    points: Events


def parse_modes(text: str) -> tuple[Mode, ...]:
    """Modes written as `1-1,1-2`: bounces and plate periods, of one bounce each. Raises InvalidRequest."""
    try:
        modes = [read_mode(part.strip()) for part in text.split(",")]
        check_modes(modes)
    except BrokenRuleError as error:
        raise InvalidRequest.of("modes", error.rule) from error
    return tuple(sorted(modes))


def parse_kinds(text: str) -> tuple[Kind, ...]:
    """Kinds of curves, written as `fold,flip`. Raises InvalidRequest."""
    parts = [part.strip() for part in text.split(",")]
    unknown = [part for part in parts if part not in CURVES]
    if unknown:
        raise InvalidRequest.of("kinds", f"must be among {one_of(CURVES)}, not {unknown[0][:40]!a}")
    return tuple(kind for kind in CURVES if kind in parts)


@lru_cache(KEPT)
def orbits(omega: float, xi: float, modes: tuple[Mode, ...], gamma_max: float, points: int) -> Orbits:
    """The branches of `modes` on grids of at least `points` flight times, with all their events."""
    return _joined(gamma_max, [branch_and_events(omega, xi, mode.periods, points) for mode in modes])


def orbits_of(
    on_demand: OnDemandCache,
    background: Background,
    omega: float,
    xi: float,
    modes: tuple[Mode, ...],
    gamma_max: float,
    points: int,
) -> Orbits:
    """`orbits`, computed by the workers if that takes long.

    Raises InvalidRequest for a spring without branches and for one whose branches need long grids, and as
    `OnDemandCache.get`.
    """
    seconds = 0.0
    for _, periods in modes:
        _check_grid(omega, xi, periods, points)
        seconds += branch_seconds(omega, xi, periods, points)
    if seconds <= AT_ONCE_SECONDS:
        return background.run(orbits, omega, xi, modes, gamma_max, points)
    found = on_demand.get(
        ("orbits", omega, xi, modes, points),
        lambda workers: [workers.call(branch_and_events, omega, xi, mode.periods, points) for mode in modes],
    )
    return _joined(gamma_max, found)


def _joined(gamma_max: float, found: Sequence[tuple[Branch, Events]]) -> Orbits:
    """The branches of all modes, at least one, and their events, up to `gamma_max`."""
    pieces = [_rows(branch, span) for branch, _ in found for span in _spans(branch.gamma <= gamma_max)]
    events = join_events([_rows(events, events.gamma <= gamma_max) for _, events in found])
    omega, xi = found[0][0].omega, found[0][0].xi
    energies = tuple(energy(omega, xi, piece.periods, piece.flight_time) for piece in pieces)
    return Orbits(omega, xi, gamma_max, tuple(pieces), energies, events)


def event_curves(
    on_demand: OnDemandCache,
    parameter: Parameter,
    fixed: float,
    span: tuple[float, float],
    modes: tuple[Mode, ...],
    kinds: tuple[Kind, ...],
    gamma_max: float,
) -> EventCurves:
    """Curves of the events of `modes` over `parameter` within `span`, computed by the workers.

    Raises InvalidRequest, also for more computing than one answer may take, and as `OnDemandCache.get`.
    """
    name = parameter.value
    if not span[0] < span[1]:
        raise InvalidRequest.of(f"{name}_stop", f"must be above {name}_start, {span[0]!r}")
    for _, periods in modes:
        for end in span:
            _check_grid(*((end, fixed) if parameter is Parameter.OMEGA else (fixed, end)), periods, 0)
    _check_curves(parameter, fixed, span, modes)
    submit = partial(_submit, parameter=parameter, fixed=fixed, span=span, modes=modes, kinds=kinds)
    try:
        parts: list[KernelCurves] = on_demand.get(("curves", parameter, fixed, span, modes, kinds), submit)
    except KernelInputError as error:
        named = {"low": f"{name}_start", "high": f"{name}_stop"}
        raise InvalidRequest.of(named.get(error.argument, error.argument), error.rule) from error
    pieces = [
        _rows(curve, span)
        for part in parts
        for curve in part.curves
        for span in _spans(curve.gamma <= gamma_max)
    ]
    points = join_events([_rows(part.points, part.points.gamma <= gamma_max) for part in parts])
    return EventCurves(parameter, fixed, tuple(pieces), points)


def words(
    on_demand: OnDemandCache,
    job: JobRecord,
    sweep: Sweep,
    omega: float | None,
    xi: float | None,
    direction: str | None,
    gamma_max: float,
) -> WordOrbits:
    """The branches of the cycles that the cells along gamma settled to, followed by a worker.

    Raises InvalidRequest as `selection.nearest_index` and `selection.resolve_direction`, and as
    `OnDemandCache.get`.
    """
    place = {"omega": nearest_index(sweep.spec, "omega", omega), "xi": nearest_index(sweep.spec, "xi", xi)}
    direction = resolve_direction(sweep.spec, direction)
    index = (sweep.spec.directions.index(direction), place["xi"].index, place["omega"].index)
    if not job.chunks_done:
        found = Words((), (), ())
    else:
        check_metadata(sweep)
        call = (continue_words, sweep.spec, sweep.url, *index, gamma_max, sweep.complete)
        key = ("words", job.id, job.chunks_done, *index, gamma_max)
        (found,) = on_demand.get(key, lambda executor: [executor.call(*call)])
    return WordOrbits(place["omega"].value, place["xi"].value, direction, gamma_max, found, sweep.complete)


def _submit(
    executor: Caller,
    *,
    parameter: Parameter,
    fixed: float,
    span: tuple[float, float],
    modes: Sequence[Mode],
    kinds: tuple[Kind, ...],
) -> list["Future[KernelCurves]"]:
    return [executor.call(curves, parameter, fixed, *span, periods, kinds) for _, periods in modes]


def _check_grid(omega: float, xi: float, periods: int, points: int) -> None:
    """Raise InvalidRequest for a branch that needs more than MAX_GRID flight times, or that there is not."""
    try:
        needed = len(flight_times(omega, xi, periods, max(points, 1)))
    except KernelInputError as error:
        raise InvalidRequest.of(error.argument, error.rule) from error
    if needed > MAX_GRID:
        rule = (
            f"1-{periods} at omega {omega:g} takes a branch of {needed:,} points; the limit is "
            f"{MAX_GRID:,}: ask for fewer periods, or take a larger omega"
        )
        raise InvalidRequest.of("modes", rule)


def _check_curves(
    parameter: Parameter, fixed: float, span: tuple[float, float], modes: Sequence[Mode]
) -> None:
    """Raise InvalidRequest for curves that take more than MAX_CURVES_SECONDS."""
    omega, xi = (span[0], fixed) if parameter is Parameter.OMEGA else (fixed, span[0])
    seconds = [CURVES_SECONDS * len(flight_times(omega, xi, periods, 1)) for _, periods in modes]
    if sum(seconds) > MAX_CURVES_SECONDS:
        fitting = int(np.searchsorted(np.cumsum(seconds), MAX_CURVES_SECONDS, "right"))
        rule = (
            f"their curves from omega {omega:g} on take about {sum(seconds):.0f} core-seconds, the limit for "
            f"one answer is {MAX_CURVES_SECONDS:g}: ask for the first {fitting}, or take a larger omega"
        )
        raise InvalidRequest.of("modes", rule)


def _spans(inside: NDArray[np.bool_]) -> list[slice]:
    """The runs of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]])))
    return [slice(low, high) for low, high in edges.reshape(-1, 2).tolist()]


def _rows(record: Record, rows: slice | NDArray[np.bool_]) -> Record:
    """A record of these rows of its arrays."""
    arrays: dict[str, Any] = {
        name: x[rows] for name, x in record._asdict().items() if isinstance(x, np.ndarray)
    }
    return record._replace(**arrays)
