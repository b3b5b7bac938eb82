"""Variations of the models that have Lyapunov exponents: `rigid`, `soft`, `ball` (docs/model.md, section 7).

A variation is a small difference (dg, dg', dq, dq') between two motions at the same phase of the plate.
Within a contact or flight it obeys the equations of motion without their static and driven parts. An event
comes dphi = -dg/W later for the varied motion, W being the relative velocity there. Meanwhile one motion
obeys the equations before the event and the other those after it; so with the event's map R and the rates f
of the state before and after it,

    d+ = DR (d- + f- dphi) - f+ dphi

The functions below write this out for each event. A landing from which a model sums chatter is one event,
whose R has the sums. Nothing is approximated.
"""

from typing import Any

import numpy as np

from kernel import interface
from kernel.interface import Phase, PlatePhase, State, plate_phase
from kernel.models import flight
from kernel.models.ball import Ball, BallPlate, fall
from kernel.models.contact_law import chatter_lift, chatter_lift_variation, chatter_push
from kernel.models.rigid import RigidPlate, Spring, normal_force
from kernel.models.soft import SoftPlate
from kernel.models.soft_contact import SoftSpring, combine, separate
from kernel.numerics.jit import inlined, jit
from kernel.numerics.oscillator import Oscillator, propagator, response
from kernel.params import BALL_DIMENSION, INELASTIC_DIMENSION, SPRING_DIMENSION


@inlined
def _get(vectors: Any, k: int) -> State:
    """Vector k: dg, dg', dq, dq'."""
    return State(vectors[k, 0], vectors[k, 1], vectors[k, 2], vectors[k, 3])


@inlined
def _put(vectors: Any, k: int, g: float, g1: float, q: float, q1: float) -> None:
    vectors[k, 0], vectors[k, 1], vectors[k, 2], vectors[k, 3] = g, g1, q, q1


@inlined
def _oscillate(osc: Oscillator, c: float, s: float, s1: float, x: float, x1: float) -> tuple[float, float]:
    """x and x' of a free motion after a time at which `response` is c, s, s1."""
    return x * c + x1 * s, x1 * s1 - osc.stiffness * s * x


@interface.carry_in_flight.register(Spring)
@interface.carry_in_flight.register(SoftSpring)
@jit
def _fly(spring: Any, vectors: Any, tau: float) -> None:
    """A spring's flight: its centre of mass, at gap + q/2, moves freely and its elongation swings."""
    osc = spring.flight
    c, s, s1 = response(osc, tau)
    for k in range(len(vectors)):
        g, g1, q, q1 = _get(vectors, k)
        centre1 = g1 + 0.5 * q1
        centre = g + 0.5 * q + tau * centre1
        q, q1 = _oscillate(osc, c, s, s1, q, q1)
        _put(vectors, k, centre - 0.5 * q, centre1 - 0.5 * q1, q, q1)


@interface.landing_error.register(object)
@jit
def _landing_error(spring: Any, phi: PlatePhase, state: State, tau: float) -> float:
    """The rounding of the gap over its rate."""
    return flight.landing_error(flight.begin_flight(spring.flight, spring.gravity, phi, state), tau)


@inlined
def _delay(g: float, impact: float) -> float:
    """dphi, by which the varied motion lands later. 0 at a graze, where no derivative exists."""
    return -g / impact if impact != 0.0 else 0.0


# --- rigid ----------------------------------------------------------------------------------------------


@interface.dimension.register(RigidPlate)
def _rigid_dimension(plate: RigidPlate) -> int:
    """After a landing without restitution gap' is always zero at gap = 0."""
    return SPRING_DIMENSION if np.all(plate.restitution > 0.0) else INELASTIC_DIMENSION


