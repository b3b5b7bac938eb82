"""The bouncing spring on a soft plate, solved exactly (paper Eqs. 9 to 12, MODEL section 2).

In contact the plate pushes with n = -(kappa gap + beta gap'). The motion is the plate's
drive plus two damped oscillators, a slow one (the spring's) and a fast one (the contact's),
so that no time steps are needed however stiff the contact is: the search for take-off steps
over the fast ringing as soon as it is too small to lift the mass.

adhesive: contact while gap < 0; take-off and landing are zeros of the gap, and n may pull.
nonadhesive: contact while gap < 0 and n > 0, so that a flight begins below the plate.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.events import EPS, HORIZON, ROOT, Phase, Terms, first_root, terms
from kernel.flight import Flight, flight_terms, landing, state_after, take_off
from kernel.impact import damping_ratio
from kernel.jit import jit
from kernel.model import contact, flies, flight, prepare, rest
from kernel.oscillator import Oscillator, derivatives, envelope, motion, oscillator
from kernel.quartic import factor

#: As in `rigid`: an undamped spring exactly at resonance is computed as one this far beside it.
NEAREST_RESONANCE: Final = 1e-8


class SoftPlate(NamedTuple):
    """The plate under each cell of a line."""

    restitution: NDArray[np.float64]  # (n,) true restitution of an isolated impact
    penetration: NDArray[np.float64]  # (n,) d, plate amplitudes
    adhesive: bool


class SoftSpring(NamedTuple):
    """One cell's constants."""

    gravity: float  # 1/Gamma
    dashpot: float  # 2 xi/Omega
    stiffness: float  # 1/Omega**2
    kappa: float  # contact stiffness 1/d**2
    beta: float  # contact damping 2 zeta/d
    adhesive: bool
    flight: Oscillator
    slow: Oscillator
    fast: Oscillator
    sag: float  # static elongation
    dent: float  # static gap, < 0
    q_re: float  # driven elongation Re(Q e^{i phi})
    q_im: float
    g_re: float  # driven gap Re(G e^{i phi})
    g_im: float
    follow: float  # in the fast motion q = follow * gap + lag * gap'
    lag: float


class Split(NamedTuple):
    """The free motion in contact, told apart into slow and fast."""

    gap_slow: float
    gap1_slow: float
    gap_fast: float
    gap1_fast: float
    q_slow: float
    q1_slow: float


class Pressed(NamedTuple):
    """What must stay positive in contact: -kappa gap (adhesive) or n."""

    slow_osc: Oscillator
    fast_osc: Oscillator
    phi: float
    still: float  # the static part
    w_re: float  # the driven part Re(W e^{i phi})
    w_im: float
    slow: float
    slow1: float
    fast: float
    fast1: float


class Recoil(NamedTuple):
    """kappa gap + beta gap' while a nonadhesive contact springs back: zero brings the plate back to bear."""

    flight: Flight
    kappa: float
    beta: float


class Dip(NamedTuple):
    """-gap of a lower mass still below the plate."""

    flight: Flight


@prepare.register(SoftPlate)
@jit
def _prepare(plate: SoftPlate, i: int, gamma: float, omega: float, xi: float) -> SoftSpring:
    d = plate.penetration[i]
    zeta = damping_ratio(plate.restitution[i], plate.adhesive)
    w, b, kappa, beta = 1.0 / (omega * omega), 2.0 * xi / omega, 1.0 / (d * d), 2.0 * zeta / d
    # G (K (z - 1) - (2z - 1)) = 2z - 1 and (2z - 1) Q = K G, with z = w + i b and K = kappa + i beta
    z, k = complex(w, b), complex(kappa, beta)
    below = (z - 1.0) - (2.0 * z - 1.0) / k
    if abs(below) < NEAREST_RESONANCE * w:
        w *= 1.0 + 2.0 * NEAREST_RESONANCE
        z = complex(w, b)
        below = (z - 1.0) - (2.0 * z - 1.0) / k
    f = factor(beta + 2.0 * b, kappa + 2.0 * w + b * beta, b * kappa + w * beta, w * kappa)
    driven_q = 1.0 / below
    driven_gap = (2.0 * z - 1.0) / k * driven_q
    # the two masses together weigh on the plate alone: q'' + b q' + w q = -gap'' in every free motion
    p, r = w - f.b2, b - f.a2
    det = p * p - f.a2 * r * p + r * r * f.b2
    return SoftSpring(
        gravity=1.0 / gamma,
        dashpot=b,
        stiffness=w,
        kappa=kappa,
        beta=beta,
        adhesive=plate.adhesive,
        flight=oscillator(b, 2.0 * w),
        slow=oscillator(0.5 * f.a1, f.b1),
        fast=oscillator(0.5 * f.a2, f.b2),
        sag=-1.0 / (gamma * w),
        dent=-2.0 / (gamma * kappa),
        q_re=driven_q.real,
        q_im=driven_q.imag,
        g_re=driven_gap.real,
        g_im=driven_gap.imag,
        follow=f.b2 * p / det,
        lag=(p * f.a2 - r * f.b2) / det,
    )


