"""The bouncing ball: one rigid point mass on an ideal plate (paper section 2.1, MODEL section 2).

It falls freely (`kernel.fall`), leaves the plate again at -epsilon times the relative velocity
it landed with (Eq. 4, its sign mended), and rests on it while n = 1/Gamma - cos(phi) > 0. The
take-off from rest is at cos(phi) = 1/Gamma, in closed form. A cascade of ever smaller hops is
followed hop by hop, each of them a flight, until the plate presses steadily over all that is
left of it (`kernel.cascade`); its end is then in closed form, and its hops are no more recorded.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.cascade import collapse_time, collapses
from kernel.events import HORIZON, ROOT, SPENT, Phase
from kernel.fall import Landing, drop, landing, lifted, state_after, takes_off
from kernel.jit import jit
from kernel.model import contact, flies, flight, prepare, rest
from kernel.modes import TWO_PI

#: Evaluations that the flight from rest may use; it crosses at most about 2 Gamma inflections.
MANY: Final = 1_000_000


class BallPlate(NamedTuple):
    """The plate under each cell of a line."""

    restitution: NDArray[np.float64]  # (n,) epsilon; kernel.isolated.restitution_of(xi) where none is given


class Ball(NamedTuple):
    """One cell's constants."""

    gravity: float  # 1/Gamma
    restitution: float
    lift: float  # arccos(1/Gamma): the plate falls away while |phi| < lift; 0 for Gamma <= 1
    slope: float  # sin(lift)
    first: Landing  # the end of every flight from rest


@prepare.register(BallPlate)
@jit
def _prepare(plate: BallPlate, i: int, gamma: float, omega: float, xi: float) -> Ball:
    gravity = 1.0 / gamma
    slope = math.sqrt((1.0 - gravity) * (1.0 + gravity)) if gamma > 1.0 else 0.0
    lift = math.atan2(slope, gravity)
    first = Landing(math.inf, HORIZON, 0.0, 0.0, 0.0, 0)
    if lift > 0.0:
        first = landing(drop(gravity, lift, slope, TWO_PI - lift, 0.0, 0.0), math.inf, MANY)
    return Ball(gravity, plate.restitution[i], lift, slope, first)


@rest.register(Ball)
@jit
def _rest(b: Ball) -> tuple[float, float, float, float]:
    return 0.0, 0.0, 0.0, 0.0


@jit
def _settles(b: Ball, phi: float, hop: float, press: float, press1: float) -> bool:
    """Whether a ball leaving the plate at velocity `hop`, pressed back with n = press, may count as on it."""
    if lifted(b.lift, phi):
        return False
    return hop <= 0.0 or collapses(hop, press, press1, 1.0, b.restitution)


@flies.register(Ball)
@jit
def _flies(b: Ball, phi: float, gap: float, gap1: float, q: float, q1: float) -> bool:
    if gap > 0.0 or gap1 < 0.0:
        return True
    return not _settles(b, phi, gap1, b.gravity - math.cos(phi), math.sin(phi))


@contact.register(Ball)
@jit
def _contact(
    b: Ball, phi: float, gap: float, gap1: float, q: float, q1: float, horizon: float, budget: int
) -> Phase:
    """The rest of a cascade, if gap' > 0; else resting until take-off."""
    if budget <= 0:
        return Phase(0.0, SPENT, False, 0.0, gap1, 0.0, 0.0, 0)
    if gap1 > 0.0:
        end = collapse_time(gap1, b.gravity - math.cos(phi), math.sin(phi), b.restitution)
        if end >= horizon:  # the hops' velocities fall off evenly in time
            return Phase(horizon, HORIZON, False, 0.0, gap1 * (1.0 - horizon / end), 0.0, 0.0, 1)
        return Phase(end, ROOT, False, 0.0, 0.0, 0.0, 0.0, 1)
    wait = max(TWO_PI - b.lift - phi, 0.0) if b.lift > 0.0 else horizon
    if wait >= horizon:
        return Phase(horizon, HORIZON, False, 0.0, 0.0, 0.0, 0.0, 1)
    return Phase(wait, ROOT, True, 0.0, 0.0, 0.0, 0.0, 1)


@flight.register(Ball)
@jit
def _flight(
    b: Ball, phi: float, gap: float, gap1: float, q: float, q1: float, horizon: float, budget: int
) -> Phase:
    if takes_off(b.lift, phi, gap, gap1) and b.first.tau < horizon:
        end = b.first
        used = 1
    else:
        p = drop(b.gravity, b.lift, b.slope, phi, gap, gap1)
        end = landing(p, horizon, budget)
        used = end.used
        if end.ending != ROOT:
            gap, gap1, _, _ = state_after(p, end.tau)
            return Phase(end.tau, end.ending, True, max(gap, 0.0), gap1, 0.0, 0.0, used)
    hop = max(-b.restitution * end.gap1, 0.0)
    phi += end.tau
    phi -= TWO_PI * math.floor(phi / TWO_PI)
    settled = _settles(b, phi, hop, -end.gap2, -end.gap3)
    return Phase(end.tau, ROOT, not settled, 0.0, hop, 0.0, 0.0, used)
