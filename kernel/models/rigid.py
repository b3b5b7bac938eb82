"""The bouncing spring on an ideal plate, contact and flight in closed form (docs/model.md, sections 1 to 3).

In contact the lower mass sticks to the plate and the elongation q is a driven damped oscillator; it takes
off where the plate's normal force n (Eq. 8) falls to zero. In flight the centre of mass falls freely and q
oscillates; it lands where the gap falls to zero. There the lower mass leaves again at -e times its relative
velocity, and for e = 0 takes the plate's. Chatter is followed hop by hop, each of them a flight, until n is
steady over the rest of it (`contact_law.chatter_completes`). From there on the mass counts as stuck, and what
the rest would do to the spring is added in closed form (`_rest_of_chatter`).
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel import interface
from kernel.cell import Progress
from kernel.interface import Phase, PlatePhase, State, plate_phase
from kernel.models import lanes
from kernel.models.contact_law import chatter_completes, chatter_lift, chatter_push
from kernel.models.flight import begin_flight, landing, short_hop, state_after
from kernel.numerics.elementary import sincos
from kernel.numerics.first_root import EPS, HORIZON, ROOT, Terms, departure_step, first_root, terms
from kernel.numerics.jit import inlined, jit
from kernel.numerics.oscillator import (
    Oscillator,
    coordinates,
    decay_time,
    derivatives,
    envelope,
    motion,
    oscillator,
)
from kernel.params import check_arrays
from kernel.portable_math import hypot

#: |1/Omega**2 - 1 + 2i xi/Omega| is kept above this: an undamped spring exactly at resonance is computed, in
#: contact, as one whose Omega is 5e-9 beside it. The driven amplitude is the inverse, and the closed form, a
#: difference of two such amplitudes, keeps eight of sixteen digits.
NEAREST_RESONANCE: Final = 1e-8


class RigidPlate(NamedTuple):
    """The plate under each cell of a line."""

    restitution: NDArray[np.float64]  # (n,) e


def plate(*, restitution: NDArray[np.float64]) -> RigidPlate:
    """The plate under n cells; restitution (n,) in [0, 1]. Raises KernelInputError."""
    check_arrays({"restitution": restitution})
    return RigidPlate(np.ascontiguousarray(restitution))


class Spring(NamedTuple):
    """One cell's constants."""

    gravity: float  # 1/Gamma
    dashpot: float  # 2 xi/Omega
    stiffness: float  # w = 1/Omega**2
    restitution: float
    stuck: Oscillator  # the free elongation in contact, of stiffness w_s: w, or w shifted from resonance
    flight: Oscillator  # and in flight
    static_elongation: float  # -Omega**2/Gamma
    q_re: float  # the driven elongation is Re(Q e^{i phi})
    q_im: float
    mean_force: float  # 2/Gamma
    n_re: float  # the driven normal force is mean_force - Re(N e^{i phi}), |N| = 2/Gamma_th
    n_im: float
    margin: float  # mean_force - |N|: if positive, a take-off needs a free part of this size


class Stuck(NamedTuple):
    """n(tau) = mean_force - Re(N e^{i phi}) - b h' - w h in contact, h being the free elongation."""

    spring: Spring
    phi: float
    ring: float  # the free part at tau = 0
    ring1: float  # its derivative


@interface.prepare.register(RigidPlate)
@jit
def _prepare(plate: RigidPlate, i: int, gamma: float, omega: float, xi: float) -> Spring:
    stiffness = 1.0 / (omega * omega)
    dashpot = 2.0 * xi / omega
    near = hypot(stiffness - 1.0, dashpot) < NEAREST_RESONANCE
    driven = 1.0 + NEAREST_RESONANCE if near else stiffness
    # Q = 1/(w_s - 1 + i b) and N = 1 + (w + i b) Q
    re, im = driven - 1.0, dashpot
    size = hypot(re, im)
    q_re, q_im = re / size / size, -im / size / size
    mean_force = (1.0 + stiffness / driven) / gamma
    n_re, n_im = 1.0 + stiffness * q_re - dashpot * q_im, stiffness * q_im + dashpot * q_re
    return Spring(
        gravity=1.0 / gamma,
        dashpot=dashpot,
        stiffness=stiffness,
        restitution=plate.restitution[i],
        stuck=oscillator(0.5 * dashpot, driven),
        flight=oscillator(dashpot, 2.0 * stiffness),
        static_elongation=-1.0 / (gamma * driven),
        q_re=q_re,
        q_im=q_im,
        mean_force=mean_force,
        n_re=n_re,
        n_im=n_im,
        margin=mean_force - hypot(n_re, n_im),
    )


@inlined
def normal_force(s: Spring, cos: float, q: float, q1: float) -> float:
    """n of a lower mass that moves with the plate (Eq. 8); cos is of the plate's phase."""
    return s.gravity - cos - s.dashpot * q1 - s.stiffness * q


@interface.contact_force.register(Spring)
@jit
def _contact_force(s: Spring, phi: PlatePhase, state: State) -> float:
    return normal_force(s, phi.cos, state.q, state.q1)


