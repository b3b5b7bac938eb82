"""Thresholds of a spring: of an ideal plate by the rule, of any contact from cycles that were followed."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from kernel.branches.any_contact import branches
from kernel.branches.events import POINTS, flight_times
from kernel.branches.follow import RANGE
from kernel.branches.starts import stable_ranges
from kernel.branches.thresholds import EQ_25, PERIODS, UNRESOLVED, Thresholds, thresholds
from kernel.params import KernelInputError
from kernel.threshold import threshold
from worker.analysis.cycles import End, end_below, ends_on, jump_of, lowest_cells
from worker.orbits.plan import SECONDS
from worker.orbits.specification import MAX_GRID
from worker.spec.contact_models import Contact, Rigid
from worker.sweep import SweepSpec
from worker.work import plate_of

#: Core-seconds of one prediction, of one branch beside those of its grid, and of a branch that grazes along
#: its whole length by rounding: each graze is followed to its end.
_SECONDS: Final = 0.005
_BRANCH_SECONDS: Final = 3e-3
_GRAZING_SECONDS: Final = 0.25

#: If xi + xi/omega is larger, the dashpot is so strong that branches graze by rounding.
_STIFF: Final = 300.0

#: Branches of a contact are followed up to this many times Eq. 25: as far as the fold where flights leap.
_REACH: Final = 3.0


def prediction_seconds(omega: float, xi: float) -> float:
    """Approximate core-seconds of `predict`, usually too many rather than too few."""
    if _why_not(omega, xi) is not None:
        return 0.0
    first = branch_seconds(omega, xi, 1)
    return _SECONDS + first + (PERIODS - 1) * _GRAZING_SECONDS * _grazes(omega, xi)


def branch_seconds(omega: float, xi: float, periods: int, points: int = POINTS) -> float:
    """Core-seconds of a branch with its events on a grid of at least `points`. Raises KernelInputError."""
    needed = len(flight_times(omega, xi, periods, points))
    return _BRANCH_SECONDS + SECONDS * needed**2 + _GRAZING_SECONDS * _grazes(omega, xi)


def _grazes(omega: float, xi: float) -> bool:
    return xi + xi / omega > _STIFF


def _why_not(omega: float, xi: float) -> str | None:
    """Why the branches of a spring are not searched; None if they are."""
    try:
        points = len(flight_times(omega, xi, 1, most=MAX_GRID))
    except KernelInputError as error:
        return str(error)
    if points > MAX_GRID:
        return f"omega: {omega:g} takes branches of {points:,} points; they are looked at up to {MAX_GRID:,}"
    return None


def predict(omega: float, xi: float) -> Thresholds:
    """As `thresholds`, omega > 0 and xi >= 0; `unresolved` also where the branches are not searched."""
    reason = _why_not(omega, xi)
    return _thresholds(omega, xi) if reason is None else _undecided(omega, xi, reason)


def predict_each(omega: tuple[float, ...], xi: float) -> list[Thresholds]:
    """`predict` at every omega: a call for workers."""
    return [predict(value, xi) for value in omega]


def is_ideal(contact: Contact) -> bool:
    """Whether a contact is that of the closed form."""
    return isinstance(contact, Rigid) and contact.restitution == 0.0


def predict_from_cells(
    spec: SweepSpec, url: str, xi: int, omegas: tuple[int, ...], complete: bool
) -> list[Thresholds]:
    """The thresholds at these indices from the cycles of the sweep's own cells; runs on workers.

    Of an ideal plate, only where `predict` leaves them unresolved. The cells are those of lowest Gamma that
    settled, on the way down if the sweep goes down: the lowest fold at which one of their cycles ends is the
    answer, unless a cell bounces below it. Raises a `store.StoreError`.
    """
    at_xi = float(spec.axis_values("xi")[xi])
    answers = []
    for index in omegas:
        omega = float(spec.axis_values("omega")[index])
        answer = predict(omega, at_xi) if is_ideal(spec.model) else None
        if answer is None or (answer.cause == UNRESOLVED and math.isfinite(answer.gamma_th)):
            direction = spec.directions.index("down") if "down" in spec.directions else 0
            answer = _from_line(spec, url, (direction, xi, index), complete, answer)
        answers.append(answer)
    return answers


def _from_line(
    spec: SweepSpec, url: str, line: tuple[int, int, int], complete: bool, known: Thresholds | None
) -> Thresholds:
    """The thresholds of one line of cells; `known` where they do not decide either."""
    settled, bouncing = lowest_cells(spec, url, line, complete)
    cycles = [cycle for each in settled if (cycle := each.cycle(spec)) is not None]
    omega, xi = (float(spec.axis_values(axis)[i]) for axis, i in (("omega", line[2]), ("xi", line[1])))
    if not cycles:
        return known or _undecided(omega, xi, "no cell settled to a cycle that was found again")
    ends = [end_below(cycle, spec.micro_flight) for cycle in cycles]
    return _lowest(omega, xi, ends, bouncing)


def contact_thresholds(contact: Contact, omega: float, xi: float) -> Thresholds:
    """The thresholds of a contact from the branches that lead through Gamma below Eq. 25; runs on workers.

    They begin at cycles of the closed form (1,1) to (1, PERIODS). Raises KernelInputError.
    """
    gamma_th = float(threshold(omega, xi))
    top = _REACH * gamma_th
    if not math.isfinite(top):
        return _undecided(omega, xi, "a spring at rest bounces at no Gamma")
    plate = plate_of(contact, np.full(1, top), np.full(1, omega), np.full(1, xi))
    ends: list[End] = []
    jump = math.nan
    for periods in range(1, PERIODS + 1):
        lows = [low for low, _ in stable_ranges(omega, xi, periods)]
        if periods > 1 and min(lows, default=math.inf) > gamma_th:
            continue
        for branch in branches(plate, omega, xi, periods, span=(RANGE[0], top)):
            ends += ends_on(branch, gamma_th)
            jump = jump_of(branch) if periods == 1 and not math.isfinite(jump) else jump
    return _lowest(omega, xi, ends, math.inf, jump)


def _lowest(
    omega: float, xi: float, ends: Sequence[End], bouncing: float, jump: float = math.nan
) -> Thresholds:
    """The thresholds from where cycles end, and the lowest Gamma at which a cell bounces."""
    gamma_th = float(threshold(omega, xi))
    rest = End(gamma_th, EQ_25)
    folds = (end for end in ends if end.cause and end.cause != EQ_25)
    end = min((rest, *folds), key=lambda end: end.gamma)
    reasons = [other.reason for other in ends if other.reason and other.gamma < end.gamma]
    if bouncing < end.gamma:
        reasons.append(f"bounces at Gamma = {bouncing:.6f}, as no cycle that was followed")
    if reasons:
        return _undecided(omega, xi, "; ".join(dict.fromkeys(reasons)))._replace(jump=jump)
    return Thresholds(omega, xi, gamma_th, jump, end.gamma, end.cause, "", None)


def _thresholds(omega: float, xi: float) -> Thresholds:
    try:
        with np.errstate(all="ignore"):  # an undamped spring may have poles
            return thresholds(omega, xi)
    except KernelInputError as error:
        return _undecided(omega, xi, str(error))


def _undecided(omega: float, xi: float, reason: str) -> Thresholds:
    gamma_th = float(threshold(omega, xi))
    return Thresholds(omega, xi, gamma_th, math.nan, math.nan, UNRESOLVED, reason, None)
