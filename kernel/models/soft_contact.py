"""The motion in soft contact, in closed form (paper Eqs. 9 to 12; docs/model.md, section 2).

The plate pushes with n = -(kappa gap + beta gap'). The motion is a static part, a driven part at the
plate's frequency, and two free modes, each a damped oscillator. In the *gap mode* the gap is the leading
coordinate and the elongation is coupled to it; in the *elongation mode* it is the other way round.

The stiffer the contact, the smaller the gap of the elongation mode, as 1/kappa; yet between impacts n is
made of it. So it is computed from the elongation that it is coupled to, never as a difference of the total
gap and the gap mode's.
"""

import math
from typing import Final, NamedTuple

from kernel.models.contact_law import contact_constants, damping_ratio, static_state
from kernel.numerics.elementary import sincos
from kernel.numerics.first_root import EPS, Terms, terms
from kernel.numerics.jit import jit
from kernel.numerics.oscillator import Oscillator, derivatives, envelope, motion, oscillator
from kernel.numerics.quartic import paired, roots

#: As in `rigid`: the relative distance to an undamped resonance is kept above this.
NEAREST_RESONANCE: Final = 1e-8

#: The modes of a cell whose numbers are too far apart for any factors to be found: the cell diverges.
UNDEFINED: Final = Oscillator(math.nan, math.nan, math.nan, math.nan, math.nan, math.nan, math.nan)


class Coupling(NamedTuple):
    """In one free mode the coupled coordinate is value * x + rate * x', x being the leading one."""

    value: float
    rate: float
    quality: float  # 0 to 1: the part of the terms it was computed from that did not cancel


class Modes(NamedTuple):
    """The free motion in contact as two damped oscillators."""

    gap_mode: Oscillator
    elongation_mode: Oscillator
    elongation: Coupling  # the elongation in the gap mode
    gap: Coupling  # the gap in the elongation mode


class SoftSpring(NamedTuple):
    """One cell's constants."""

    gravity: float  # 1/Gamma
    dashpot: float  # 2 xi/Omega
    stiffness: float  # 1/Omega**2
    kappa: float  # contact stiffness 1/d**2
    beta: float  # contact damping 2 zeta/d
    adhesive: bool
    flight: Oscillator  # the elongation's in flight
    gap_mode: Oscillator
    elongation_mode: Oscillator
    elongation: Coupling  # the elongation in the gap mode
    gap: Coupling  # the gap in the elongation mode
    decoupling: tuple[float, float, float, float]  # the inverse of 1 - gap * elongation, by rows
    static_elongation: float  # < 0
    static_gap: float  # < 0
    q_re: float  # driven elongation Re(Q e^{i phi})
    q_im: float
    g_re: float  # driven gap Re(G e^{i phi})
    g_im: float


class ModalState(NamedTuple):
    """The free motion in contact: the leading coordinate of each mode with its velocity."""

    gap: float  # of the gap mode
    gap1: float
    q: float  # of the elongation mode
    q1: float


class LiftoffFunction(NamedTuple):
    """The phase function of a contact: -kappa gap (adhesive) or n (nonadhesive), zero at lift-off."""

    slow_osc: Oscillator
    fast_osc: Oscillator
    phi: float
    static: float  # the static part
    wave_re: float  # the driven part Re(W e^{i phi})
    wave_im: float
    slow: float  # the two modes' parts at tau = 0, with their rates
    slow1: float
    fast: float
    fast1: float


@jit
def soft_spring(
    gamma: float, omega: float, xi: float, restitution: float, d: float, adhesive: bool
) -> SoftSpring:
    """The constants of one cell whose contact has this restitution and penetration d (plate amplitudes)."""
    kappa, beta = contact_constants(d, damping_ratio(restitution, adhesive))
    w, b = 1.0 / (omega * omega), 2.0 * xi / omega
    # G (K (z - 1) - (2z - 1)) = 2z - 1 and (2z - 1) Q = K G, with z = w + i b and K = kappa + i beta
    z, k = complex(w, b), complex(kappa, beta)
    below = (z - 1.0) - (2.0 * z - 1.0) / k
    if abs(below) < NEAREST_RESONANCE * w:
        w *= 1.0 + 2.0 * NEAREST_RESONANCE
        z = complex(w, b)
        below = (z - 1.0) - (2.0 * z - 1.0) / k
    driven_q = 1.0 / below
    driven_gap = (2.0 * z - 1.0) / k * driven_q
    free = _separate_modes(b, w, beta, kappa)
    static_gap, static_elongation = static_state(gamma, w, kappa)
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
        static_elongation=static_elongation,
        static_gap=static_gap,
        q_re=driven_q.real,
        q_im=driven_q.imag,
        g_re=driven_gap.real,
        g_im=driven_gap.imag,
    )


