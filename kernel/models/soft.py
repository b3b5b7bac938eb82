"""The bouncing spring on a soft plate, solved exactly (paper Eqs. 9 to 12; docs/model.md, section 2).

In contact the plate pushes with n = -(kappa gap + beta gap'), and the motion is known in closed form
(`kernel.models.soft_contact`). No time steps are needed however stiff the contact is, and the search for
the take-off steps over the contact's ringing as soon as that is too small to lift the mass.

adhesive: contact while gap < 0; take-off and landing are zeros of the gap, and n may pull.
nonadhesive: contact while gap < 0 and n > 0, so that a flight begins below the plate's surface. Until the
mass is above it, n would turn positive again where kappa gap + beta gap' falls to zero (`Recontact`).
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel import interface
from kernel.cell import Progress
from kernel.interface import Phase, PlatePhase, State, plate_phase
from kernel.models import lanes
from kernel.models.contact_law import lifted_off, plate_force
from kernel.models.flight import Flight, begin_flight, flight_terms, landing, short_hop, state_after
from kernel.models.soft_contact import (
    LiftoffFunction,
    ModalState,
    SoftSpring,
    gap_rings,
    liftoff_function,
    modes_of,
    soft_spring,
    state_of,
    sure_contact_time,
    terms_of_parts,
)
from kernel.numerics.elementary import sincos
from kernel.numerics.first_root import EPS, HORIZON, ROOT, Terms, departure_step, first_root, terms
from kernel.numerics.jit import inlined, jit
from kernel.numerics.oscillator import all_derivatives, apart, derivatives, motion, propagator, quiet_time
from kernel.params import check_arrays


class SoftPlate(NamedTuple):
    """The plate under each cell of a line."""

    restitution: NDArray[np.float64]  # (n,) e of an isolated impact under the chosen law
    penetration: NDArray[np.float64]  # (n,) d, plate amplitudes
    adhesive: bool


def plate(*, restitution: NDArray[np.float64], penetration: NDArray[np.float64], adhesive: bool) -> SoftPlate:
    """The plate under n cells; restitution (n,) in [0, 1], penetration (n,) > 0 in plate amplitudes.

    Raises KernelInputError.
    """
    check_arrays({"restitution": restitution, "penetration": penetration})
    return SoftPlate(np.ascontiguousarray(restitution), np.ascontiguousarray(penetration), bool(adhesive))


#: Rounding of the gap's acceleration, in those of the plate: it is zero at a take-off.
ROUNDING: Final = 1e-9


class Recontact(NamedTuple):
    """kappa gap + beta gap' as the phase function of a flight below the surface; zero at recontact."""

    flight: Flight
    kappa: float
    beta: float


@interface.prepare.register(SoftPlate)
@jit
def _prepare(plate: SoftPlate, i: int, gamma: float, omega: float, xi: float) -> SoftSpring:
    return soft_spring(gamma, omega, xi, plate.restitution[i], plate.penetration[i], plate.adhesive)


@interface.contact_force.register(SoftSpring)
@jit
def _contact_force(s: SoftSpring, phi: PlatePhase, state: State) -> float:
    return plate_force(s.kappa, s.beta, state.gap, state.gap1)


@interface.rest.register(SoftSpring)
@jit
def _rest(s: SoftSpring) -> State:
    return State(s.static_gap, 0.0, s.static_elongation, 0.0)


@interface.relative_margin.register(SoftSpring)
@inlined
def _relative_margin(s: SoftSpring) -> float:
    return s.margin / s.static_lift


@interface.flies.register(SoftSpring)
@jit
def _flies(s: SoftSpring, phi: PlatePhase, state: State) -> bool:
    """Not in contact under the cell's law; on the surface, without a velocity, if the gap opens."""
    if state.gap == 0.0 and state.gap1 == 0.0:
        opening = phi.cos - s.gravity + s.flight.damping * state.q1 + 0.5 * s.flight.stiffness * state.q
        return opening > -ROUNDING
    return lifted_off(state.gap, state.gap1, s.kappa, 0.0 if s.adhesive else s.beta)


