"""The thresholds of any contact, from the branches of its cycles below the Gamma at which rest ends.

The rule is that of `kernel.cycles.thresholds`. The branches are those that cycles of the closed form lead to.
Other families are missed, so that the lowest end is an upper bound. Where the closed form has a fold that
does not decide, and no branch has a fold there, the answer is `unresolved`.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import chain, groupby, islice
from typing import Any, Final

from kernel.cycles.any_contact import all_through, beside, cut_off, seeds
from kernel.cycles.cycles import Point
from kernel.cycles.descent import Descent, descend, fold_of, folds_of_twice
from kernel.cycles.events import Kind
from kernel.cycles.folds import Fold
from kernel.cycles.follow import End, Event, Followed
from kernel.cycles.starts import start_on_cycle
from kernel.cycles.thresholds import PERIODS, Thresholds, closed_form, lowest_end, where_searched
from kernel.interface import prepare
from kernel.params import Cell

#: Branches are followed up to this many times the Gamma at which rest ends: past folds where flights leap.
_REACH: Final = 3.0

#: Distances above a fold of the closed form, relative, at which a cycle of the contact is sought.
_ABOVE: Final = (1e-3, 1e-2)
#: A fold of the contact this close to one of the closed form, relative, corresponds to it.
_NEAR: Final = 0.01


def thresholds_of(plate: Any, omega: float, xi: float, cycles: Sequence[Point] = ()) -> Thresholds:
    """The thresholds of a spring on a plate of one cell, restitution < 1; `not searched` below SEARCHED_XI.

    cycles: as in `thresholds.conjecture`. Raises KernelInputError.
    """
    gamma_th = rest_ends(plate, omega, xi)
    answer = Thresholds(omega, xi, gamma_th, at_rest="rest")
    if not math.isfinite(gamma_th):
        return answer._replace(reason="a spring at rest bounces at no Gamma")
    folds: list[Fold] = []
    ends: list[Descent] = [descend(cycle) for cycle in cycles]
    cut: list[Event] = []
    ideal = closed_form(omega, xi)
    span = (0.0, _REACH * gamma_th)
    for periods in range(1, PERIODS + 1):
        ideal_folds = [fold for fold in ideal.minima if fold.periods == periods]
        if periods > 1 and not ideal_folds:
            continue
        lines = all_through(
            chain(seeds(plate, omega, xi, periods), above(plate, omega, xi, ideal_folds)), span
        )
        cut += cut_off(lines)
        if periods == 1 and lines:
            answer = answer._replace(jump=_jump(lines[0]))
        below = [event for line in lines for event in line.events if event.point.parameter < gamma_th]
        minima = [fold for fold in (fold_of(x) for x in below if x.kind is Kind.FOLD) if fold.curvature > 0.0]
        folds += minima  # a stable stretch beside one may have no point of the branch
        unmatched = (x for x in ideal_folds if all(abs(y.gamma / x.gamma - 1.0) >= _NEAR for y in minima))
        folds += [fold for fold in unmatched if not fold.holds]
        flips = (event.point for event in below if event.kind is Kind.FLIP)
        folds += [fold for flip in flips for fold in folds_of_twice(flip, gamma_th)]
        lowest = (point for line in lines for point in lowest_stable(line))
        ends += [descend(point) for point in lowest if point.parameter < gamma_th]
    answer = where_searched(lowest_end(answer, folds, ends))
    at = ", ".join(dict.fromkeys(f"{gamma:.4g}" for gamma in sorted(end.point.parameter for end in cut)))
    beyond = f"branches were cut off at Gamma = {at}: beyond, bouncing may reach lower" if cut else ""
    return answer._replace(reason="; ".join(filter(None, [answer.reason, beyond])), cut=beyond)


def rest_ends(plate: Any, omega: float, xi: float) -> float:
    """Gamma at which a spring at rest loses contact, infinite if it never does; Eq. 25 for an ideal plate.

    `margin` is weight/Gamma - drive, in plate amplitudes: two values of Gamma give weight and drive.
    """
    at_one, at_two = (prepare(plate, 0, gamma, omega, xi).margin for gamma in (1.0, 2.0))
    drive = at_one - 2.0 * at_two
    return 2.0 * (at_one - at_two) / drive if drive > 0.0 else math.inf


def above(
    plate: Any, omega: float, xi: float, folds: Sequence[Fold], aside: Sequence[float] = _ABOVE
) -> Iterator[Point]:
    """Cycles of a contact above folds of the closed form.

    aside: relative distances in Gamma, tried in turn; each fold gives the first cycle found.
    """
    for fold in folds:
        cells = (Cell(fold.gamma * (1.0 + away), omega, xi) for away in aside)
        starts = (start_on_cycle(cell, fold.periods, fold.flight_time) for cell in cells)
        yield from islice(filter(None, (beside(plate, start, fold.periods) for start in starts)), 1)


def lowest_stable(line: Followed) -> Iterator[Point]:
    """The cycle of lowest Gamma in each stable stretch of a branch."""
    for stable, stretch in groupby(line.points, key=lambda point: point.stable):
        if stable:
            yield min(stretch, key=lambda point: point.parameter)


def _jump(line: Followed) -> float:
    """Gamma of the fold at which the cycles that begin at rest end; NaN if they end otherwise."""
    events = line.events if line.events and line.events[0].kind is End.REST else line.events[::-1]
    if not events or events[0].kind is not End.REST:
        return math.nan
    last = next((event for event in events[1:] if event.turns or event.kind in (Kind.FLIP, *End)), None)
    return last.point.parameter if last is not None and last.kind is Kind.FOLD else math.nan