@jit
def _coupling(osc: Oscillator, b: float, w: float, c1: float, c0: float) -> Coupling:
    """The y of y'' + b y' + w y = c1 x' + c0 x, where x, and so y, moves as the oscillator does."""
    a1, a0 = 2.0 * osc.damping, osc.stiffness
    # (value + rate s)(p + r s) = c0 + c1 s wherever s**2 + a1 s + a0 = 0
    # with p**2 - p r a1 + r**2 a0 and c1 p - c0 r expanded, so that nothing large cancels
    p, r = w - a0, b - a1
    det = p * p + r * (b * a0 - w * a1)
    size, size1 = w + a0, b + a1
    quality = abs(det) / (size * size + size * size1 * a1 + size1 * size1 * a0)
    value, rate = c0 * p + r * (c1 * a0 - c0 * a1), (c1 * w - c0 * b) + (c0 * a1 - c1 * a0)
    return Coupling(value / det, rate / det, quality)


@jit
def _separate_modes(b: float, w: float, beta: float, kappa: float) -> Modes:
    """The free motion in two modes: of the six ways to choose them, that in which least cancels.

    The free motion obeys q'' + b q' + w q = -gap'' and gap'' + beta gap' + kappa gap = b q' + w q, whose
    characteristic polynomial is the quartic below. It has three pairs of quadratic factors, and either
    factor of a pair may be the gap mode.
    """
    c3, c2, c1, c0 = beta + 2.0 * b, kappa + 2.0 * w + b * beta, b * kappa + w * beta, w * kappa
    z = roots(c3, c2, c1, c0)
    best_quality, best = -1.0, Modes(UNDEFINED, UNDEFINED, Coupling(0.0, 0.0, 0.0), Coupling(0.0, 0.0, 0.0))
    for partner in (1, 2, 3):
        separation, f = paired(c3, c2, c1, c0, z, partner)
        if separation == 0.0:
            continue
        slow, fast = oscillator(0.5 * f.a1, f.b1), oscillator(0.5 * f.a2, f.b2)
        for gap_mode, elongation_mode in ((fast, slow), (slow, fast)):
            elongation = _coupling(gap_mode, b, w, 2.0 * gap_mode.damping, gap_mode.stiffness)
            gap = _coupling(elongation_mode, beta, kappa, b, w)
            quality = separation * elongation.quality * gap.quality
            if quality > best_quality:
                best_quality, best = quality, Modes(gap_mode, elongation_mode, elongation, gap)
    return best


@jit
def _coupled(coupling: Coupling, osc: Oscillator, x: float, x1: float) -> tuple[float, float]:
    """The coupled coordinate and its velocity, where the leading one is x with velocity x1."""
    x2 = -2.0 * osc.damping * x1 - osc.stiffness * x
    return coupling.value * x + coupling.rate * x1, coupling.value * x1 + coupling.rate * x2


@jit
def _decoupling(f: Modes) -> tuple[float, float, float, float]:
    """The inverse of 1 - G E by rows, E being the gap mode's coupling as a matrix and G the other's."""
    q, q1 = _coupled(f.elongation, f.gap_mode, 1.0, 0.0)
    m00, m10 = _coupled(f.gap, f.elongation_mode, q, q1)
    q, q1 = _coupled(f.elongation, f.gap_mode, 0.0, 1.0)
    m01, m11 = _coupled(f.gap, f.elongation_mode, q, q1)
    m00, m01, m10, m11 = 1.0 - m00, -m01, -m10, 1.0 - m11
    det = m00 * m11 - m01 * m10
    return m11 / det, -m01 / det, -m10 / det, m00 / det


