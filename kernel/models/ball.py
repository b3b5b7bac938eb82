"""The bouncing ball: one rigid point mass on an ideal plate (paper section 2.1; docs/model.md, section 2).

It flies as a spring does whose elongation stays zero (`kernel.models.flight`), leaves the plate again at
-epsilon times the relative velocity it landed with (Eq. 4, with its sign corrected), and rests on it while
n = 1/Gamma - cos(phi) > 0. The take-off from rest is at cos(phi) = 1/Gamma, in closed form, and the same
motion follows it every time: a cell caches it and replays it (`_replay`). Chatter is followed hop by hop,
each of them a flight, until n is steady over the rest of it (`contact_law.chatter_completes`). Its end is
then in closed form, and its remaining hops, shorter than about 1e-2 (1 - epsilon) rad, are not recorded.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.cell import Progress, Window, changed, horizon_of, record
from kernel.interface import (
    Phase,
    PlatePhase,
    State,
    contact,
    contact_force,
    flies,
    flight,
    plate_phase,
    prepare,
    replay,
    rest,
)
from kernel.models.contact_law import chatter_completes, chatter_time
from kernel.models.flight import Flight, begin_flight, landing, short_hop, state_after
from kernel.modes import Flights
from kernel.numerics.elementary import TWO_PI
from kernel.numerics.first_root import BUDGET_EXHAUSTED, HORIZON, ROOT
from kernel.numerics.jit import inlined, jit
from kernel.numerics.oscillator import Oscillator
from kernel.params import check_arrays
from kernel.portable_math import atan2

TAKEOFF_TOLERANCE: Final = 4e-15  # rad from 2 pi - phi_lift of a take-off from rest: nine rounding errors

#: A spring without motion, of unit stiffness.
STILL: Final = Oscillator(0.0, 1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0)

CACHED_PHASES: Final = 18  # after a take-off from rest, up to the next; in 56 of the cell.CACHE_SIZE numbers

# Layout of a cell's cache (`interface.replay`): the number of phases, the plate period of the take-off
# before, then for each phase its duration, gap' after it, and 1.0 if a flight follows.
COUNT, BEFORE, FIRST = range(3)
TAU, HOP, FLIES = range(3)
WIDTH: Final = 3


class BallPlate(NamedTuple):
    """The plate under each cell of a line."""

    restitution: NDArray[np.float64]  # (n,) epsilon


def plate(*, restitution: NDArray[np.float64]) -> BallPlate:
    """The plate under n cells; restitution (n,) in [0, 1]. Raises KernelInputError."""
    check_arrays({"restitution": restitution})
    return BallPlate(np.ascontiguousarray(restitution))


class Ball(NamedTuple):
    """One cell's constants."""

    gravity: float  # 1/Gamma
    restitution: float
    phi_lift: float  # arccos(1/Gamma): n < 0 on the plate while |phi| < phi_lift; 0 for Gamma <= 1
    sin_lift: float  # sin(phi_lift)


@prepare.register(BallPlate)
@jit
def _prepare(plate: BallPlate, i: int, gamma: float, omega: float, xi: float) -> Ball:
    """The constants of cell i; omega and xi do not matter."""
    gravity = 1.0 / gamma
    sin_lift = math.sqrt((1.0 - gravity) * (1.0 + gravity)) if gamma > 1.0 else 0.0
    return Ball(gravity, plate.restitution[i], atan2(sin_lift, gravity), sin_lift)


@rest.register(Ball)
@jit
def _rest(b: Ball) -> State:
    return _state(0.0, 0.0)


@inlined
def _state(gap: float, gap1: float) -> State:
    """A state of the ball, which has no elongation."""
    return State(gap, gap1, 0.0, 0.0)


@jit
def plate_recedes(phi_lift: float, phi: float) -> bool:
    """Whether cos(phi) > 1/Gamma, phi in [0, 2 pi): the plate accelerates away from a mass at rest on it."""
    return phi < phi_lift or phi >= TWO_PI - phi_lift > math.pi


@jit
def takes_off(phi_lift: float, phi: float, state: State) -> bool:
    """Whether this state is the take-off from rest, within TAKEOFF_TOLERANCE."""
    on_plate = state.gap == 0.0 and state.gap1 == 0.0
    return on_plate and phi_lift > 0.0 and abs(phi - (TWO_PI - phi_lift)) <= TAKEOFF_TOLERANCE


@inlined
def fall(b: Ball, phi: PlatePhase, state: State) -> Flight:
    """The flight from gap >= 0 and gap' at phi in [0, 2 pi). From rest, cos(phi) is 1/Gamma exactly."""
    if takes_off(b.phi_lift, phi.rad, state):
        phi = PlatePhase(phi.rad, -b.sin_lift, b.gravity)
    return begin_flight(STILL, b.gravity, phi, _state(state.gap, state.gap1))


@jit
def _stays(b: Ball, phi: PlatePhase, hop: float) -> bool:
    """Whether a ball that leaves at velocity `hop` is taken to chatter in contact; phi in [0, 2 pi)."""
    if plate_recedes(b.phi_lift, phi.rad):
        return False
    return hop <= 0.0 or chatter_completes(hop, b.gravity - phi.cos, phi.sin, 1.0, b.restitution)