@rest.register(SoftSpring)
@jit
def _rest(s: SoftSpring) -> tuple[float, float, float, float]:
    return s.dent, 0.0, s.sag, 0.0


@flies.register(SoftSpring)
@jit
def _flies(s: SoftSpring, phi: float, gap: float, gap1: float, q: float, q1: float) -> bool:
    if gap > 0.0 or (gap == 0.0 and gap1 >= 0.0):
        return True
    return not s.adhesive and s.kappa * gap + s.beta * gap1 >= 0.0


@jit
def _split(s: SoftSpring, phi: float, gap: float, gap1: float, q: float, q1: float) -> Split:
    """Take off the static and driven parts; project what is left on the fast oscillator."""
    sin, cos = math.sin(phi), math.cos(phi)
    q -= s.sag + s.q_re * cos - s.q_im * sin
    q1 += s.q_re * sin + s.q_im * cos
    gap -= s.dent + s.g_re * cos - s.g_im * sin
    gap1 += s.g_re * sin + s.g_im * cos
    push = s.kappa * gap + s.beta * gap1
    push1 = s.dashpot * q1 + s.stiffness * q - push
    gap2 = push1
    gap3 = (
        s.stiffness * q1
        + s.dashpot * (push - 2.0 * s.dashpot * q1 - 2.0 * s.stiffness * q)
        - s.kappa * gap1
        - s.beta * gap2
    )
    a1, b1 = 2.0 * s.slow.damping, s.slow.stiffness
    a2, b2 = 2.0 * s.fast.damping, s.fast.stiffness
    left = gap2 + a1 * gap1 + b1 * gap
    left1 = gap3 + a1 * gap2 + b1 * gap1
    a, b = a1 - a2, b1 - b2
    det = b * (b - a * a2) + a * a * b2
    fast = (left * (b - a * a2) - a * left1) / det
    fast1 = (b * left1 + a * b2 * left) / det
    fast2 = -a2 * fast1 - b2 * fast
    return Split(
        gap - fast,
        gap1 - fast1,
        fast,
        fast1,
        q - (s.follow * fast + s.lag * fast1),
        q1 - (s.follow * fast1 + s.lag * fast2),
    )


@jit
def _join(s: SoftSpring, m: Split, phi: float, tau: float) -> tuple[float, float, float, float]:
    """Gap, gap', q, q' tau rad after a split at phase phi."""
    sin, cos = math.sin(phi + tau), math.cos(phi + tau)
    gap_slow, gap1_slow = motion(s.slow, m.gap_slow, m.gap1_slow, tau)
    q_slow, q1_slow = motion(s.slow, m.q_slow, m.q1_slow, tau)
    fast, fast1 = motion(s.fast, m.gap_fast, m.gap1_fast, tau)
    fast2 = -2.0 * s.fast.damping * fast1 - s.fast.stiffness * fast
    return (
        s.dent + s.g_re * cos - s.g_im * sin + gap_slow + fast,
        -(s.g_re * sin + s.g_im * cos) + gap1_slow + fast1,
        s.sag + s.q_re * cos - s.q_im * sin + q_slow + s.follow * fast + s.lag * fast1,
        -(s.q_re * sin + s.q_im * cos) + q1_slow + s.follow * fast1 + s.lag * fast2,
    )


@jit
def _pressed(s: SoftSpring, m: Split, phi: float) -> Pressed:
    """-(kappa gap + c gap') with c = 0 (adhesive) or beta (nonadhesive)."""
    c = 0.0 if s.adhesive else s.beta
    slow2 = -2.0 * s.slow.damping * m.gap1_slow - s.slow.stiffness * m.gap_slow
    fast2 = -2.0 * s.fast.damping * m.gap1_fast - s.fast.stiffness * m.gap_fast
    return Pressed(
        s.slow,
        s.fast,
        phi,
        still=-s.kappa * s.dent,
        w_re=-(s.kappa * s.g_re - c * s.g_im),
        w_im=-(s.kappa * s.g_im + c * s.g_re),
        slow=-(s.kappa * m.gap_slow + c * m.gap1_slow),
        slow1=-(s.kappa * m.gap1_slow + c * slow2),
        fast=-(s.kappa * m.gap_fast + c * m.gap1_fast),
        fast1=-(s.kappa * m.gap1_fast + c * fast2),
    )


