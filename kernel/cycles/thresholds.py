"""The lowest Gamma at which anything bounces, and where flights leap on the way up (docs/hysteresis.md).

Gamma_down is the lowest Gamma at which bouncing persists. Rest ends at Gamma_th (Eq. 25), and bouncing exists
above it. If the last attractor below is a (1,k) cycle, it ends at a fold of its branch. The rule is

    Gamma_down = min(Gamma_th, the lowest admissible fold whose other multiplier is inside the unit circle).

The rule is a conjecture: attractors that no (1,k) branch leads to may reach lower. It answers only at
dampings where a search found none. A stable cycle that ends below the answer without a fold is followed
through the cycles that it becomes. At a flip below Gamma_th the branch of twice the period is followed to its
own folds (`kernel.cycles.descent`, compiled; the rest is numpy alone). The answer is `unresolved` if a branch
turns below it at a fold that is unstable on both sides, near which a torus may live, or at one that is not
admissible, where the branch goes on as another word.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from kernel.cycles.closed_form import floquet, orbit, stable
from kernel.cycles.events import Branch, Events, Kind, branch, branch_and_events, flight_times, fold_events
from kernel.cycles.folds import Cycle, Fold, minima, one_flight
from kernel.cycles.roots import stretches
from kernel.cycles.spring import Spring, spring
from kernel.threshold import threshold

if TYPE_CHECKING:
    from kernel.cycles.cycles import Point
    from kernel.cycles.descent import Descent

#: The rule uses the branches (1,1) to (1, PERIODS).
PERIODS: Final = 6

#: Stable cycles are sought on the grid up to this many times Gamma_th. One that ends at a fold below Gamma_th
#: has a neighbour on the grid that is higher by at most Gamma'' h**2/2, some 1e-3.
_MARGIN: Final = 1.05

#: The lowest damping at which the rule decides. Searches found springs whose cycles reach lower than it says
#: up to xi = 0.032, and none from 0.035 on (docs/hysteresis.md, "How far the rule was searched").
SEARCHED_XI: Final = 0.04

EQ_25: Final = "Eq. 25"
UNRESOLVED: Final = "unresolved"
NOT_SEARCHED: Final = "not searched"


class Thresholds(NamedTuple):
    """The thresholds of a spring under a plate; by default not decided."""

    omega: float
    xi: float
    gamma_th: float  # rest ends there on the way up; Eq. 25 on an ideal plate
    jump: float = math.nan  # the fold at which flights leap on the way up; NaN if there is none
    down: float = math.nan  # Gamma_down, the lowest at which bouncing persists; NaN if not decided
    #: "Eq. 25", on other contacts "rest"; "fold (1,k)", "fold of word zs (2,2)" and the like; "unresolved",
    #: "not searched"
    cause: str = UNRESOLVED
    reason: str = ""  # why it is not decided, or may be lower
    cut: str = ""  # the part of it that a search leaves: where branches were cut off
    fold: Fold | None = None  # at `down`
    at_rest: str = EQ_25  # the cause if bouncing persists down to `gamma_th`

    def contradicted(self, bouncing: float) -> "Thresholds":
        """The same, unresolved: a simulation bounces at this Gamma below `down`."""
        bounces = f"bounces at Gamma = {bouncing:.10g}, as no cycle that was followed"
        reason = "; ".join(filter(None, [bounces, self.cut]))
        return self._replace(down=math.nan, cause=UNRESOLVED, reason=reason, fold=None)


def thresholds(omega: float, xi: float, cycles: Sequence["Point"] = ()) -> Thresholds:
    """The thresholds by `conjecture`, `not searched` below SEARCHED_XI. Raises KernelInputError."""
    return where_searched(conjecture(omega, xi, cycles))


def where_searched(answer: Thresholds) -> Thresholds:
    """The answer, or `not searched` below SEARCHED_XI, with the answer as the reason."""
    xi = answer.xi
    if xi >= SEARCHED_XI:
        return answer
    says = answer.reason or f"Gamma = {answer.down:.10g}"
    reason = (
        f"the rule was searched for what it misses from xi = {SEARCHED_XI:g} on; at {xi:g} other cycles may "
        f"reach lower than it says: {answer.cause}, {says}"
    )
    return answer._replace(down=math.nan, cause=NOT_SEARCHED, reason=reason, fold=None)


def conjecture(omega: float, xi: float, cycles: Sequence["Point"] = ()) -> Thresholds:
    """The thresholds by the rule at any damping, from the branches (1,1) to (1, PERIODS).

    cycles: stable cycles of settled cells of this spring; each is followed down, too. A fold below the answer
    that is unstable or not admissible leaves it unresolved, whatever the cycles: they do not show what lives
    near such a fold. Raises KernelInputError.
    """
    rule = closed_form(omega, xi)
    answer, folds = Thresholds(omega, xi, rule.gamma_th, rule.jump), list(rule.minima)
    if rule.decides and not cycles:
        return lowest_end(answer, folds, [])
    from kernel.cycles.descent import descend, folds_of_twice, solved  # noqa: PLC0415 - imports numba

    for flip in rule.flips:
        folds += folds_of_twice(solved(omega, xi, flip), rule.gamma_th)
    lowest, ends = _lowest(folds, rule.gamma_th), []
    for last in rule.last:
        if last.gamma < lowest:
            ends.append(descend(solved(omega, xi, last.within)))
            if ends[-1].fold is not None:  # other words led there, instead of the orbits beyond
                folds = [fold for fold in folds if not last.leads_to(fold)]
    return lowest_end(answer, folds, [*ends, *map(descend, cycles)])


def lowest_end(answer: Thresholds, folds: Sequence[Fold], ends: Sequence["Descent"]) -> Thresholds:
    """The answer with the lowest Gamma at which a cycle ends, or with the reasons why that is undecided.

    ends: of cycles that were followed.
    """
    last = [*(fold for fold in folds if fold.holds), *(end.fold for end in ends if end.fold is not None)]
    below = [fold for fold in last if fold.gamma < answer.gamma_th]
    lowest = min(below, key=lambda fold: fold.gamma, default=None)
    down = answer.gamma_th if lowest is None else lowest.gamma
    reasons = [end.reason for end in ends if end.reason and end.gamma < down]
    others = [fold for fold in folds if not fold.holds and fold.gamma < down]
    broken, unstable = ([x for x in others if bool(x.violations) is is_broken] for is_broken in (True, False))
    reasons += _why(broken, "not admissible: the branch goes on as another word")
    reasons += _why(unstable, "unstable on both sides: a torus may live near it")
    if reasons:
        return answer._replace(reason="; ".join(dict.fromkeys(reasons)))
    return answer._replace(down=down, cause=answer.at_rest if lowest is None else lowest.name, fold=lowest)


def _lowest(folds: Sequence[Fold], below: float) -> float:
    """The lowest Gamma of a fold at which a stable cycle ends; `below` if there is none."""
    return min((below, *(fold.gamma for fold in folds if fold.holds)))


class ClosedForm(NamedTuple):
    """The folds, ends and flips of the branches (1,1) to (1, PERIODS) below Gamma_th."""

    gamma_th: float
    jump: float  # NaN if there is none
    minima: list[Fold]
    last: "list[_LastCycle]"  # where stable cycles end without a fold
    flips: list[Cycle]  # the other cycles with a flip

    @property
    def decides(self) -> bool:
        """Whether no cycle has to be followed for the rule."""
        lowest = _lowest(self.minima, self.gamma_th)
        return not self.flips and all(cycle.gamma >= lowest for cycle in self.last)


@lru_cache(maxsize=64)
def closed_form(omega: float, xi: float) -> ClosedForm:
    """The part of the rule that needs nothing compiled. Raises KernelInputError."""
    flight_times(omega, xi, 1)  # refuses a spring without branches
    k, gamma_th = spring(omega, xi), float(threshold(omega, xi))
    jump = math.nan
    folds: list[Fold] = []
    cycles: list[_LastCycle] = []
    flips: list[Cycle] = []
    for n in range(1, PERIODS + 1):
        if n > 1 and not _reaches(k, omega, xi, n, gamma_th):
            folds += minima(k, fold_events(omega, xi, n, gamma_th), gamma_th)
            continue
        line, events = branch_and_events(omega, xi, n)
        folds += minima(k, events, gamma_th)
        last = _last_cycles(k, line, events, gamma_th)
        cycles += last
        at_flip = (events.kind == Kind.FLIP) & (events.gamma < gamma_th) & (events.violations == 0)
        followed = [cycle.flight_time for cycle in last]
        flips += [one_flight(k, n, float(t)) for t in events.flight_time[at_flip] if t not in followed]
        if n == 1:
            jump = _jump(line, events)
    return ClosedForm(gamma_th, jump, folds, cycles, flips)


def _reaches(k: Spring, omega: float, xi: float, periods: int, below: float) -> bool:
    """Whether a branch has a stable admissible cycle on its grid near or below a Gamma."""
    t = flight_times(omega, xi, periods)
    x, f = orbit(k, periods, t), floquet(k, periods, t)
    t = t[stable(f.trace, f.det) & (np.hypot(x.c, x.s) < _MARGIN * below)]
    return len(t) > 0 and bool((branch(omega, xi, periods, t).violations == 0).any())


def _why(folds: Sequence[Fold], what: str) -> list[str]:
    """That folds below the answer do not decide, as they are `what`; empty without any."""
    names = dict.fromkeys(f"the fold of {fold.cycle.name} at Gamma = {fold.gamma:.10g}" for fold in folds)
    return [f"{' and '.join(names)} {'is' if len(names) == 1 else 'are'} {what}"] if names else []


class _LastCycle(NamedTuple):
    """The end of stable cycles of a branch on the way down, without a fold."""

    gamma: float
    flight_time: float  # rad
    within: Cycle  # a stable cycle next to the end
    beyond: tuple[float, float]  # range of flight times, rad, of the orbits beyond that are not admissible

    def leads_to(self, fold: Fold) -> bool:
        """Whether a fold lies beyond the end, among the orbits that are not admissible."""
        low, high = self.beyond
        on_branch = fold.periods == self.within.periods and low <= fold.flight_time <= high
        return on_branch and bool(fold.violations)


def _last_cycles(k: Spring, line: Branch, events: Events, below: float) -> list[_LastCycle]:
    """The ends without a fold of the branch's stable cycles, below a Gamma."""
    lives = line.stable & (line.violations == 0)
    times, broken = line.flight_time.tolist(), stretches(line.violations != 0)
    cycles = []
    for first, last in stretches(lives):
        for inside, outside in ((first, first - 1), (last - 1, last)):
            if not 0 <= outside < len(lives):
                continue  # T -> 0 is Eq. 25; at T -> 2 pi k a contact vanishes, far above
            low, high = sorted((times[inside], times[outside]))
            between = (events.flight_time >= low) & (events.flight_time <= high)
            if line.gamma[outside] > line.gamma[inside] or (between & (events.kind == Kind.FOLD)).any():
                continue
            spans = ((times[i], times[j - 1]) for i, j in broken if i <= outside < j)
            beyond = next(spans, (math.inf, math.inf))
            within = one_flight(k, line.periods, times[inside])
            for i in np.flatnonzero(between & (events.gamma < below)):
                gamma, t = float(events.gamma[i]), float(events.flight_time[i])
                cycles.append(_LastCycle(gamma, t, within, beyond))
    return cycles


def _jump(line: Branch, events: Events) -> float:
    """Gamma of the fold at which the cycles that begin at Gamma_th end; NaN if they end otherwise."""
    lives = line.stable & (line.violations == 0)
    if not lives[0] or lives.all():
        return math.nan
    last = int(np.argmin(lives))
    low, high = line.flight_time[last - 1 : last + 1]
    between = (events.flight_time >= low) & (events.flight_time <= high)
    folds = np.flatnonzero(between & (events.kind == Kind.FOLD))
    return float(events.gamma[folds[0]]) if len(folds) else math.nan