@interface.carry_in_contact.register(Spring)
@jit
def _rigid_contact(s: Spring, vectors: Any, tau: float) -> None:
    """The gap stays zero; the elongation moves as the stuck oscillator."""
    cosine, sine, sine1 = response(s.stuck, tau)
    for k in range(len(vectors)):
        _, _, q, q1 = _get(vectors, k)
        q, q1 = _oscillate(s.stuck, cosine, sine, sine1, q, q1)
        _put(vectors, k, 0.0, 0.0, q, q1)


@interface.carry_through_takeoff.register(Spring)
@jit
def _rigid_takeoff(s: Spring, vectors: Any, end: Phase) -> None:
    """n = 0 at take-off, so that the rates before and after it are the same, and gap = gap' = 0 still."""
    for k in range(len(vectors)):
        _, _, q, q1 = _get(vectors, k)
        _put(vectors, k, 0.0, 0.0, q, q1)


@interface.carry_through_landing.register(Spring)
@jit
def _rigid_landing(s: Spring, vectors: Any, phi: PlatePhase, state: State, end: Phase) -> None:
    """Sticking, which needs no dphi; a hop; or, with a hop of velocity zero, a new take-off at once."""
    if not end.in_flight:
        if s.restitution > 0.0:
            _rest_of_chatter(s, vectors, phi, state, end)
        for k in range(len(vectors)):
            g, g1, q, q1 = _get(vectors, k)
            _put(vectors, k, 0.0, 0.0, q + g, q1 + g1 - s.dashpot * g)
        return
    if end.state.gap1 > 0.0:
        e, impact = s.restitution, -end.state.gap1 / s.restitution
    else:
        e, p = 0.0, flight.begin_flight(s.flight, s.gravity, phi, state)
        _, impact, _, _ = flight.state_after(p, end.tau)
    q, q1 = end.state.q, end.state.q1
    after2 = plate_phase(phi.rad + end.tau).cos - s.gravity + s.dashpot * q1 + s.stiffness * q  # gap''
    before2 = after2 - s.dashpot * (1.0 + e) * impact
    for k in range(len(vectors)):
        g, g1, dq, dq1 = _get(vectors, k)
        dphi = _delay(g, impact)
        change = g1 + before2 * dphi  # variation of the impact velocity
        dq1 += (1.0 + e) * (change - 2.0 * s.dashpot * g)
        _put(vectors, k, -e * g, -e * change - after2 * dphi, dq + (1.0 + e) * g, dq1)


@jit
def _rest_of_chatter(s: Spring, vectors: Any, phi: PlatePhase, state: State, end: Phase) -> None:
    """Add how the sums of chatter, for a mass that sticks, vary with its first hop, n and n'."""
    b, w, e = s.dashpot, s.stiffness, s.restitution
    _, impact, q, q1 = flight.state_after(flight.begin_flight(s.flight, s.gravity, phi, state), end.tau)
    if impact >= 0.0:
        return
    _, sin, cos = plate_phase(phi.rad + end.tau)
    gap2 = cos - s.gravity + b * q1 + w * q
    q1 += impact
    hop, n = -e * impact, normal_force(s, cos, q, q1)
    q2 = cos - s.gravity - b * q1 - w * q
    n1 = sin - b * q2 - w * q1
    n2 = cos - b * (-sin - b * q2 - w * q1) - w * q2
    more, more1 = chatter_push(b, w, *chatter_lift(hop, n, n1 + b * n, e))
    for k in range(len(vectors)):
        g, g1, dq, dq1 = _get(vectors, k)
        dphi = _delay(g, impact)
        dhop = -e * (g1 + gap2 * dphi)
        x, x1 = dq + g, dq1 + g1 - b * g  # of a mass that sticks
        x2 = -b * x1 - w * x
        dn, dn1 = x2 + n1 * dphi, -b * x2 - w * x1 + n2 * dphi
        lift = chatter_lift_variation(hop, n, n1 + b * n, e, dhop, dn, dn1 + b * dn)
        push, push1 = chatter_push(b, w, *lift)
        dq += push - more1 * dphi
        dq1 += push1 + (b * more1 + w * more) * dphi
        _put(vectors, k, g, g1, dq, dq1)


