"""Where a stable cycle of any contact ends on the way down, followed through the cycles that it becomes.

The cycle goes on where its segments change, and beyond a flip as one of twice the period. It ends at a fold
or at rest. Branches do not decide its end at a torus, where numbers of hops accumulate, and where the next
cycle is unstable or leads up again.
"""

from typing import Final, NamedTuple

import numpy as np

from kernel.cycles.any_contact import up_to_shorter
from kernel.cycles.changes import doubled
from kernel.cycles.cycles import Cycles, Point
from kernel.cycles.energy import cycle_energy
from kernel.cycles.events import CROSSINGS, Kind
from kernel.cycles.folds import Cycle, Fold
from kernel.cycles.follow import End, Event, ahead, follow
from kernel.cycles.segments import START
from kernel.models import rigid
from kernel.numerics.elementary import TWO_PI

#: Limit on the flips that a cycle is followed through; they crowd together.
_FLIPS: Final = 4

#: Limit on the cycles between two flips.
_POINTS: Final = 200

#: Part of Gamma by which a branch may rise where its signature begins.
_RISES: Final = 1e-4

#: Step of derivatives along a branch. Their relative error is its square.
_ASIDE: Final = 1e-3

#: Events at which a stable cycle ends or loses stability.
_LAST: Final = (*CROSSINGS, *End)


class Descent(NamedTuple):
    """The end of a stable cycle on the way down."""

    gamma: float  # at the end, or the last Gamma known
    fold: Fold | None  # None if it ends at rest, where its flights vanish, or if the end is unknown
    reason: str  # why the end is unknown; empty otherwise
    last: Point | None = None  # the last cycle before an unknown end


def solved(omega: float, xi: float, cycle: Cycle) -> Point:
    """A known cycle of the closed form with the equations that it solves."""
    plate = rigid.plate(restitution=np.zeros(1))
    return Cycles(plate, omega, xi, cycle.letters, cycle.periods).on_branch(cycle.unknowns)


def descend(point: Point) -> Descent:
    """Follow a stable cycle down to its end. The reason says why if the end is unknown."""
    way = -1.0
    for _ in range(_FLIPS + 1):
        gamma, name = point.parameter, cycle_of(point).name
        if not point.stable:
            return Descent(gamma, None, f"{name} is not stable at Gamma = {gamma:.10g}", point)
        span = (0.0, gamma * (1.0 + _RISES))
        line, events = follow(point, way, points=_POINTS, span=span, until=lambda x: not x.stable)
        last = next((event for event in events if event.kind in _LAST), None)
        if last is None:
            gamma, name = line[-1].parameter, cycle_of(line[-1]).name
            leads = "leads up" if line[-1].stable else "is not stable"
            return Descent(gamma, None, f"{name} {leads} from Gamma = {gamma:.10g}", line[-1])
        gamma, name = last.point.parameter, cycle_of(last.point).name
        if last.kind is Kind.FOLD:
            fold = fold_of(last)
            if fold.holds:
                return Descent(gamma, fold, "")
            return Descent(gamma, None, f"{name} is not stable at its fold, Gamma = {gamma:.10g}", last.point)
        if last.kind is End.REST:
            return Descent(gamma, None, "")
        after = doubled(last.point) if last.kind is Kind.FLIP else None
        if after is None:
            return ended(last)
        point, way = after, 0.0
    return Descent(gamma, None, f"a cascade of flips at Gamma = {gamma:.10g}", point)


def ended(event: Event) -> Descent:
    """The end of a stable cycle at an event beyond which branches do not tell what bounces."""
    point = event.point
    reason = f"{cycle_of(point).name} ends at a {event.kind} at Gamma = {point.parameter:.10g}"
    if event.kind is Kind.NEIMARK_SACKER:
        turn = abs(np.angle(point.multipliers[0])) / TWO_PI
        reason += f": a torus begins with rotation number {turn:.6f}"
    return Descent(point.parameter, None, reason, point)


def folds_of_twice(flip: Point, below: float) -> list[Fold]:
    """The folds at which stable cycles of twice the period end, on the branch that begins at a flip.

    below: the branch is followed, with its unstable parts, as long as it stays below this Gamma, and to where
    it leads back to cycles of the period.
    """
    first = doubled(flip)
    if first is None:
        return []
    line = up_to_shorter(follow(first, 0.0, points=_POINTS, span=(0.0, below), crossings=(Kind.FOLD,)))
    folds = [fold_of(event) for event in line.events if event.kind is Kind.FOLD]
    return [fold for fold in folds if fold.curvature > 0.0 and fold.holds]


def fold_of(event: Event) -> Fold:
    """The record of a fold; NaN where a neighbour is missing."""
    point = event.point
    mu = point.multipliers
    mu = np.delete(mu, np.argmin(np.abs(mu - 1.0)))  # largest first
    curvature = slope = np.nan
    sides = [ahead(point, step) for step in (-_ASIDE, _ASIDE)]
    if sides[0] is not None and sides[1] is not None:
        curvature = (sides[0].parameter + sides[1].parameter - 2.0 * point.parameter) / _ASIDE**2
        # the product of 1 - mu vanishes at the fold; without its own factor it does not
        low, high = (np.prod(1.0 - side.multipliers) for side in sides if side is not None)
        slope = float(np.real((low - high) / (2.0 * _ASIDE * np.prod(1.0 - mu))))
    balance = cycle_energy(point) if set(point.letters) <= set("Ssz") else None
    first, other = point.flights[0], complex(mu[0])
    return Fold(cycle_of(point), first, point.parameter, other, curvature, slope, 0, balance)


def cycle_of(point: Point) -> Cycle:
    """The record of a cycle, without its equations."""
    return Cycle(point.letters, point.cycles.periods, point.x[: START + len(point.letters)])