@interface.rest.register(Spring)
@jit
def _rest(s: Spring) -> State:
    return State(0.0, 0.0, s.static_elongation, 0.0)


@interface.relative_margin.register(Spring)
@inlined
def _relative_margin(s: Spring) -> float:
    return s.margin / s.mean_force


@interface.flies.register(Spring)
@jit
def _flies(s: Spring, phi: PlatePhase, state: State) -> bool:
    """Off the plate, or on it with n < 0."""
    return state.gap > 0.0 or state.gap1 > 0.0 or normal_force(s, phi.cos, state.q, state.q1) < 0.0


@terms.register(Stuck)
@jit
def _stuck_terms(p: Stuck, tau: float) -> Terms:
    """The normal force as a phase function: the driven part is smooth, the free part rings."""
    s = p.spring
    sin, cos = sincos(p.phi + tau)
    wave, wave1 = s.n_re * cos - s.n_im * sin, s.n_re * sin + s.n_im * cos
    ring, ring1 = motion(s.stuck, p.ring, p.ring1, tau)
    ring2, ring3, ring4 = derivatives(s.stuck, ring, ring1)
    bound = abs(s.n_re) + abs(s.n_im)
    return Terms(
        smooth=s.mean_force - wave,
        smooth1=wave1,
        smooth2=wave,
        smooth3=-wave1,
        smooth4=bound,
        ring=ring,
        ring1=ring1,
        ring2=ring2,
        ring3=ring3,
        ring4=ring4,
        amplitude=envelope(s.stuck, ring, ring1),
        noise=4.0 * EPS * (s.mean_force + bound + abs(p.ring)),
    )


@inlined
def _free(s: Spring, phi: PlatePhase, q: float, q1: float) -> tuple[float, float]:
    """The free elongation in contact and its rate."""
    driven, driven1 = s.q_re * phi.cos - s.q_im * phi.sin, s.q_re * phi.sin + s.q_im * phi.cos
    return q - s.static_elongation - driven, q1 + driven1


@inlined
def _stuck_until(
    s: Spring, phi: PlatePhase, tau: float, ending: int, h: float, h1: float, used: int
) -> Phase:
    """The end of a contact at phi whose free elongation there is h."""
    q = s.static_elongation + (s.q_re * phi.cos - s.q_im * phi.sin) + h
    q1 = h1 - (s.q_re * phi.sin + s.q_im * phi.cos)
    return Phase(tau, ending, ending == ROOT, State(0.0, 0.0, q, q1), used)


@interface.contact.register(Spring)
@jit
def _contact(s: Spring, phi: PlatePhase, state: State, horizon: float, budget: int) -> Phase:
    """Stuck until n falls to zero. The search ends once its free part is too small to bring it there."""
    h, h1 = _free(s, phi, state.q, state.q1)
    h2, _, _ = derivatives(s.stuck, h, h1)
    ring, ring1 = -s.dashpot * h1 - s.stiffness * h, -s.dashpot * h2 - s.stiffness * h1
    decayed = decay_time(s.stuck, ring, ring1, s.margin)
    tau, ending, used = first_root(Stuck(s, phi.rad, ring, ring1), 0.0, min(horizon, decayed), budget)
    if ending == HORIZON:
        tau = horizon
    h, h1 = motion(s.stuck, h, h1, tau)
    return _stuck_until(s, plate_phase(phi.rad + tau), tau, ending, h, h1, used)


@interface.flight.register(Spring)
@inlined
def _flight(s: Spring, phi: PlatePhase, state: State, horizon: float, budget: int) -> Phase:
    p = begin_flight(s.flight, s.gravity, phi, state)
    if p.gap == 0.0 and p.gap1 > 0.0 and p.gap2 < 0.0:
        hop = short_hop(p, 0.0, 0.0, horizon, budget)
        if hop.served:
            return land(s, hop.phi, hop.tau, hop.state, hop.used)
    tau, ending, used = landing(p, 0.0, horizon, budget)
    state = state_after(p, tau)
    if ending != ROOT:
        return Phase(tau, ending, True, state, used)
    return land(s, plate_phase(phi.rad + tau), tau, state, used)


@inlined
def land(s: Spring, phi: PlatePhase, tau: float, state: State, used: int) -> Phase:
    """The end of a flight that lands at phi with `state`, gap' <= 0."""
    _, impact, q, q1 = state
    hop = max(-s.restitution * impact, 0.0)
    q1 += impact  # of a mass that sticks; the upper mass keeps its velocity
    if hop > 0.0:
        completes, more, more1 = _rest_of_chatter(s, phi, hop, q, q1)
        if completes:
            q, q1, hop = q + more, q1 + more1, 0.0
    q1 -= hop
    in_flight = hop > 0.0 or normal_force(s, phi.cos, q, q1) < 0.0
    return Phase(tau, ROOT, in_flight, State(0.0, hop, q, q1), used)


