"""The spring pressed on a soft plate, exactly (paper Eqs. 9 to 12, MODEL section 2).

The plate pushes with n = -(kappa gap + beta gap'). The motion is what the plate drives plus two
damped oscillators, one in which the gap leads and the elongation follows, and one the other way
round, so that no time steps are needed however stiff the contact is.

The stiffer it is, the less the spring's own motion dents the plate: as 1/kappa. That dent, and
not the gap, is what n is made of between impacts. So it is worked out from the elongation that
it follows, never as what is left of the gap when the contact's ringing is taken away.
"""

import math
from typing import Final, NamedTuple

from kernel.models.contact_law import damping_ratio
from kernel.numerics.elementary import turned
from kernel.numerics.first_root import EPS, Terms, terms
from kernel.numerics.jit import jit
from kernel.numerics.oscillator import Oscillator, derivatives, envelope, motion, oscillator
from kernel.numerics.quartic import paired, roots

#: As in `rigid`: an undamped spring exactly at resonance is computed as one this far beside it.
NEAREST_RESONANCE: Final = 1e-8

#: What comes of numbers too far apart to find any: the cell diverges.
NOTHING: Final = Oscillator(math.nan, math.nan, math.nan, math.nan, math.nan, math.nan, math.nan)


class Coupling(NamedTuple):
    """Within one free motion, what follows is value * x + rate * x' where x leads."""

    value: float
    rate: float
    trust: float  # 0 to 1: how much of the numbers it was worked out from did not cancel


class Free(NamedTuple):
    """The free motion in contact as two damped oscillators."""

    gap_mode: Oscillator
    elongation_mode: Oscillator
    elongation: Coupling  # how the elongation follows the gap in the first
    gap: Coupling  # how the gap follows the elongation in the second


class SoftSpring(NamedTuple):
    """One cell's constants."""

    gravity: float  # 1/Gamma
    dashpot: float  # 2 xi/Omega
    stiffness: float  # 1/Omega**2
    kappa: float  # contact stiffness 1/d**2
    beta: float  # contact damping 2 zeta/d
    adhesive: bool
    flight: Oscillator
    gap_mode: Oscillator
    elongation_mode: Oscillator
    elongation: Coupling  # how the elongation follows the gap
    gap: Coupling  # how the gap follows the elongation
    decoupling: tuple[float, float, float, float]  # the inverse of 1 - gap * elongation, by rows
    sag: float  # static elongation
    dent: float  # static gap, < 0
    q_re: float  # driven elongation Re(Q e^{i phi})
    q_im: float
    g_re: float  # driven gap Re(G e^{i phi})
    g_im: float


class Split(NamedTuple):
    """The free motion in contact: what leads in each of its two parts."""

    gap: float
    gap1: float
    q: float
    q1: float


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


@jit
def soft_spring(
    gamma: float, omega: float, xi: float, restitution: float, d: float, adhesive: bool
) -> SoftSpring:
    """The constants of one cell and its contact of penetration d."""
    zeta = damping_ratio(restitution, adhesive)
    w, b, kappa, beta = 1.0 / (omega * omega), 2.0 * xi / omega, 1.0 / (d * d), 2.0 * zeta / d
    # G (K (z - 1) - (2z - 1)) = 2z - 1 and (2z - 1) Q = K G, with z = w + i b and K = kappa + i beta
    z, k = complex(w, b), complex(kappa, beta)
    below = (z - 1.0) - (2.0 * z - 1.0) / k
    if abs(below) < NEAREST_RESONANCE * w:
        w *= 1.0 + 2.0 * NEAREST_RESONANCE
        z = complex(w, b)
        below = (z - 1.0) - (2.0 * z - 1.0) / k
    driven_q = 1.0 / below
    driven_gap = (2.0 * z - 1.0) / k * driven_q
    free = _told_apart(b, w, beta, kappa)
    return SoftSpring(
        gravity=1.0 / gamma,
        dashpot=b,
        stiffness=w,
        kappa=kappa,
        beta=beta,
        adhesive=adhesive,
        flight=oscillator(b, 2.0 * w),
        gap_mode=free.gap_mode,
        elongation_mode=free.elongation_mode,
        elongation=free.elongation,
        gap=free.gap,
        decoupling=_decoupling(free),
        sag=-1.0 / (gamma * w),
        dent=-2.0 / (gamma * kappa),
        q_re=driven_q.real,
        q_im=driven_q.imag,
        g_re=driven_gap.real,
        g_im=driven_gap.imag,
    )


@jit
def _coupling(osc: Oscillator, b: float, w: float, c1: float, c0: float) -> Coupling:
    """The y of y'' + b y' + w y = c1 x' + c0 x where x, and so y, moves as the oscillator does."""
    a1, a0 = 2.0 * osc.damping, osc.stiffness
    # (value + rate s)(p + r s) = c0 + c1 s wherever s**2 + a1 s + a0 = 0
    # with p**2 - p r a1 + r**2 a0 and c1 p - c0 r expanded, so that nothing large cancels
    p, r = w - a0, b - a1
    det = p * p + r * (b * a0 - w * a1)
    size, spread = w + a0, b + a1
    trust = abs(det) / (size * size + size * spread * a1 + spread * spread * a0)
    value, rate = c0 * p + r * (c1 * a0 - c0 * a1), (c1 * w - c0 * b) + (c0 * a1 - c1 * a0)
    return Coupling(value / det, rate / det, trust)


