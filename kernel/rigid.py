"""The bouncing spring on an ideal plate: both phases in closed form (MODEL sections 1 to 3).

While stuck, the lower mass moves with the plate and the elongation q is a driven damped
oscillator; it takes off where the plate's normal force n falls to zero. In flight the
centre of mass falls freely and q rings; it lands where the gap falls to zero. There the
lower mass leaves again at -e times its relative velocity, or, where e = 0 or the hop would
be slower than `SLOWEST_HOP`, takes the plate's velocity.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.events import EPS, HORIZON, ROOT, Phase, Terms, departure_step, first_root, terms
from kernel.jit import jit
from kernel.model import contact, flies, flight, prepare, rest
from kernel.oscillator import SHORT, Oscillator, derivatives, displacement, envelope, motion, oscillator

#: A hop that leaves the plate slower than this (plate amplitudes per rad) sticks instead.
SLOWEST_HOP: Final = 1e-9

#: |1 - Omega**2 + 2i xi Omega| is kept above this: an undamped spring exactly at resonance is
#: computed as one 5e-9 beside it, where the closed form still has eight digits.
NEAREST_RESONANCE: Final = 1e-8


class RigidPlate(NamedTuple):
    """The plate under each cell of a line."""

    restitution: NDArray[np.float64]  # (n,)


class Spring(NamedTuple):
    """One cell's constants."""

    gravity: float  # 1/Gamma
    dashpot: float  # 2 xi/Omega
    stiffness: float  # 1/Omega**2
    restitution: float
    stuck: Oscillator
    flight: Oscillator
    sag: float  # static elongation -Omega**2/Gamma
    q_re: float  # the driven elongation is Re(Q e^{i phi})
    q_im: float
    n_re: float  # the driven normal force is 2/Gamma - Re(N e^{i phi}), |N| = 2/Gamma_th
    n_im: float


class Stuck(NamedTuple):
    """n(tau) = 2/Gamma - Re(N e^{i phi}) + h'', where h is the free part of the elongation."""

    spring: Spring
    phi: float
    ring: float  # h'' at tau = 0
    ring1: float  # h'''


class Flight(NamedTuple):
    """The gap during a flight, from what held at tau = 0."""

    spring: Spring
    phi: float
    gap: float
    gap1: float
    gap2: float  # -n
    drift: float  # the centre's velocity, gap' - sin phi + q'/2
    q: float
    q1: float


@prepare.register(RigidPlate)
@jit
def _prepare(plate: RigidPlate, i: int, gamma: float, omega: float, xi: float) -> Spring:
    stiffness = 1.0 / (omega * omega)
    dashpot = 2.0 * xi / omega
    # Q = 1/(w - 1 + i b) and N = 1 + (w + i b) Q
    re, im = stiffness - 1.0, dashpot
    size = math.hypot(re, im)
    nearest = NEAREST_RESONANCE * stiffness
    if size < nearest:
        re, im, size = nearest, 0.0, nearest
    q_re, q_im = re / size / size, -im / size / size
    return Spring(
        gravity=1.0 / gamma,
        dashpot=dashpot,
        stiffness=stiffness,
        restitution=plate.restitution[i],
        stuck=oscillator(0.5 * dashpot, stiffness),
        flight=oscillator(dashpot, 2.0 * stiffness),
        sag=-1.0 / (gamma * stiffness),
        q_re=q_re,
        q_im=q_im,
        n_re=1.0 + stiffness * q_re - dashpot * q_im,
        n_im=stiffness * q_im + dashpot * q_re,
    )


@jit
def normal_force(s: Spring, phi: float, q: float, q1: float) -> float:
    """n if the lower mass moved with the plate (Eq. 8)."""
    return s.gravity - math.cos(phi) - s.dashpot * q1 - s.stiffness * q


@rest.register(Spring)
@jit
def _rest(s: Spring) -> tuple[float, float, float, float]:
    """Gap, gap', elongation and its velocity of a spring at rest on the plate at phase zero."""
    return 0.0, 0.0, s.sag, 0.0


@flies.register(Spring)
@jit
def _flies(s: Spring, phi: float, gap: float, gap1: float, q: float, q1: float) -> bool:
    """Whether this state is a flight: off the plate, or on it with nothing to hold it there."""
    return gap > 0.0 or gap1 > 0.0 or normal_force(s, phi, q, q1) < 0.0


@terms.register(Stuck)
@jit
def _stuck_terms(p: Stuck, tau: float) -> Terms:
    """The normal force while stuck."""
    s = p.spring
    sin, cos = math.sin(p.phi + tau), math.cos(p.phi + tau)
    wave, wave1 = s.n_re * cos - s.n_im * sin, s.n_re * sin + s.n_im * cos
    ring, ring1 = motion(s.stuck, p.ring, p.ring1, tau)
    ring2, ring3, ring4 = derivatives(s.stuck, ring, ring1)
    bound = abs(s.n_re) + abs(s.n_im)
    return Terms(
        smooth=2.0 * s.gravity - wave,
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
        noise=4.0 * EPS * (2.0 * s.gravity + bound + abs(p.ring)),
    )


