"""Predicted thresholds: in closed form for a rigid plate without restitution, for others by branches."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from kernel.cycles.contact_thresholds import thresholds_of
from kernel.cycles.cycles import Point
from kernel.cycles.events import POINTS, flight_times
from kernel.cycles.folds import lifetime
from kernel.cycles.thresholds import PERIODS, UNRESOLVED, Thresholds, closed_form, thresholds
from kernel.params import KernelInputError
from kernel.search import EFFORT, Searched, search
from kernel.threshold import threshold
from worker.analysis.cycles import lowest_cells
from worker.orbits.plan import SECONDS
from worker.orbits.specification import MAX_GRID
from worker.spec.contact_models import Contact, Rigid
from worker.sweep import SweepSpec
from worker.work import plate_at

#: Ending of a cause that a search found.
SEARCHED: Final = ", searched"

#: Core-seconds of one prediction, of one branch apart from its grid, and of a branch that grazes along its
#: whole length by rounding, as each graze is located.
_SECONDS: Final = 0.005
_BRANCH_SECONDS: Final = 3e-3
_GRAZING_SECONDS: Final = 0.25

#: Above this xi + xi/omega the dashpot is so strong that branches graze by rounding.
_STIFF: Final = 10_000.0


def prediction_seconds(omega: float, xi: float) -> float:
    """Estimated core-seconds of `predict`, usually too high."""
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
    """Why the branches of a spring cannot be searched; None if they can."""
    try:
        points = len(flight_times(omega, xi, 1, most=MAX_GRID))
    except KernelInputError as error:
        return str(error)
    if points > MAX_GRID:
        return f"omega: {omega:g} takes branches of {points:,} points; they are looked at up to {MAX_GRID:,}"
    return None


def decides(omega: float, xi: float) -> bool:
    """Whether `predict` needs only the closed form, and nothing compiled."""
    try:
        with np.errstate(all="ignore"):
            return _why_not(omega, xi) is not None or closed_form(omega, xi).decides
    except KernelInputError:
        return True


def predict(omega: float, xi: float) -> Thresholds:
    """As `thresholds`, for omega > 0 and xi >= 0; also `unresolved` if the branches cannot be searched."""
    reason = _why_not(omega, xi)
    if reason is not None:
        return Thresholds(omega, xi, float(threshold(omega, xi)), reason=reason)
    return of_contact(Rigid(), omega, xi)


def predict_each(omega: tuple[float, ...], xi: float) -> list[Thresholds]:
    """`predict` at every omega; runs on workers."""
    return [predict(value, xi) for value in omega]


def is_ideal(contact: Contact) -> bool:
    """Whether a contact is that of the closed form."""
    return isinstance(contact, Rigid) and contact.restitution == 0.0


def search_below(contact: Contact, omega: float, xi: float, effort: float = EFFORT) -> Searched:
    """The lowest end of bouncing that a search finds; runs on workers. Raises KernelInputError."""
    return search(plate_at(contact, 1.0, omega, xi), omega, xi, effort=effort)


def search_each(contact: Contact, omega: tuple[float, ...], xi: float) -> list[Thresholds]:
    """The thresholds of a contact, searched for where its branches leave them open; runs on workers."""
    return [_searched(contact, value, xi) for value in omega]


def _searched(contact: Contact, omega: float, xi: float) -> Thresholds:
    answer = of_contact(contact, omega, xi)
    if math.isfinite(answer.down) or not math.isfinite(answer.gamma_th):
        return answer
    try:
        end = search_below(contact, omega, xi)
    except KernelInputError:  # for which the answer has the reason
        return answer
    down, what = (end.gamma, end.what) if end.what else (answer.gamma_th, answer.at_rest)
    return answer._replace(down=down, cause=f"{what}{SEARCHED}", reason=answer.cut)


def predict_from_cells(
    spec: SweepSpec, url: str, xi: int, omegas: tuple[int, ...], complete: bool
) -> list[Thresholds]:
    """The thresholds of the sweep's contact at these indices, with cycles of its cells; runs on workers.

    The cells are those of lowest Gamma that settled, on the way down if the sweep goes down. On an ideal
    plate they count only if `predict` leaves a threshold unresolved. The lowest end of a cycle is the answer,
    unless a cell without time steps bounces below it or a lower fold is undecided. Raises a StoreError.
    """
    direction = spec.directions.index("down") if "down" in spec.directions else 0
    at_xi = float(spec.axis_values("xi")[xi])
    answers = []
    for omega in omegas:
        at_omega = float(spec.axis_values("omega")[omega])
        answer = predict(at_omega, at_xi)
        if math.isfinite(answer.gamma_th) and (answer.cause == UNRESOLVED or not is_ideal(spec.model)):
            settled, bouncing = lowest_cells(spec, url, (direction, xi, omega), complete)
            cycles = [cycle for cell in settled if (cycle := cell.cycle(spec)) is not None]
            if cycles or not is_ideal(spec.model):
                answer = of_contact(spec.model.exact, at_omega, at_xi, cycles)
                below, fold = answer.down - bouncing, answer.fold
                exact = spec.model == spec.model.exact  # time steps may bounce lower
                # just below a fold bouncing lasts longer than a window
                if exact and below > 0.0 and (fold is None or lifetime(fold, below) <= sum(spec.window)):
                    answer = answer.contradicted(bouncing)
        answers.append(answer)
    return answers


def of_contact(contact: Contact, omega: float, xi: float, cycles: Sequence[Point] = ()) -> Thresholds:
    """The thresholds of a contact; cycles: as in `kernel.cycles.thresholds.conjecture`."""
    try:
        if not is_ideal(contact):
            return thresholds_of(plate_at(contact, 1.0, omega, xi), omega, xi, cycles)
        with np.errstate(all="ignore"):  # an undamped spring may have poles
            return thresholds(omega, xi, cycles)
    except KernelInputError as error:
        return Thresholds(omega, xi, float(threshold(omega, xi)), reason=str(error))