@inlined
def begin_contact(
    s: SoftSpring, phi: PlatePhase, state: State
) -> tuple[ModalState, LiftoffFunction, Terms, float, bool]:
    """The contact from this state: its modes, its lift-off function with its terms now, and where to search.

    That is from a time (rad) until which the mass surely stays; the last value is whether it always stays,
    both free modes being too small to lift it.
    """
    m = modes_of(s, phi, state)
    p = liftoff_function(s, m, phi.rad)
    slow = all_derivatives(p.slow_osc, p.slow_a, p.slow_b)
    fast = all_derivatives(p.fast_osc, p.fast_a, p.fast_b)
    t = terms_of_parts(p, phi.sin, phi.cos, slow, fast)
    if state.gap < 0.0 and not s.adhesive and apart(p.fast_osc):
        # n is a small difference of kappa gap and beta gap'; the modes' sum has a few times its rounding
        # error, which is given to the fast exponential, where it came from
        fast_b = p.fast_b + (plate_force(s.kappa, s.beta, state.gap, state.gap1) - (t.smooth + t.ring))
        p = LiftoffFunction(
            p.slow_osc, p.fast_osc, p.phi, p.static, p.wave_re, p.wave_im, p.slow_a, p.slow_b, p.fast_a,
            fast_b,
        )  # fmt: skip
        fast = all_derivatives(p.fast_osc, p.fast_a, p.fast_b)
        t = terms_of_parts(p, phi.sin, phi.cos, slow, fast)
    return m, p, t, sure_contact_time(p, t), slow.size + fast.size < s.margin


@interface.contact.register(SoftSpring)
@jit
def _contact(s: SoftSpring, phi: PlatePhase, state: State, horizon: float, budget: int) -> Phase:
    """In contact until the lift-off function falls to zero, or both modes are too small for that."""
    m, p, _, start, stays = begin_contact(s, phi, state)
    end = 0.0
    if not stays:  # until both modes have decayed
        slow = quiet_time(p.slow_osc, p.slow_a, p.slow_b, 0.5 * s.margin)
        end = min(horizon, max(slow, quiet_time(p.fast_osc, p.fast_a, p.fast_b, 0.5 * s.margin)))
    tau, ending, used = first_root(p, start, end, budget)
    touches = s.adhesive and state.gap == 0.0 and state.gap1 == 0.0  # F = F' = 0: rounding tells nothing
    if ending == ROOT and (tau == 0.0 or touches):
        if _lifts(s, begin_flight(s.flight, s.gravity, phi, state)):
            return Phase(0.0, ROOT, True, _taking_off(s, state), used)
        tau, ending, more = first_root(p, 1.0 / s.gap_mode.rate, end, budget - used)
        used += more
    if ending == HORIZON:
        tau = horizon
    over = propagator(s.gap_mode, tau), propagator(s.elongation_mode, tau)
    state = state_of(s, m, plate_phase(phi.rad + tau), *over)
    if ending == ROOT:
        state = _taking_off(s, state)
    return Phase(tau, ending, ending == ROOT, state, used)


@inlined
def _taking_off(s: SoftSpring, x: State) -> State:
    """The state x of a take-off, without the rounding of a gap that is zero there."""
    return State(0.0, max(x.gap1, 0.0), x.q, x.q1) if s.adhesive else x


@inlined
def _landing(x: State) -> State:
    """The state x of a landing, without the rounding of its gap."""
    return State(0.0, min(x.gap1, 0.0), x.q, x.q1)


@jit
def _lifts(s: SoftSpring, p: Flight) -> bool:
    """Whether a mass with n = 0 takes off, `p` being the flight that would follow.

    Contact and flight both ask it where they would end at once, or both might without end by rounding.
    """
    if s.adhesive or (p.gap == 0.0 and p.gap1 == 0.0):
        return p.gap1 > 0.0 or (p.gap1 == 0.0 and p.gap2 > 0.0)
    return s.kappa * p.gap1 + s.beta * p.gap2 > 0.0  # -n'


@terms.register(Recontact)
@jit
def _recontact_terms(p: Recontact, tau: float) -> Terms:
    """kappa times the flight's terms plus beta times the next higher derivatives; not separated in parts."""
    f = p.flight
    t = flight_terms(f, tau)
    q, q1 = motion(f.osc, f.q, f.q1, tau)
    q2, q3, _ = derivatives(f.osc, q, q1)
    q4, _, _ = derivatives(f.osc, q2, q3)
    _, _, bound5 = derivatives(f.osc, q1, q2)
    _, cos = sincos(f.phi + tau)
    gap4 = -cos - 0.5 * q4
    k, c = p.kappa, p.beta
    f0 = k * (t.smooth + t.ring) + c * (t.smooth1 + t.ring1)
    f1 = k * (t.smooth1 + t.ring1) + c * (t.smooth2 + t.ring2)
    f2 = k * (t.smooth2 + t.ring2) + c * (t.smooth3 + t.ring3)
    f3 = k * (t.smooth3 + t.ring3) + c * gap4
    f4 = k * (t.smooth4 + t.ring4) + c * (1.0 + 0.5 * bound5)
    noise = k * t.noise + 4.0 * EPS * c * abs(t.smooth1 + t.ring1)
    return Terms(f0, f1, f2, f3, f4, 0.0, 0.0, 0.0, 0.0, 0.0, math.inf, noise)