@terms.register(Pressed)
@jit
def _pressed_terms(p: Pressed, tau: float) -> Terms:
    sin, cos = math.sin(p.phi + tau), math.cos(p.phi + tau)
    wave, wave1 = p.w_re * cos - p.w_im * sin, -(p.w_re * sin + p.w_im * cos)
    slow, slow1 = motion(p.slow_osc, p.slow, p.slow1, tau)
    slow2, slow3, slow4 = derivatives(p.slow_osc, slow, slow1)
    fast, fast1 = motion(p.fast_osc, p.fast, p.fast1, tau)
    fast2, fast3, fast4 = derivatives(p.fast_osc, fast, fast1)
    bound = abs(p.w_re) + abs(p.w_im)
    return Terms(
        smooth=p.still + wave + slow,
        smooth1=wave1 + slow1,
        smooth2=slow2 - wave,
        smooth3=slow3 - wave1,
        smooth4=slow4 + bound,
        ring=fast,
        ring1=fast1,
        ring2=fast2,
        ring3=fast3,
        ring4=fast4,
        amplitude=envelope(p.fast_osc, fast, fast1),
        noise=4.0 * EPS * (p.still + bound + abs(slow) + abs(fast)),
    )


@contact.register(SoftSpring)
@jit
def _contact(
    s: SoftSpring, phi: float, gap: float, gap1: float, q: float, q1: float, horizon: float, budget: int
) -> Phase:
    m = _split(s, phi, gap, gap1, q, q1)
    p = _pressed(s, m, phi)
    ringing = envelope(s.slow, p.slow, p.slow1) + envelope(s.fast, p.fast, p.fast1)
    if p.still - math.hypot(p.w_re, p.w_im) > ringing:
        tau, ending, used = horizon, HORIZON, 1  # nothing can lift it any more
    else:
        tau, ending, used = first_root(p, 0.0, horizon, budget)
    gap, gap1, q, q1 = _join(s, m, phi, tau)
    if ending == ROOT and s.adhesive:
        gap, gap1 = 0.0, max(gap1, 0.0)
    return Phase(tau, ending, ending == ROOT, gap, gap1, q, q1, used)


@terms.register(Dip)
@jit
def _dip_terms(p: Dip, tau: float) -> Terms:
    t = flight_terms(p.flight, tau)
    return Terms(
        -t.smooth, -t.smooth1, -t.smooth2, -t.smooth3, t.smooth4,
        -t.ring, -t.ring1, -t.ring2, -t.ring3, t.ring4, t.amplitude, t.noise,
    )  # fmt: skip


@terms.register(Recoil)
@jit
def _recoil_terms(p: Recoil, tau: float) -> Terms:
    f = p.flight
    t = flight_terms(f, tau)
    q, q1 = motion(f.osc, f.q, f.q1, tau)
    q2, q3, _ = derivatives(f.osc, q, q1)
    q4, _, _ = derivatives(f.osc, q2, q3)
    _, _, q5 = derivatives(f.osc, q1, q2)
    gap4 = -math.cos(f.phi + tau) - 0.5 * q4
    k, c = p.kappa, p.beta
    return Terms(
        smooth=k * (t.smooth + t.ring) + c * (t.smooth1 + t.ring1),
        smooth1=k * (t.smooth1 + t.ring1) + c * (t.smooth2 + t.ring2),
        smooth2=k * (t.smooth2 + t.ring2) + c * (t.smooth3 + t.ring3),
        smooth3=k * (t.smooth3 + t.ring3) + c * gap4,
        smooth4=k * (t.smooth4 + t.ring4) + c * (1.0 + 0.5 * q5),
        ring=0.0,
        ring1=0.0,
        ring2=0.0,
        ring3=0.0,
        ring4=0.0,
        amplitude=math.inf,
        noise=k * t.noise + 4.0 * EPS * c * abs(t.smooth1 + t.ring1),
    )


@flight.register(SoftSpring)
@jit
def _flight(
    s: SoftSpring, phi: float, gap: float, gap1: float, q: float, q1: float, horizon: float, budget: int
) -> Phase:
    p = take_off(s.flight, s.gravity, phi, gap, gap1, q, q1)
    clear, used = 0.0, 0
    if gap < 0.0:
        clear, ending, used = first_root(Dip(p), 0.0, horizon, budget)
        tau, pressed, more = first_root(Recoil(p, s.kappa, s.beta), 0.0, clear, budget - used)
        used += more
        if pressed != HORIZON or ending != ROOT:
            # the plate bears again before the mass is clear of it, or the window ends first
            gap, gap1, q, q1 = state_after(p, tau)
            ending = ending if pressed == HORIZON else pressed
            return Phase(tau, ending, ending != ROOT, gap, gap1, q, q1, used)
    tau, ending, more = landing(p, clear, horizon, budget - used)
    gap, gap1, q, q1 = state_after(p, tau)
    if ending == ROOT:
        gap, gap1 = 0.0, min(gap1, 0.0)
    return Phase(tau, ending, ending != ROOT, gap, gap1, q, q1, used + more)