@jit
def to_modes(s: SoftSpring, phi: float, gap: float, gap1: float, q: float, q1: float) -> ModalState:
    """The free modes of a state at phase phi: subtracts the static and driven parts and separates the rest.

    The rest is gap = g + G h and q = h + E g, g and h being the leading coordinates and E and G the
    couplings. Solved for g = (1 - G E)^-1 (gap - G q) and h = q - E g, so that the small gap of the
    elongation mode is never a difference of large numbers.
    """
    sin, cos = sincos(phi)
    q -= s.static_elongation + s.q_re * cos - s.q_im * sin
    q1 += s.q_re * sin + s.q_im * cos
    gap -= s.static_gap + s.g_re * cos - s.g_im * sin
    gap1 += s.g_re * sin + s.g_im * cos
    coupled, coupled1 = _coupled(s.gap, s.elongation_mode, q, q1)
    left, left1 = gap - coupled, gap1 - coupled1
    m00, m01, m10, m11 = s.decoupling
    gap, gap1 = m00 * left + m01 * left1, m10 * left + m11 * left1
    coupled, coupled1 = _coupled(s.elongation, s.gap_mode, gap, gap1)
    return ModalState(gap, gap1, q - coupled, q1 - coupled1)


@jit
def from_modes(s: SoftSpring, m: ModalState, phi: float, tau: float) -> tuple[float, float, float, float]:
    """gap, gap', q, q' at tau rad, where the modes are `m` at phase phi and tau = 0."""
    sin, cos = sincos(phi + tau)
    gap, gap1 = motion(s.gap_mode, m.gap, m.gap1, tau)
    q, q1 = motion(s.elongation_mode, m.q, m.q1, tau)
    coupled_gap, coupled_gap1 = _coupled(s.gap, s.elongation_mode, q, q1)
    coupled_q, coupled_q1 = _coupled(s.elongation, s.gap_mode, gap, gap1)
    return (
        s.static_gap + s.g_re * cos - s.g_im * sin + coupled_gap + gap,
        -(s.g_re * sin + s.g_im * cos) + coupled_gap1 + gap1,
        s.static_elongation + s.q_re * cos - s.q_im * sin + q + coupled_q,
        -(s.q_re * sin + s.q_im * cos) + q1 + coupled_q1,
    )


@jit
def _force(osc: Oscillator, kappa: float, c: float, gap: float, gap1: float) -> tuple[float, float]:
    """-(kappa gap + c gap') and its rate, where the gap moves as the oscillator does."""
    gap2 = -2.0 * osc.damping * gap1 - osc.stiffness * gap
    return -(kappa * gap + c * gap1), -(kappa * gap1 + c * gap2)


@jit
def liftoff_function(s: SoftSpring, m: ModalState, phi: float) -> LiftoffFunction:
    """The lift-off function -(kappa gap + c gap') from phi on, with c = 0 (adhesive) or beta (nonadhesive).

    The stiffer of the two modes is its ringing part.
    """
    c = 0.0 if s.adhesive else s.beta
    gap, gap1 = _coupled(s.gap, s.elongation_mode, m.q, m.q1)
    f, f1 = _force(s.gap_mode, s.kappa, c, m.gap, m.gap1)
    g, g1 = _force(s.elongation_mode, s.kappa, c, gap, gap1)
    gap_rings = s.gap_mode.stiffness >= s.elongation_mode.stiffness
    slow, slow1, fast, fast1 = (g, g1, f, f1) if gap_rings else (f, f1, g, g1)
    return LiftoffFunction(
        s.elongation_mode if gap_rings else s.gap_mode,
        s.gap_mode if gap_rings else s.elongation_mode,
        phi,
        static=-s.kappa * s.static_gap,
        wave_re=-(s.kappa * s.g_re - c * s.g_im),
        wave_im=-(s.kappa * s.g_im + c * s.g_re),
        slow=slow,
        slow1=slow1,
        fast=fast,
        fast1=fast1,
    )


@terms.register(LiftoffFunction)
@jit
def _liftoff_terms(p: LiftoffFunction, tau: float) -> Terms:
    """The static and driven parts and the slower mode are smooth, the faster mode rings."""
    sin, cos = sincos(p.phi + tau)
    wave, wave1 = p.wave_re * cos - p.wave_im * sin, -(p.wave_re * sin + p.wave_im * cos)
    slow, slow1 = motion(p.slow_osc, p.slow, p.slow1, tau)
    slow2, slow3, slow4 = derivatives(p.slow_osc, slow, slow1)
    fast, fast1 = motion(p.fast_osc, p.fast, p.fast1, tau)
    fast2, fast3, fast4 = derivatives(p.fast_osc, fast, fast1)
    bound = abs(p.wave_re) + abs(p.wave_im)
    return Terms(
        smooth=p.static + wave + slow,
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
        noise=4.0 * EPS * (p.static + bound + abs(slow) + abs(fast)),
    )