@inlined
def emergence_bound(s: SoftSpring, p: Flight) -> float:
    """Rad by which a mass from below the surface is surely above it without recontact; 0: not sure."""
    if p.gap1 <= 0.0:
        return 0.0
    time = -2.0 * p.gap / p.gap1  # twice that at constant velocity
    _, q3, q4 = derivatives(p.osc, p.q, p.q1)
    # gap'' is at least a parabola that opens downwards, whose lowest value is at an end
    lowest = min(p.gap2, p.gap2 + time * ((-p.sin - 0.5 * q3) - 0.5 * time * (1.0 + 0.5 * q4)), 0.0)
    # kappa gap + beta gap', zero at take-off, only grows
    grows = s.kappa * (p.gap1 + time * lowest) + s.beta * lowest > 0.0
    return time if grows and 0.5 * lowest * time * time > p.gap else 0.0


@jit
def _below_surface(s: SoftSpring, p: Flight, horizon: float, budget: int) -> tuple[float, int, int]:
    """Follow a flight from below the surface: (tau, ending, evaluations used), as `first_root`.

    ROOT with a gap <= 0: back in contact. Otherwise, with a gap >= 0, the mass has emerged and not landed.
    While c(tau) = kappa gap + beta gap' is positive, gap exp(kappa/beta tau) grows, so that the gap passes
    zero at most once: where it is positive it has been since. So only zeros of c are searched, up to a time
    by which the mass should have emerged, and beyond if it has not.
    """
    below = Recontact(p, s.kappa, s.beta)
    tau, used, end = 0.0, 0, 0.0
    gap, gap1 = p.gap, p.gap1
    while True:
        # twice the time to the surface at constant velocity
        end = min(max(tau - 2.0 * gap / gap1, 2.0 * end) if gap1 > 0.0 else horizon, horizon)
        tau, ending, more = first_root(below, tau, end, budget - used)
        used += more
        if tau == 0.0 and ending == ROOT and _lifts(s, p):
            start = min(1.0 / s.gap_mode.rate, horizon)
            tau, ending, more = first_root(below, start, min(max(end, 2.0 * start), horizon), budget - used)
            used += more
        gap, gap1, _, _ = state_after(p, tau)
        if ending != HORIZON or gap >= 0.0 or tau >= horizon:
            return tau, ending, used


@interface.flight.register(SoftSpring)
@jit
def _flight(s: SoftSpring, phi: PlatePhase, state: State, horizon: float, budget: int) -> Phase:
    """In flight until landing. One from below the surface may return to contact before it emerges."""
    p = begin_flight(s.flight, s.gravity, phi, state)
    emerged, used = 0.0, 0
    if state.gap < 0.0:
        emerged = emergence_bound(s, p)
        if emerged == 0.0:
            hop = short_hop(p, s.beta / s.kappa, 0.0, horizon, budget)
            emerged, ending, used, state = hop.tau, ROOT, hop.used, hop.state
            if not hop.served:
                emerged, ending, used = _below_surface(s, p, horizon, budget)
                state = state_after(p, emerged)
            if (ending != HORIZON and (ending != ROOT or state.gap <= 0.0)) or state.gap < 0.0:
                return Phase(emerged, ending, ending != ROOT, state, used)
    if p.gap <= 0.0 < p.gap1 and p.gap2 < 0.0:
        hop = short_hop(p, 0.0, emerged, horizon, budget - used)
        if hop.served:
            x = hop.state
            return Phase(hop.tau, ROOT, False, State(0.0, x.gap1, x.q, x.q1), used + hop.used)
    tau, ending, more = landing(p, emerged, horizon, budget - used)
    state = state_after(p, tau)
    return Phase(tau, ending, ending != ROOT, _landing(state) if ending == ROOT else state, used + more)


# --- in lanes: two free modes -------------------------------------------------------------------------------

#: A contact that begins with a force of zero is searched from where it exceeds this multiple of its rounding.
RISEN: Final = 16.0


@jit
def _rising_time(t: Terms) -> float:
    """A time (rad) at which F, zero to rounding in `t`, has surely risen clearly above; 0 if it may not."""
    f1, f2, f3, f4 = t.smooth1 + t.ring1, t.smooth2 + t.ring2, t.smooth3 + t.ring3, t.smooth4 + t.ring4
    width = 2.0 * max(abs(f3), math.sqrt(abs(f2) * f4)) / f4
    if not (f1 > 0.0 and width > 0.0):
        return 0.0
    # F is above a parabola from zero to zero, half-way at f1 time / 2
    time = 0.5 * lanes.safe_step_once(0.0, f1, f2, f3, f4, width)
    return time if 0.5 * f1 * time > RISEN * t.noise else 0.0


