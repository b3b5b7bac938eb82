"""The bouncing spring on an ideal plate, contact and flight in closed form (docs/model.md, sections 1 to 3).

In contact the lower mass sticks to the plate and the elongation q is a driven damped oscillator; it takes
off where the plate's normal force n (Eq. 8) falls to zero. In flight the centre of mass falls freely and q
oscillates; it lands where the gap falls to zero. There the lower mass leaves again at -e times its relative
velocity, and for e = 0 takes the plate's. Chatter is followed hop by hop, each of them a flight, until n is
steady over the rest of it (`kernel.models.chatter`). From there on the mass counts as stuck, which over so
short a time moves the spring as the hops would.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.interface import contact, contact_force, flies, flight, prepare, rest
from kernel.models.chatter import chatter_completes
from kernel.models.flight import begin_flight, landing, state_after
from kernel.numerics.elementary import hypot, sincos
from kernel.numerics.first_root import EPS, HORIZON, ROOT, Phase, Terms, first_root, terms
from kernel.numerics.jit import inlined, jit
from kernel.numerics.oscillator import Oscillator, decay_time, derivatives, envelope, motion, oscillator
from kernel.validation import check_arrays

#: |1/Omega**2 - 1 + 2i xi/Omega| is kept above this: an undamped spring exactly at resonance is computed,
#: while it is in contact, as one whose Omega is 5e-9 beside it. The driven amplitude is the inverse, and the
#: closed form, a difference of two such amplitudes, keeps eight of sixteen digits; nearer to resonance it
#: would lose more.
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
    stuck: Oscillator  # the free elongation in contact, of stiffness w_s: w but for NEAREST_RESONANCE
    flight: Oscillator  # and in flight
    static_elongation: float  # -Omega**2/Gamma
    q_re: float  # the driven elongation is Re(Q e^{i phi})
    q_im: float
    mean_force: float  # 2/Gamma
    n_re: float  # the driven normal force is mean_force - Re(N e^{i phi}), |N| = 2/Gamma_th
    n_im: float


class Stuck(NamedTuple):
    """The normal force in contact: n(tau) = mean_force - Re(N e^{i phi}) - b h' - w h, h the free elongation.

    The terms in h are its free part: h'' but for NEAREST_RESONANCE.
    """

    spring: Spring
    phi: float
    ring: float  # the free part at tau = 0
    ring1: float  # its derivative


@prepare.register(RigidPlate)
@jit
def _prepare(plate: RigidPlate, i: int, gamma: float, omega: float, xi: float) -> Spring:
    """The constants of cell i."""
    stiffness = 1.0 / (omega * omega)
    dashpot = 2.0 * xi / omega
    near = hypot(stiffness - 1.0, dashpot) < NEAREST_RESONANCE
    driven = 1.0 + NEAREST_RESONANCE if near else stiffness
    # Q = 1/(w_s - 1 + i b) and N = 1 + (w + i b) Q
    re, im = driven - 1.0, dashpot
    size = hypot(re, im)
    q_re, q_im = re / size / size, -im / size / size
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
        mean_force=(1.0 + stiffness / driven) / gamma,
        n_re=1.0 + stiffness * q_re - dashpot * q_im,
        n_im=stiffness * q_im + dashpot * q_re,
    )


@inlined
def normal_force(s: Spring, cos: float, q: float, q1: float) -> float:
    """n of a lower mass that moves with the plate (Eq. 8); cos is of the plate's phase."""
    return s.gravity - cos - s.dashpot * q1 - s.stiffness * q


@contact_force.register(Spring)
@jit
def _contact_force(s: Spring, cos: float, gap: float, gap1: float, q: float, q1: float) -> float:
    """n in contact."""
    return normal_force(s, cos, q, q1)


@rest.register(Spring)
@jit
def _rest(s: Spring) -> tuple[float, float, float, float]:
    """On the plate, at the static elongation."""
    return 0.0, 0.0, s.static_elongation, 0.0


