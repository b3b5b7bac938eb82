"""The bouncing spring on an ideal plate: both phases in closed form (MODEL sections 1 to 3).

While stuck, the lower mass moves with the plate and the elongation q is a driven damped
oscillator; it takes off where the plate's normal force n falls to zero. In flight the
centre of mass falls freely and q rings; it lands where the gap falls to zero. There the
lower mass leaves again at -e times its relative velocity, and where e = 0 takes the plate's.
A cascade of ever smaller hops is followed hop by hop, each of them a flight, until the plate
presses steadily over all that is left of it (`kernel.models.chatter`): from there on the mass counts
as stuck, which over so short a time moves the spring as the hops would.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.interface import contact, contact_force, flies, flight, prepare, rest
from kernel.models.chatter import chatter_completes
from kernel.models.flight import landing, state_after, take_off
from kernel.numerics.elementary import turned
from kernel.numerics.first_root import EPS, HORIZON, ROOT, Phase, Terms, first_root, terms
from kernel.numerics.jit import inlined, jit
from kernel.numerics.oscillator import Oscillator, derivatives, envelope, motion, oscillator, quiet_after
from kernel.validation import check_arrays

#: |1/Omega**2 - 1 + 2i xi/Omega| is kept above this: an undamped spring exactly at resonance is
#: computed as one 5e-9 beside it, where the closed form still has eight digits.
NEAREST_RESONANCE: Final = 1e-8


class RigidPlate(NamedTuple):
    """The plate under each cell of a line."""

    restitution: NDArray[np.float64]  # (n,)


def plate(*, restitution: NDArray[np.float64]) -> RigidPlate:
    """The plate under n cells; restitution (n,) in [0, 1]. Raises KernelInputError."""
    check_arrays({"restitution": restitution})
    return RigidPlate(np.ascontiguousarray(restitution))


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


@prepare.register(RigidPlate)
@jit
def _prepare(plate: RigidPlate, i: int, gamma: float, omega: float, xi: float) -> Spring:
    stiffness = 1.0 / (omega * omega)
    dashpot = 2.0 * xi / omega
    if math.hypot(stiffness - 1.0, dashpot) < NEAREST_RESONANCE:
        stiffness = 1.0 + NEAREST_RESONANCE
    # Q = 1/(w - 1 + i b) and N = 1 + (w + i b) Q
    re, im = stiffness - 1.0, dashpot
    size = math.hypot(re, im)
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


@inlined
def normal_force(s: Spring, cos: float, q: float, q1: float) -> float:
    """n if the lower mass moved with the plate (Eq. 8), cos being the plate's position."""
    return s.gravity - cos - s.dashpot * q1 - s.stiffness * q


@contact_force.register(Spring)
@jit
def _contact_force(s: Spring, cos: float, gap: float, gap1: float, q: float, q1: float) -> float:
    return normal_force(s, cos, q, q1)


@rest.register(Spring)
@jit
def _rest(s: Spring) -> tuple[float, float, float, float]:
    """Gap, gap', elongation and its velocity of a spring at rest on the plate at phase zero."""
    return 0.0, 0.0, s.sag, 0.0


@flies.register(Spring)
@jit
def _flies(s: Spring, phi: float, gap: float, gap1: float, q: float, q1: float) -> bool:
    """Whether this state is a flight: off the plate, or on it with nothing to hold it there."""
    return gap > 0.0 or gap1 > 0.0 or normal_force(s, math.cos(phi), q, q1) < 0.0


@terms.register(Stuck)
@jit
def _stuck_terms(p: Stuck, tau: float) -> Terms:
    """The normal force while stuck."""
    s = p.spring
    sin, cos = turned(p.phi + tau)
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


@contact.register(Spring)
@jit
def _contact(
    s: Spring, phi: float, gap: float, gap1: float, q: float, q1: float, horizon: float, budget: int
) -> Phase:
    """Stuck until take-off, or to the horizon (rad from now)."""
    sin, cos = turned(phi)
    h = q - s.sag - (s.q_re * cos - s.q_im * sin)
    h1 = q1 + (s.q_re * sin + s.q_im * cos)
    h2 = -s.dashpot * h1 - s.stiffness * h
    h3 = -s.dashpot * h2 - s.stiffness * h1
    quiet = quiet_after(s.stuck, h2, h3, 2.0 * s.gravity - math.hypot(s.n_re, s.n_im))
    tau, ending, used = first_root(Stuck(s, phi, h2, h3), 0.0, min(horizon, quiet), budget)
    if ending == HORIZON:  # or n cannot reach zero any more
        tau = horizon
    h, h1 = motion(s.stuck, h, h1, tau)
    sin, cos = turned(phi + tau)
    q = s.sag + (s.q_re * cos - s.q_im * sin) + h
    q1 = h1 - (s.q_re * sin + s.q_im * cos)
    return Phase(tau, ending, ending == ROOT, 0.0, 0.0, q, q1, used)


@flight.register(Spring)
@jit
def _flight(
    s: Spring, phi: float, gap: float, gap1: float, q: float, q1: float, horizon: float, budget: int
) -> Phase:
    """In flight until landing, or to the horizon (rad from now)."""
    p = take_off(s.flight, s.gravity, phi, gap, gap1, q, q1)
    tau, ending, used = landing(p, 0.0, horizon, budget)
    gap, gap1, q, q1 = state_after(p, tau)
    if ending != ROOT:
        return Phase(tau, ending, True, gap, gap1, q, q1, used)
    sin, cos = turned(phi + tau)
    return land(s, sin, cos, tau, gap1, q, q1, used)


@inlined
def land(
    s: Spring, sin: float, cos: float, tau: float, impact: float, q: float, q1: float, used: int
) -> Phase:
    """What follows an impact at relative velocity < 0: a hop, sticking, or at once a new take-off.

    sin and cos are of the plate's phase there.
    """
    hop = max(-s.restitution * impact, 0.0)
    q1 += impact  # as if it stuck
    if hop > 0.0 and _settles(s, sin, cos, hop, q, q1):
        hop = 0.0
    q1 -= hop
    in_flight = hop > 0.0 or normal_force(s, cos, q, q1) < 0.0
    return Phase(tau, ROOT, in_flight, 0.0, hop, q, q1, used)


@jit
def _settles(s: Spring, sin: float, cos: float, hop: float, q: float, q1: float) -> bool:
    """Whether the cascade that begins with `hop` is over before n, of a mass that sticks, has changed."""
    h, h1 = q - s.sag - (s.q_re * cos - s.q_im * sin), q1 + (s.q_re * sin + s.q_im * cos)
    h2, h3, _ = derivatives(s.stuck, h, h1)
    h4, h5, _ = derivatives(s.stuck, h2, h3)
    rate = h3 + s.n_re * sin + s.n_im * cos
    bound = abs(s.n_re) + abs(s.n_im) + envelope(s.stuck, h4, h5)
    return chatter_completes(hop, normal_force(s, cos, q, q1), rate, bound, s.restitution)