@inlined
def _rest_of_chatter(
    s: Spring, phi: PlatePhase, hop: float, q: float, q1: float
) -> tuple[bool, float, float]:
    """Whether chatter that begins with `hop` may be summed, and its change of q and q' of a mass that sticks.

    In a hop the upper mass is accelerated by b gap' + w gap more than if the lower one stuck. The whole
    change is added now, and the free motion in contact carries it on. That acceleration lowers n too, which
    moves the sums as far as a rate of b n would.
    """
    b, w = s.dashpot, s.stiffness
    n = normal_force(s, phi.cos, q, q1)
    bound = abs(s.n_re) + abs(s.n_im) + (b * b + w) * n
    if not chatter_completes(hop, n, 0.0, bound, s.restitution):  # as for most hops
        return False, 0.0, 0.0
    h, h1 = _free(s, phi, q, q1)
    h2, h3, _ = derivatives(s.stuck, h, h1)
    h4, h5, _ = derivatives(s.stuck, h2, h3)
    rate = h3 + s.n_re * phi.sin + s.n_im * phi.cos
    if not chatter_completes(hop, n, rate, bound + envelope(s.stuck, h4, h5), s.restitution):
        return False, 0.0, 0.0
    more, more1 = chatter_push(b, w, *chatter_lift(hop, n, rate + b * n, s.restitution))
    return True, more, more1


# --- in lanes ----------------------------------------------------------------------------------------------


@interface.advance_lanes.register(RigidPlate)
@inlined
def _advance(plate: RigidPlate, table: Any, used: int) -> None:
    """`lanes.advance` of one mode."""
    lanes.advance(table, used, False)


@inlined
def _load_contact(table: Any, k: int, s: Spring, run: Progress, phi: PlatePhase, horizon: float) -> bool:
    """Put a contact into lane k, unless it never ends, which `rigid` knows in closed form."""
    h, h1 = _free(s, phi, run.state.q, run.state.q1)
    h2, h3, _ = derivatives(s.stuck, h, h1)
    if envelope(s.stuck, h2, h3) < s.margin:
        return False
    end = min(horizon, lanes.LONGEST_CONTACT)
    ring, ring1 = -s.dashpot * h1 - s.stiffness * h, -s.dashpot * h2 - s.stiffness * h1
    lanes.load_mode(table, k, lanes.Y_G, s.stuck, *coordinates(s.stuck, ring, ring1))
    lanes.load_smooth(table, k, s.mean_force, 0.0, 0.0, -s.n_re, s.n_im, abs(ring))
    lanes.load_search(table, k, phi.rad, 0.0, end, min(lanes.FIRST_WIDTH, lanes.FIRST_TURN / s.stuck.rate))
    lanes.keep(table, k, h, h1, 0.0, 0.0)
    return lanes.serves(s.stuck, end)


@inlined
def _load_flight(table: Any, k: int, s: Spring, run: Progress, phi: PlatePhase, horizon: float) -> bool:
    """Put a flight into lane k, unless it begins with a short hop or too close to the plate."""
    gap, gap1, q, q1 = run.state
    q2, q3, q4 = derivatives(s.flight, q, q1)
    gap2, start = phi.cos - s.gravity - 0.5 * q2, 0.0
    if gap == 0.0 and gap1 == 0.0:
        start = departure_step(max(gap2, 0.0), -phi.sin - 0.5 * q3, 1.0 + 0.5 * q4)
        if start < lanes.SHORT_START:
            return False
    elif gap == 0.0 and 2.0 * gap1 < -gap2 * lanes.SHORT_FLIGHT:
        return False
    lanes.load_flight(table, k, s.flight, s.gravity, phi, run.state, start, horizon)
    return lanes.serves(s.flight, horizon)


@interface.load_lane.register(Spring)
@inlined
def _load(s: Spring, table: Any, k: int, run: Progress, phi: PlatePhase, horizon: float) -> bool:
    if run.in_flight:
        loaded = _load_flight(table, k, s, run, phi, horizon)
    else:
        loaded = _load_contact(table, k, s, run, phi, horizon)
    return loaded and lanes.supports(s.stuck)  # and so the stiffer one of the flight


@interface.unload_lane.register(Spring)
@inlined
def _unload(s: Spring, table: Any, k: int, run: Progress) -> tuple[Phase, PlatePhase]:
    tau, ending, used = lanes.search_end(table, k)
    phi = lanes.plate_at_end(table, k)
    if not run.in_flight:
        h, h1, _, _ = lanes.kept(table, k)
        h, h1 = lanes.moved(table, k, s.stuck, h, h1)
        return _stuck_until(s, phi, tau, ending, h, h1, used), phi
    q, q1 = lanes.moved(table, k, s.flight, run.state.q, run.state.q1)
    gap, gap1 = lanes.gap_after(table, k, s.gravity, tau, phi, q, q1)
    state = State(gap, gap1, q, q1)
    if ending != ROOT:
        return Phase(tau, ending, True, state, used), phi
    return land(s, phi, tau, state, used), phi