@flies.register(Spring)
@jit
def _flies(s: Spring, phi: float, gap: float, gap1: float, q: float, q1: float) -> bool:
    """Off the plate, or on it with n < 0."""
    _, cos = sincos(phi)
    return gap > 0.0 or gap1 > 0.0 or normal_force(s, cos, q, q1) < 0.0


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


@contact.register(Spring)
@jit
def _contact(
    s: Spring, phi: float, gap: float, gap1: float, q: float, q1: float, horizon: float, budget: int
) -> Phase:
    """Stuck until n falls to zero.

    The search ends early once the free part of n is too small to bring n to zero.
    """
    sin, cos = sincos(phi)
    h = q - s.static_elongation - (s.q_re * cos - s.q_im * sin)
    h1 = q1 + (s.q_re * sin + s.q_im * cos)
    h2, _, _ = derivatives(s.stuck, h, h1)
    ring, ring1 = -s.dashpot * h1 - s.stiffness * h, -s.dashpot * h2 - s.stiffness * h1
    decayed = decay_time(s.stuck, ring, ring1, s.mean_force - hypot(s.n_re, s.n_im))
    tau, ending, used = first_root(Stuck(s, phi, ring, ring1), 0.0, min(horizon, decayed), budget)
    if ending == HORIZON:
        tau = horizon
    h, h1 = motion(s.stuck, h, h1, tau)
    sin, cos = sincos(phi + tau)
    q = s.static_elongation + (s.q_re * cos - s.q_im * sin) + h
    q1 = h1 - (s.q_re * sin + s.q_im * cos)
    return Phase(tau, ending, ending == ROOT, 0.0, 0.0, q, q1, used)


@flight.register(Spring)
@inlined
def _flight(
    s: Spring, phi: float, gap: float, gap1: float, q: float, q1: float, horizon: float, budget: int
) -> Phase:
    """In flight until the gap falls to zero."""
    p = begin_flight(s.flight, s.gravity, phi, gap, gap1, q, q1)
    tau, ending, used = landing(p, 0.0, horizon, budget)
    gap, gap1, q, q1 = state_after(p, tau)
    if ending != ROOT:
        return Phase(tau, ending, True, gap, gap1, q, q1, used)
    sin, cos = sincos(phi + tau)
    return land(s, sin, cos, tau, gap1, q, q1, used)


@inlined
def land(
    s: Spring, sin: float, cos: float, tau: float, impact: float, q: float, q1: float, used: int
) -> Phase:
    """The end of a flight of `tau` rad that lands at relative velocity `impact` <= 0.

    A hop follows, or sticking, or at once a new take-off. sin and cos are of the plate's phase at landing.
    """
    hop = max(-s.restitution * impact, 0.0)
    q1 += impact  # of a mass that sticks; the upper mass keeps its velocity
    if hop > 0.0 and _chatter_ends(s, sin, cos, hop, q, q1):
        hop = 0.0
    q1 -= hop
    in_flight = hop > 0.0 or normal_force(s, cos, q, q1) < 0.0
    return Phase(tau, ROOT, in_flight, 0.0, hop, q, q1, used)


@inlined
def _chatter_ends(s: Spring, sin: float, cos: float, hop: float, q: float, q1: float) -> bool:
    """Whether the chatter that begins with `hop` may be summed, n being that of a mass that sticks."""
    h, h1 = q - s.static_elongation - (s.q_re * cos - s.q_im * sin), q1 + (s.q_re * sin + s.q_im * cos)
    h2, h3, _ = derivatives(s.stuck, h, h1)
    h4, h5, _ = derivatives(s.stuck, h2, h3)
    rate = h3 + s.n_re * sin + s.n_im * cos
    bound = abs(s.n_re) + abs(s.n_im) + envelope(s.stuck, h4, h5)
    return chatter_completes(hop, normal_force(s, cos, q, q1), rate, bound, s.restitution)
