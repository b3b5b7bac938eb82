"""The bouncing ball: one rigid point mass on an ideal plate (paper section 2.1, MODEL section 2).

It falls freely (`kernel.fall`), leaves the plate again at -epsilon times the relative velocity
it landed with (Eq. 4, its sign mended), and rests on it while n = 1/Gamma - cos(phi) > 0. The
take-off from rest is at cos(phi) = 1/Gamma, in closed form. A cascade of ever smaller hops is
followed hop by hop, each of them a flight, until the plate presses steadily over all that is
left of it (`kernel.cascade`); its end is then in closed form, and its hops are no more recorded:
they are shorter than about 1e-3 (1 - epsilon) rad.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.cascade import collapse_time, collapses
from kernel.events import HORIZON, ROOT, SPENT, Phase
from kernel.fall import SNAP, Landing, drop, landing, lifted, state_after
from kernel.jit import jit
from kernel.model import contact, flies, flight, prepare, rest
from kernel.modes import TWO_PI

#: Flights after a take-off from rest that a cell knows in advance.
KNOWN: Final = 16

#: Evaluations that each of them may use; a flight crosses about 2 Gamma inflections.
MANY: Final = 10_000


class BallPlate(NamedTuple):
    """The plate under each cell of a line."""

    restitution: NDArray[np.float64]  # (n,) epsilon; kernel.isolated.restitution_of(xi) where none is given


class Ball(NamedTuple):
    """One cell's constants."""

    gravity: float  # 1/Gamma
    restitution: float
    lift: float  # arccos(1/Gamma): the plate falls away while |phi| < lift; 0 for Gamma <= 1
    slope: float  # sin(lift)
    known: Any  # (KNOWN, 5) what follows a take-off from rest, see `_rehearse`


class Bounce(NamedTuple):
    """A landing and what follows it."""

    phi: float  # rad modulo 2 pi
    hop: float  # relative velocity after it
    flies: bool


@prepare.register(BallPlate)
@jit
def _prepare(plate: BallPlate, i: int, gamma: float, omega: float, xi: float) -> Ball:
    gravity = 1.0 / gamma
    slope = math.sqrt((1.0 - gravity) * (1.0 + gravity)) if gamma > 1.0 else 0.0
    ball = Ball(gravity, plate.restitution[i], math.atan2(slope, gravity), slope, np.full((KNOWN, 5), np.nan))
    _rehearse(ball)
    return ball


@jit
def _rehearse(b: Ball) -> None:
    """Work out what every take-off from rest leads to, for it is always the same.

    A row of `known` is a flight: its phase and velocity at take-off, its duration, the velocity
    after its landing, and 1 if a flight follows that; NaN where the ball rests before.
    """
    at = Bounce(TWO_PI - b.lift, 0.0, b.lift > 0.0)
    for row in b.known:
        if not at.flies:
            break
        end = landing(drop(b.gravity, b.lift, b.slope, at.phi, 0.0, at.hop), math.inf, MANY)
        if end.ending != ROOT:
            break
        row[0], row[1], row[2] = at.phi, at.hop, end.tau
        at = _bounce(b, at.phi, end)
        row[3], row[4] = at.hop, 1.0 if at.flies else 0.0


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
    if budget <= 0:
        return Phase(0.0, SPENT, True, gap, gap1, 0.0, 0.0, 0)
    if gap == 0.0:
        for k in range(KNOWN):
            if b.known[k, 1] == gap1 and abs(b.known[k, 0] - phi) <= SNAP and b.known[k, 2] < horizon:
                follows = b.known[k, 4] == 1.0
                return Phase(b.known[k, 2], ROOT, follows, 0.0, b.known[k, 3], 0.0, 0.0, 1)
            if math.isnan(b.known[k, 1]):
                break
    p = drop(b.gravity, b.lift, b.slope, phi, gap, gap1)
    end = landing(p, horizon, budget)
    if end.ending != ROOT:
        gap, gap1, _, _ = state_after(p, end.tau)
        return Phase(end.tau, end.ending, True, max(gap, 0.0), gap1, 0.0, 0.0, end.used)
    at = _bounce(b, phi, end)
    return Phase(end.tau, ROOT, at.flies, 0.0, at.hop, 0.0, 0.0, end.used)


@jit
def _bounce(b: Ball, phi: float, end: Landing) -> Bounce:
    """The landing `end` of a flight that took off at phi."""
    hop = max(-b.restitution * end.gap1, 0.0)
    phi += end.tau
    phi -= TWO_PI * math.floor(phi / TWO_PI)
    return Bounce(phi, hop, not _settles(b, phi, hop, -end.gap2, -end.gap3))