@flies.register(Ball)
@jit
def _flies(b: Ball, phi: PlatePhase, state: State) -> bool:
    """Off the plate, or leaving it."""
    if state.gap > 0.0 or state.gap1 < 0.0:
        return True
    return not _stays(b, phi, state.gap1)


@contact.register(Ball)
@jit
def _contact(b: Ball, phi: PlatePhase, state: State, horizon: float, budget: int) -> Phase:
    """With gap' > 0 the rest of the chatter, which ends in a contact; else resting until take-off."""
    if budget <= 0:
        return Phase(0.0, BUDGET_EXHAUSTED, False, _state(0.0, state.gap1), 0)
    if state.gap1 > 0.0:
        end = chatter_time(state.gap1, b.gravity - phi.cos, phi.sin, b.restitution)
        if end >= horizon:  # in a geometric series the hop velocity falls linearly in time
            return Phase(horizon, HORIZON, False, _state(0.0, state.gap1 * (1.0 - horizon / end)), 1)
        return Phase(end, ROOT, False, _state(0.0, 0.0), 1)
    wait = max(TWO_PI - b.phi_lift - phi.rad, 0.0) if b.phi_lift > 0.0 else horizon
    if wait >= horizon:
        return Phase(horizon, HORIZON, False, _state(0.0, 0.0), 1)
    return Phase(wait, ROOT, True, _state(0.0, 0.0), 1)


@flight.register(Ball)
@jit
def _flight(b: Ball, phi: PlatePhase, state: State, horizon: float, budget: int) -> Phase:
    if budget <= 0:
        return Phase(0.0, BUDGET_EXHAUSTED, True, _state(state.gap, state.gap1), 0)
    p = fall(b, phi, state)
    if p.gap == 0.0 and p.gap1 > 0.0 and p.gap2 < 0.0:
        end = short_hop(p, 0.0, 0.0, horizon, budget)
        if end.served:
            return _land(b, end.phi, end.tau, end.state.gap1, end.used)
    tau, ending, used = landing(p, 0.0, horizon, budget)
    gap, gap1, _, _ = state_after(p, tau)
    if ending != ROOT:
        return Phase(tau, ending, True, _state(max(gap, 0.0), gap1), used)
    return _land(b, plate_phase(phi.rad + tau), tau, gap1, used)


@inlined
def _land(b: Ball, phi: PlatePhase, tau: float, impact: float, used: int) -> Phase:
    """The end of a flight that lands at phi with gap' = `impact`."""
    hop = max(-b.restitution * impact, 0.0)
    phi = PlatePhase(phi.rad - TWO_PI * math.floor(phi.rad / TWO_PI), phi.sin, phi.cos)
    return Phase(tau, ROOT, not _stays(b, phi, hop), _state(0.0, hop), used)


@contact_force.register(Ball)
@jit
def _contact_force(b: Ball, phi: PlatePhase, state: State) -> float:
    """n of a ball at rest on the plate; 0 where rounding makes it negative."""
    return max(b.gravity - phi.cos, 0.0)


@jit
def _fill_cache(b: Ball, rad: float, budget: int, cache: Any) -> None:
    """Cache the phases from the take-off from rest at `rad` to the next one, or the first CACHED_PHASES."""
    flying, hop = True, 0.0
    for k in range(CACHED_PHASES):
        phi, state = plate_phase(rad), _state(0.0, hop)
        p = _flight(b, phi, state, math.inf, budget) if flying else _contact(b, phi, state, math.inf, budget)
        if p.ending != ROOT:
            return
        at = FIRST + WIDTH * k
        cache[at + TAU], cache[at + HOP] = p.tau, p.state.gap1
        cache[at + FLIES] = 1.0 if p.in_flight else 0.0
        cache[COUNT] = k + 1
        if not flying and p.in_flight:
            return
        rad += p.tau
        rad -= TWO_PI * math.floor(rad * (1.0 / TWO_PI))
        flying, hop = p.in_flight, p.state.gap1


@jit
def _skip_cycles(run: Progress, cache: Any) -> Progress:
    """The run at a take-off from rest, advanced by the cycles that fit into the settling."""
    length = max(run.period - int(cache[BEFORE]), 1)
    cycles = (run.settle - 1 - run.period) // length if cache[BEFORE] >= 0.0 else 0
    period = run.period + max(cycles, 0) * length
    cache[BEFORE] = period
    return changed(run, period=period, takeoff_phase=run.phase, takeoff_period=period)


@replay.register(Ball)
@jit
def _replay(b: Ball, run: Progress, window: Window, flights: Flights, cache: Any) -> Progress:
    """From one take-off from rest to the next by the cached phases, for as long as they lead there."""
    while run.in_flight and takes_off(b.phi_lift, run.phase, run.state) and run.budget > CACHED_PHASES:
        if cache[COUNT] == 0.0:
            cache[BEFORE] = -1.0
            _fill_cache(b, run.phase, run.budget, cache)
            if cache[COUNT] == 0.0:
                break
        run = _skip_cycles(run, cache)
        for k in range(int(cache[COUNT])):
            at = FIRST + WIDTH * k
            tau, hop, flying = cache[at + TAU], cache[at + HOP], cache[at + FLIES] == 1.0
            if tau >= horizon_of(run):
                return run
            run = record(run, Phase(tau, ROOT, flying, _state(0.0, hop), 1), window, flights, 0)
            if run.ending != ROOT:
                return run
    return run
