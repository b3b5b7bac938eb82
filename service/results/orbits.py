"""Cycles of the rigid plate in closed form: branches at one spring, and curves of their events over a range.

Branches are computed while the caller waits, some milliseconds each; curves by the workers. All are of the
rigid contact without restitution.
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
from kernel.branches.thresholds import Thresholds
from kernel.params import KernelInputError
from service.errors import InvalidRequest, TooLarge
from service.jobs.model import JobRecord
from service.jobs.on_demand import Caller, OnDemandCache
from service.results.selection import Sweep, nearest_index, resolve_direction
from worker.analysis.prediction import predict
from worker.analysis.words import Words, continue_words
from worker.orbits import MAX_GRID, Mode, check_modes, read_mode
from worker.spec.errors import BrokenRuleError, one_of

#: Answers kept: the least recently used one makes room.
KEPT: Final = 32
THRESHOLDS_KEPT: Final = 4096

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


@lru_cache(THRESHOLDS_KEPT)
def thresholds(omega: float, xi: float) -> Thresholds:
    """The thresholds of one spring; `unresolved` or `not searched` where the rule does not decide."""
    return predict(omega, xi)


@lru_cache(KEPT)
def orbits(omega: float, xi: float, modes: tuple[Mode, ...], gamma_max: float, points: int) -> Orbits:
    """The branches of `modes` on grids of at least `points` flight times, with all their events.

    Raises InvalidRequest for a spring without branches, TooLarge for one whose branches need long grids.
    """
    pieces: list[Branch] = []
    events: list[Events] = []
    for _, periods in modes:
        _check_grid(omega, xi, periods, points)
        try:
            branch, found = branch_and_events(omega, xi, periods, points)
        except KernelInputError as error:
            raise InvalidRequest.of(error.argument, error.rule) from error
        pieces += [_rows(branch, span) for span in _spans(branch.gamma <= gamma_max)]
        events.append(_rows(found, found.gamma <= gamma_max))
    energies = tuple(energy(omega, xi, piece.periods, piece.flight_time) for piece in pieces)
    return Orbits(omega, xi, gamma_max, tuple(pieces), energies, join_events(events))


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

    Raises InvalidRequest, TooLarge as `orbits`, and as `OnDemandCache.get`.
    """
    name = parameter.value
    if not span[0] < span[1]:
        raise InvalidRequest.of(f"{name}_stop", f"must be above {name}_start, {span[0]!r}")
    for _, periods in modes:
        for end in span:
            _check_grid(*((end, fixed) if parameter is Parameter.OMEGA else (fixed, end)), periods, 0)
    submit = partial(_submit, parameter=parameter, fixed=fixed, span=span, modes=modes, kinds=kinds)
    parts: list[KernelCurves] = on_demand.get(("curves", parameter, fixed, span, modes, kinds), submit)
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
    """Raise TooLarge for a branch that needs more than MAX_GRID flight times, InvalidRequest for none."""
    try:
        needed = len(flight_times(omega, xi, periods, max(points, 1)))
    except KernelInputError as error:
        raise InvalidRequest.of(error.argument, error.rule) from error
    if needed > MAX_GRID:
        raise TooLarge(
            f"modes: 1-{periods} at omega {omega:g} takes a branch of {needed:,} points; the limit is "
            f"{MAX_GRID:,}: ask for fewer periods, or take a larger omega"
        )


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