@jit
def _told_apart(b: float, w: float, beta: float, kappa: float) -> Free:
    """The free motion in two parts: of all ways to choose them the one in which least cancels.

    Free, q'' + b q' + w q = -gap'' (the masses together weigh on the plate alone) and
    gap'' + beta gap' + kappa gap = b q' + w q.
    """
    c3, c2, c1, c0 = beta + 2.0 * b, kappa + 2.0 * w + b * beta, b * kappa + w * beta, w * kappa
    z = roots(c3, c2, c1, c0)
    most, best = -1.0, Free(NOTHING, NOTHING, Coupling(0.0, 0.0, 0.0), Coupling(0.0, 0.0, 0.0))
    for partner in (1, 2, 3):
        apart, f = paired(c3, c2, c1, c0, z, partner)
        if apart == 0.0:
            continue
        slow, fast = oscillator(0.5 * f.a1, f.b1), oscillator(0.5 * f.a2, f.b2)
        for gap_mode, elongation_mode in ((fast, slow), (slow, fast)):
            elongation = _coupling(gap_mode, b, w, 2.0 * gap_mode.damping, gap_mode.stiffness)
            gap = _coupling(elongation_mode, beta, kappa, b, w)
            trust = apart * elongation.trust * gap.trust
            if trust > most:
                most, best = trust, Free(gap_mode, elongation_mode, elongation, gap)
    return best


@jit
def _follow(tie: Coupling, osc: Oscillator, x: float, x1: float) -> tuple[float, float]:
    """What follows, and its velocity, where x leads in this oscillator."""
    x2 = -2.0 * osc.damping * x1 - osc.stiffness * x
    return tie.value * x + tie.rate * x1, tie.value * x1 + tie.rate * x2


@jit
def _decoupling(f: Free) -> tuple[float, float, float, float]:
    q, q1 = _follow(f.elongation, f.gap_mode, 1.0, 0.0)
    m00, m10 = _follow(f.gap, f.elongation_mode, q, q1)
    q, q1 = _follow(f.elongation, f.gap_mode, 0.0, 1.0)
    m01, m11 = _follow(f.gap, f.elongation_mode, q, q1)
    m00, m01, m10, m11 = 1.0 - m00, -m01, -m10, 1.0 - m11
    det = m00 * m11 - m01 * m10
    return m11 / det, -m01 / det, -m10 / det, m00 / det


@jit
def split(s: SoftSpring, phi: float, gap: float, gap1: float, q: float, q1: float) -> Split:
    """Take off the static and driven parts, and tell apart what is left.

    gap = led + gap * q_led and q = q_led + elongation * led: solved for what leads, so that
    the little by which the spring's slow motion dents the plate is never a difference of
    large numbers.
    """
    sin, cos = turned(phi)
    q -= s.sag + s.q_re * cos - s.q_im * sin
    q1 += s.q_re * sin + s.q_im * cos
    gap -= s.dent + s.g_re * cos - s.g_im * sin
    gap1 += s.g_re * sin + s.g_im * cos
    follows, follows1 = _follow(s.gap, s.elongation_mode, q, q1)
    left, left1 = gap - follows, gap1 - follows1
    m00, m01, m10, m11 = s.decoupling
    led, led1 = m00 * left + m01 * left1, m10 * left + m11 * left1
    follows, follows1 = _follow(s.elongation, s.gap_mode, led, led1)
    return Split(led, led1, q - follows, q1 - follows1)


@jit
def join(s: SoftSpring, m: Split, phi: float, tau: float) -> tuple[float, float, float, float]:
    """Gap, gap', q, q' tau rad after a split at phase phi."""
    sin, cos = turned(phi + tau)
    led, led1 = motion(s.gap_mode, m.gap, m.gap1, tau)
    q, q1 = motion(s.elongation_mode, m.q, m.q1, tau)
    gap, gap1 = _follow(s.gap, s.elongation_mode, q, q1)
    follows, follows1 = _follow(s.elongation, s.gap_mode, led, led1)
    return (
        s.dent + s.g_re * cos - s.g_im * sin + gap + led,
        -(s.g_re * sin + s.g_im * cos) + gap1 + led1,
        s.sag + s.q_re * cos - s.q_im * sin + q + follows,
        -(s.q_re * sin + s.q_im * cos) + q1 + follows1,
    )


@jit
def _force(osc: Oscillator, kappa: float, c: float, gap: float, gap1: float) -> tuple[float, float]:
    """-(kappa gap + c gap') and its rate."""
    gap2 = -2.0 * osc.damping * gap1 - osc.stiffness * gap
    return -(kappa * gap + c * gap1), -(kappa * gap1 + c * gap2)


@jit
def pressed(s: SoftSpring, m: Split, phi: float) -> Pressed:
    """-(kappa gap + c gap') from phi on, with c = 0 (adhesive) or beta (nonadhesive)."""
    c = 0.0 if s.adhesive else s.beta
    gap, gap1 = _follow(s.gap, s.elongation_mode, m.q, m.q1)
    led, led1 = _force(s.gap_mode, s.kappa, c, m.gap, m.gap1)
    follows, follows1 = _force(s.elongation_mode, s.kappa, c, gap, gap1)
    gap_rings = s.gap_mode.stiffness >= s.elongation_mode.stiffness
    slow, slow1, fast, fast1 = (follows, follows1, led, led1) if gap_rings else (led, led1, follows, follows1)
    return Pressed(
        s.elongation_mode if gap_rings else s.gap_mode,
        s.gap_mode if gap_rings else s.elongation_mode,
        phi,
        still=-s.kappa * s.dent,
        w_re=-(s.kappa * s.g_re - c * s.g_im),
        w_im=-(s.kappa * s.g_im + c * s.g_re),
        slow=slow,
        slow1=slow1,
        fast=fast,
        fast1=fast1,
    )


@terms.register(Pressed)
@jit
def _pressed_terms(p: Pressed, tau: float) -> Terms:
    sin, cos = turned(p.phi + tau)
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
