"""Cycles of the rigid plate in closed form: branches at one spring, and curves of their events over a range.

Branches are computed while the caller waits, some milliseconds each; curves by the workers. All are of the
rigid contact without restitution.
"""

import re
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from kernel.branches.curves import CURVES, Curve, Parameter, curves
from kernel.branches.curves import Curves as KernelCurves
from kernel.branches.energy import Energy, energy
from kernel.branches.events import Branch, Events, Kind, branch_and_events, flight_times, join_events
from kernel.branches.thresholds import Thresholds
from kernel.params import KernelInputError
from service.errors import InvalidRequest, TooLarge
from service.jobs.on_demand import OnDemandCache
from worker.analysis.prediction import MAX_GRID, predict
from worker.executors.base import Executor
from worker.spec.errors import one_of

#: Modes of one answer, and plate periods of one mode.
MAX_MODES: Final = 6
MAX_PERIODS: Final = 12

#: Points of one branch that a caller may ask for.
MAX_POINTS: Final = 1_000

#: Answers kept: the least recently used one makes room.
KEPT: Final = 32

Record = TypeVar("Record", Branch, Curve, Events)

_MODE: Final = re.compile(r"([1-9][0-9]{0,3})-([1-9][0-9]{0,3})")


class Mode(NamedTuple):
    """A cycle's bounces and plate periods."""

    bounces: int
    periods: int


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
class EventCurves:
    """Curves of events in two parameters, cut where Γ leaves [0, gamma_max], and the points on them."""

    parameter: Parameter  # that varies
    fixed: float  # value of the other one
    curves: tuple[Curve, ...]  # connected pieces
    points: Events


def parse_modes(text: str) -> tuple[Mode, ...]:
    """Modes written as `1-1,1-2`: bounces and plate periods, of one bounce each. Raises InvalidRequest."""
    modes = []
    for part in text.split(","):
        match = _MODE.fullmatch(part.strip())
        if match is None:
            raise InvalidRequest.of("modes", f"must be like 1-1,1-2 (bounces-periods), not {part[:40]!a}")
        mode = Mode(int(match[1]), int(match[2]))
        if mode.bounces != 1:
            rule = "must be of one bounce, as 1-1 and 1-2: others follow from the cells of a sweep"
            raise InvalidRequest.of("modes", f"{rule}, not {part.strip()}")
        if mode.periods > MAX_PERIODS:
            raise InvalidRequest.of("modes", f"must have at most {MAX_PERIODS} periods, not {mode.periods}")
        modes.append(mode)
    if len(set(modes)) < len(modes):
        raise InvalidRequest.of("modes", "names a mode twice")
    if len(modes) > MAX_MODES:
        raise InvalidRequest.of("modes", f"must be at most {MAX_MODES}, not {len(modes)}")
    return tuple(sorted(modes))


def parse_kinds(text: str) -> tuple[Kind, ...]:
    """Kinds of curves, written as `fold,flip`. Raises InvalidRequest."""
    parts = [part.strip() for part in text.split(",")]
    unknown = [part for part in parts if part not in CURVES]
    if unknown:
        raise InvalidRequest.of("kinds", f"must be among {one_of(CURVES)}, not {unknown[0][:40]!a}")
    return tuple(kind for kind in CURVES if kind in parts)


@lru_cache(KEPT)
def thresholds(omega: float, xi: float) -> Thresholds:
    """The thresholds of one spring; `unresolved` where the theory does not decide."""
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


def _submit(
    executor: Executor,
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
