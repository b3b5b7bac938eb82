"""The bouncing ball: one rigid point mass on an ideal plate (paper section 2.1, MODEL section 2).

It falls freely (`kernel.models.free_fall`), leaves the plate again at -epsilon times the relative velocity
it landed with (Eq. 4, its sign mended), and rests on it while n = 1/Gamma - cos(phi) > 0. The
take-off from rest is at cos(phi) = 1/Gamma, in closed form, and what follows it is the same every
time: an orbit that comes to rest again is known from then on (`_repeat`). A cascade of ever smaller hops is
followed hop by hop, each of them a flight, until the plate presses steadily over all that is
left of it (`kernel.models.chatter`); its end is then in closed form, and its hops are no more recorded:
they are shorter than about 1e-3 (1 - epsilon) rad.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.cell import Flights, Progress, Window, horizon_of, record
from kernel.interface import contact, contact_force, flies, flight, prepare, repeat, rest
from kernel.models.chatter import chatter_completes, chatter_time
from kernel.models.free_fall import drop, landing, lifted, state_after, takes_off
from kernel.modes import TWO_PI
from kernel.numerics.first_root import BUDGET_EXHAUSTED, HORIZON, ROOT, Phase
from kernel.numerics.jit import jit
from kernel.validation import check_arrays

#: Phases after a take-off from rest that a cell remembers, the next take-off among them if it comes so soon.
KNOWN: Final = 18

#: Where its memory holds how many, and the plate period of the take-off before; then of each phase its
#: duration, gap' after it, and 1 if a flight follows.
COUNT, BEFORE, FIRST = range(3)
TAU, HOP, FLIES = range(3)
WIDTH: Final = 3


class BallPlate(NamedTuple):
    """The plate under each cell of a line."""

    restitution: NDArray[
        np.float64
    ]  # (n,) epsilon; kernel.restitution.restitution_of(xi) where none is given


def plate(*, restitution: NDArray[np.float64]) -> BallPlate:
    """The plate under n cells; restitution (n,) in [0, 1]. Raises KernelInputError."""
    check_arrays({"restitution": restitution})
    return BallPlate(np.ascontiguousarray(restitution))


class Ball(NamedTuple):
    """One cell's constants."""

    gravity: float  # 1/Gamma
    restitution: float
    lift: float  # arccos(1/Gamma): the plate falls away while |phi| < lift; 0 for Gamma <= 1
    slope: float  # sin(lift)


@prepare.register(BallPlate)
@jit
def _prepare(plate: BallPlate, i: int, gamma: float, omega: float, xi: float) -> Ball:
    gravity = 1.0 / gamma
    slope = math.sqrt((1.0 - gravity) * (1.0 + gravity)) if gamma > 1.0 else 0.0
    return Ball(gravity, plate.restitution[i], math.atan2(slope, gravity), slope)


@rest.register(Ball)
@jit
def _rest(b: Ball) -> tuple[float, float, float, float]:
    return 0.0, 0.0, 0.0, 0.0


@jit
def _settles(b: Ball, phi: float, hop: float, press: float, press1: float) -> bool:
    """Whether a ball leaving the plate at velocity `hop`, pressed back with n = press, may count as on it."""
    if lifted(b.lift, phi):
        return False
    return hop <= 0.0 or chatter_completes(hop, press, press1, 1.0, b.restitution)


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
        return Phase(0.0, BUDGET_EXHAUSTED, False, 0.0, gap1, 0.0, 0.0, 0)
    if gap1 > 0.0:
        end = chatter_time(gap1, b.gravity - math.cos(phi), math.sin(phi), b.restitution)
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
        return Phase(0.0, BUDGET_EXHAUSTED, True, gap, gap1, 0.0, 0.0, 0)
    p = drop(b.gravity, b.lift, b.slope, phi, gap, gap1)
    end = landing(p, horizon, budget)
    if end.ending != ROOT:
        gap, gap1, _, _ = state_after(p, end.tau)
        return Phase(end.tau, end.ending, True, max(gap, 0.0), gap1, 0.0, 0.0, end.used)
    hop = max(-b.restitution * end.gap1, 0.0)
    phi += end.tau
    phi -= TWO_PI * math.floor(phi / TWO_PI)
    bounces = not _settles(b, phi, hop, -end.gap2, -end.gap3)
    return Phase(end.tau, ROOT, bounces, 0.0, hop, 0.0, 0.0, end.used)


@contact_force.register(Ball)
@jit
def _contact_force(b: Ball, cos: float, gap: float, gap1: float, q: float, q1: float) -> float:
    return max(b.gravity - cos, 0.0)


@jit
def _rehearse(b: Ball, phi: float, budget: int, memory: Any) -> None:
    """Note the phases from the take-off from rest at phi to the next, or the first of them."""
    flying, hop = True, 0.0
    for k in range(KNOWN):
        if flying:
            p = _flight(b, phi, 0.0, hop, 0.0, 0.0, math.inf, budget)
        else:
            p = _contact(b, phi, 0.0, hop, 0.0, 0.0, math.inf, budget)
        if p.ending != ROOT:
            return
        at = FIRST + WIDTH * k
        memory[at + TAU], memory[at + HOP], memory[at + FLIES] = p.tau, p.gap1, 1.0 if p.in_flight else 0.0
        memory[COUNT] = k + 1
        if not flying and p.in_flight:
            return
        phi += p.tau
        phi -= TWO_PI * math.floor(phi * (1.0 / TWO_PI))
        flying, hop = p.in_flight, p.gap1


@jit
def _skipped(run: Progress, window: Window, memory: Any) -> Progress:
    """The run at a take-off from rest, as many whole rounds later as the settling leaves room for."""
    length = max(run.period - int(memory[BEFORE]), 1)
    rounds = (window.settle - 1 - run.period) // length if memory[BEFORE] >= 0.0 else 0
    period = run.period + max(rounds, 0) * length
    memory[BEFORE] = period
    return Progress(
        run.phase, period, run.in_flight, run.gap, run.gap1, run.q, run.q1,
        run.phase, period, run.recorded, run.flew, run.budget, run.ending,
    )  # fmt: skip


@repeat.register(Ball)
@jit
def _repeat(b: Ball, run: Progress, window: Window, flights: Flights, memory: Any) -> Progress:
    """From one take-off from rest to the next, and so on: what follows is the same every time."""
    while run.in_flight and takes_off(b.lift, run.phase, run.gap, run.gap1) and run.budget > KNOWN:
        if memory[COUNT] == 0.0:
            memory[BEFORE] = -1.0
            _rehearse(b, run.phase, run.budget, memory)
            if memory[COUNT] == 0.0:
                break
        run = _skipped(run, window, memory)
        for k in range(int(memory[COUNT])):
            at = FIRST + WIDTH * k
            tau, hop, flying = memory[at + TAU], memory[at + HOP], memory[at + FLIES] == 1.0
            if tau >= horizon_of(run, window):
                return run
            run = record(run, Phase(tau, ROOT, flying, 0.0, hop, 0.0, 0.0, 1), window, flights, 0)
            if run.ending != ROOT:
                return run
    return run