# --- soft -----------------------------------------------------------------------------------------------


@interface.dimension.register(SoftPlate)
def _soft_dimension(plate: SoftPlate) -> int:
    """Gap and elongation with their velocities."""
    return SPRING_DIMENSION


@interface.carry_in_contact.register(SoftSpring)
@jit
def _soft_contact(s: SoftSpring, vectors: Any, tau: float) -> None:
    """The two free modes of `kernel.models.soft_contact`, without its static and driven parts."""
    gap_over, elongation_over = propagator(s.gap_mode, tau), propagator(s.elongation_mode, tau)
    for k in range(len(vectors)):
        m = separate(s, _get(vectors, k))
        gap, gap1, q, q1 = combine(s, m, gap_over, elongation_over)
        _put(vectors, k, gap, gap1, q, q1)


@interface.carry_through_takeoff.register(SoftSpring)
@jit
def _soft_takeoff(s: SoftSpring, vectors: Any, end: Phase) -> None:
    """Adhesive: the force falls from -beta W to 0. Nonadhesive: it is 0 before and after."""
    if s.adhesive:
        for k in range(len(vectors)):
            g, g1, q, q1 = _get(vectors, k)
            _put(vectors, k, g, g1 + s.beta * g, q, q1 - s.beta * g)


@interface.carry_through_landing.register(SoftSpring)
@jit
def _soft_landing(s: SoftSpring, vectors: Any, phi: PlatePhase, state: State, end: Phase) -> None:
    """The force jumps from 0 to -beta W. In a contact that returns below the surface it rises from 0."""
    if end.state.gap < 0.0:
        return
    for k in range(len(vectors)):
        g, g1, dq, dq1 = _get(vectors, k)
        _put(vectors, k, g, g1 - s.beta * g, dq, dq1 + s.beta * g)


# --- ball -----------------------------------------------------------------------------------------------


@interface.dimension.register(BallPlate)
def _ball_dimension(plate: BallPlate) -> int:
    """Gap and its velocity."""
    return BALL_DIMENSION


@interface.carry_in_contact.register(Ball)
@interface.carry_through_takeoff.register(Ball)
@jit
def _ball_contact(b: Ball, vectors: Any, contact: Any) -> None:
    """A ball at rest on the plate has no state to vary."""
    vectors[:] = 0.0


@interface.carry_in_flight.register(Ball)
@jit
def _ball_flight(b: Ball, vectors: Any, tau: float) -> None:
    """Free fall. A ball has no elongation."""
    for k in range(len(vectors)):
        g, g1, _, _ = _get(vectors, k)
        _put(vectors, k, g + tau * g1, g1, 0.0, 0.0)


@interface.landing_error.register(Ball)
@jit
def _ball_landing_error(b: Ball, phi: PlatePhase, state: State, tau: float) -> float:
    return flight.landing_error(fall(b, phi, state), tau)


@interface.carry_through_landing.register(Ball)
@jit
def _ball_landing(b: Ball, vectors: Any, phi: PlatePhase, state: State, end: Phase) -> None:
    """A hop, or with a hop of velocity zero a new take-off at once; else the ball comes to rest."""
    if not end.in_flight:
        vectors[:] = 0.0
        return
    if end.state.gap1 > 0.0:
        e, impact = b.restitution, -end.state.gap1 / b.restitution
    else:
        e, p = 0.0, fall(b, phi, state)
        _, impact, _, _ = flight.state_after(p, end.tau)
    gap2 = plate_phase(phi.rad + end.tau).cos - b.gravity
    for k in range(len(vectors)):
        g, g1, _, _ = _get(vectors, k)
        dphi = _delay(g, impact)
        _put(vectors, k, -e * g, -e * (g1 + gap2 * dphi) - gap2 * dphi, 0.0, 0.0)