@terms.register(Flight)
@jit
def _flight_terms(p: Flight, tau: float) -> Terms:
    """The gap during a flight, written so that a short one keeps its digits."""
    s = p.spring
    sin, cos = math.sin(p.phi + tau), math.cos(p.phi + tau)
    q, q1 = motion(s.flight, p.q, p.q1, tau)
    q2, q3, q4 = derivatives(s.flight, q, q1)
    if tau * max(s.flight.rate, 1.0) < SHORT:
        gap, gap1, noise = short_flight(p, tau)
        gap2, gap3, bound = cos - s.gravity - 0.5 * q2, -sin - 0.5 * q3, 1.0 + 0.5 * q4
        return Terms(gap, gap1, gap2, gap3, bound, 0.0, 0.0, 0.0, 0.0, 0.0, math.inf, noise)
    fall = 0.5 * s.gravity * tau * tau
    smooth = p.gap + 2.0 * math.sin(p.phi + 0.5 * tau) * math.sin(0.5 * tau) + p.drift * tau - fall
    if tau * s.flight.rate < SHORT:
        stretch = displacement(s.flight, p.q, p.q1, tau)
        ring, amplitude, size = -0.5 * stretch, math.inf, abs(stretch)
    else:
        smooth += 0.5 * p.q
        ring, amplitude, size = -0.5 * q, 0.5 * envelope(s.flight, q, q1), abs(p.q) + abs(q)
    return Terms(
        smooth=smooth,
        smooth1=sin + p.drift - s.gravity * tau,
        smooth2=cos - s.gravity,
        smooth3=-sin,
        smooth4=1.0,
        ring=ring,
        ring1=-0.5 * q1,
        ring2=-0.5 * q2,
        ring3=-0.5 * q3,
        ring4=0.5 * q4,
        amplitude=amplitude,
        noise=2.0 * EPS * (p.gap + 2.0 + abs(p.drift) * tau + fall + size),
    )


@jit
def short_flight(p: Flight, tau: float) -> tuple[float, float, float]:
    """Gap, gap' and the gap's rounding by the power series, whose first terms vanish at a take-off."""
    s = p.spring
    before = -2.0 * s.dashpot * p.q1 - s.flight.stiffness * p.q
    last = -2.0 * s.dashpot * before - s.flight.stiffness * p.q1
    turn, turn_next = -math.sin(p.phi), -math.cos(p.phi)  # third and fourth derivative of -cos(phi)
    power = 0.5 * tau * tau
    gap = p.gap + p.gap1 * tau + p.gap2 * power
    gap1 = p.gap1 + p.gap2 * tau
    size = p.gap + abs(p.gap1) * tau + abs(p.gap2) * power
    for order in range(3, 17):
        derivative = turn - 0.5 * last
        gap1 += derivative * power
        power *= tau / order
        gap += derivative * power
        size += abs(derivative) * power
        before, last = last, -2.0 * s.dashpot * last - s.flight.stiffness * before
        turn, turn_next = turn_next, -turn
    return gap, gap1, 4.0 * EPS * size


@contact.register(Spring)
@jit
def _contact(
    s: Spring, phi: float, gap: float, gap1: float, q: float, q1: float, horizon: float, budget: int
) -> Phase:
    """Stuck until take-off, or to the horizon (rad from now)."""
    sin, cos = math.sin(phi), math.cos(phi)
    h = q - s.sag - (s.q_re * cos - s.q_im * sin)
    h1 = q1 + (s.q_re * sin + s.q_im * cos)
    h2 = -s.dashpot * h1 - s.stiffness * h
    h3 = -s.dashpot * h2 - s.stiffness * h1
    if 2.0 * s.gravity - math.hypot(s.n_re, s.n_im) > envelope(s.stuck, h2, h3):
        tau, ending, used = horizon, HORIZON, 1  # n cannot reach zero any more
    else:
        tau, ending, used = first_root(Stuck(s, phi, h2, h3), 0.0, horizon, budget)
    h, h1 = motion(s.stuck, h, h1, tau)
    sin, cos = math.sin(phi + tau), math.cos(phi + tau)
    q = s.sag + (s.q_re * cos - s.q_im * sin) + h
    q1 = h1 - (s.q_re * sin + s.q_im * cos)
    return Phase(tau, ending, ending == ROOT, 0.0, 0.0, q, q1, used)


@flight.register(Spring)
@jit
def _flight(
    s: Spring, phi: float, gap: float, gap1: float, q: float, q1: float, horizon: float, budget: int
) -> Phase:
    """In flight until landing, or to the horizon (rad from now)."""
    lifting = gap == 0.0 and gap1 == 0.0
    gap2 = -normal_force(s, phi, q, q1)
    if lifting and gap2 < 0.0:
        gap2 = 0.0  # n = 0 at a take-off; what is left is rounding
    p = Flight(s, phi, gap, gap1, gap2, gap1 - math.sin(phi) + 0.5 * q1, q, q1)
    start = 0.0
    if lifting:
        t = _flight_terms(p, 0.0)
        start = departure_step(gap2, t.smooth3, t.smooth4)
    tau, ending, used = first_root(p, start, horizon, budget)
    t = _flight_terms(p, tau)
    gap, gap1 = t.smooth + t.ring, t.smooth1 + t.ring1
    q, q1 = motion(s.flight, q, q1, tau)
    if ending != ROOT:
        return Phase(tau, ending, True, gap, gap1, q, q1, used)
    return land(s, phi + tau, tau, gap1, q, q1, used)


@jit
def land(s: Spring, phi: float, tau: float, impact: float, q: float, q1: float, used: int) -> Phase:
    """What follows a landing at relative velocity `impact` < 0: a hop, sticking, or at once a new take-off."""
    hop = -s.restitution * impact
    if hop < SLOWEST_HOP:
        hop = 0.0
    q1 += impact - hop
    return Phase(tau, ROOT, _flies(s, phi, 0.0, hop, q, q1), 0.0, hop, q, q1, used)