@jit
def _load_contact(s: SoftSpring, table: Any, k: int, run: Progress, phi: PlatePhase, horizon: float) -> bool:
    """Put a contact into lane k, unless it never ends or might end at once."""
    k = lanes.index_of(k)
    m, p, t, start, stays = begin_contact(s, phi, run.state)
    end = min(horizon, lanes.LONGEST_CONTACT)
    f0 = t.smooth + t.ring
    if start == 0.0 and abs(f0) <= 4.0 * t.noise:
        start = _rising_time(t)
    at_once = start == 0.0 and f0 <= 4.0 * t.noise
    if at_once or stays or not (lanes.serves(p.slow_osc, end) and lanes.serves(p.fast_osc, end)):
        return False
    lanes.load_mode(table, k, lanes.X_G, p.slow_osc, p.slow_a, p.slow_b)
    lanes.load_mode(table, k, lanes.Y_G, p.fast_osc, p.fast_a, p.fast_b)
    lanes.load_smooth(table, k, p.static, 0.0, 0.0, p.wave_re, -p.wave_im, 0.0)
    # about the time over which F changes its shape, as in first_root
    f2, f3, f4 = t.smooth2 + t.ring2, t.smooth3 + t.ring3, t.smooth4 + t.ring4
    width = 2.0 * max(abs(f3), math.sqrt(abs(f2) * f4)) / f4
    lanes.load_search(table, k, phi.rad, start, end, width)
    lanes.keep(table, k, m.gap_a, m.gap_b, m.elongation_a, m.elongation_b)
    return True


@jit
def _load_flight(s: SoftSpring, table: Any, k: int, run: Progress, phi: PlatePhase, horizon: float) -> bool:
    """Put a flight into lane k, if it surely emerges and begins neither with a short hop nor too close."""
    if not (lanes.supports(s.flight) and lanes.serves(s.flight, horizon)):
        return False
    k = lanes.index_of(k)
    emerged, here, x = 0.0, phi, run.state
    if x.gap < 0.0:
        p = begin_flight(s.flight, s.gravity, phi, x)
        emerged = emergence_bound(s, p)
        if emerged == 0.0 or emerged >= horizon:
            return False
        x = state_after(p, emerged)
        here = plate_phase(phi.rad + emerged)
    start = emerged
    if emerged > 0.0 or x.gap == 0.0:
        q2, q3, q4 = derivatives(s.flight, x.q, x.q1)
        gap2 = here.cos - s.gravity - 0.5 * q2
        if x.gap1 >= 0.0 and (gap2 >= 0.0 or x.gap1 == 0.0):
            safe = departure_step(max(gap2, 0.0), -here.sin - 0.5 * q3, 1.0 + 0.5 * q4)
            if safe < lanes.SHORT_START:
                return False
            start += safe
        elif 2.0 * x.gap1 < -gap2 * lanes.SHORT_FLIGHT:
            return False
    lanes.load_mode(table, k, lanes.X_G, s.flight, 0.0, 0.0)
    lanes.load_flight(table, k, s.flight, s.gravity, phi, run.state, start, horizon)
    return True


@interface.load_lane.register(SoftSpring)
@inlined
def _load(s: SoftSpring, table: Any, k: int, run: Progress, phi: PlatePhase, horizon: float) -> bool:
    if run.in_flight:
        return _load_flight(s, table, k, run, phi, horizon)
    return _load_contact(s, table, k, run, phi, horizon)


@interface.unload_lane.register(SoftSpring)
@jit
def _unload(s: SoftSpring, table: Any, k: int, run: Progress) -> tuple[Phase, PlatePhase]:
    tau, ending, used = lanes.search_end(table, k)
    phi = lanes.plate_at_end(table, k)
    if run.in_flight:
        q, q1 = lanes.moved(table, k, s.flight, run.state.q, run.state.q1)
        gap, gap1 = lanes.gap_after(table, k, s.gravity, tau, phi, q, q1)
        state = State(gap, gap1, q, q1)
        state = _landing(state) if ending == ROOT else state
        return Phase(tau, ending, ending != ROOT, state, used), phi
    gap_a, gap_b, elongation_a, elongation_b = lanes.kept(table, k)
    gap_rows, elongation_rows = (lanes.Y_G, lanes.X_G) if gap_rings(s) else (lanes.X_G, lanes.Y_G)
    gap_over = lanes.propagator_at_end(table, k, gap_rows, s.gap_mode)
    elongation_over = lanes.propagator_at_end(table, k, elongation_rows, s.elongation_mode)
    m = ModalState(gap_a, gap_b, elongation_a, elongation_b)
    state = _taking_off(s, state_of(s, m, phi, gap_over, elongation_over))
    return Phase(tau, ending, True, state, used), phi


@interface.advance_lanes.register(SoftPlate)
@inlined
def _advance(plate: SoftPlate, table: Any, used: int) -> None:
    """`lanes.advance` of two modes."""
    lanes.advance(table, used, True)
