"""The motion in soft contact, in closed form (paper Eqs. 9 to 12; docs/model.md, section 2).

The plate pushes with n = -(kappa gap + beta gap'). The motion is a static part, a driven part at the
plate's frequency, and two free modes, each a damped oscillator. In the *gap mode* the gap is the leading
coordinate and the elongation is coupled to it; in the *elongation mode* it is the other way round.

The stiffer the contact, the smaller the gap of the elongation mode, as 1/kappa; yet between impacts n is
made of it. So it is computed from the elongation that it is coupled to, never as a difference of the total
gap and the gap mode's.

The more damped the contact, the further apart the rates of the gap mode: the mass stops within 1/beta rad and
creeps back at kappa/beta = 1/(2 zeta d). Of that creep n is 1/(2 zeta)**2 of kappa gap, and nearly all of
kappa gap + beta gap' cancels. So an overdamped mode is carried by its two amplitudes
(`kernel.numerics.oscillator`), and n follows from each by the sum that cancels least (`_gap_to_force`).
"""

import math
from typing import Final, NamedTuple

from kernel.interface import PlatePhase, State
from kernel.models.contact_law import contact_constants, static_state
from kernel.numerics.elementary import TWO_PI, exp, sincos
from kernel.numerics.first_root import EPS, Terms, terms
from kernel.numerics.jit import inlined, jit
from kernel.numerics.oscillator import (
    NEAR_CRITICAL,
    Derivatives,
    Oscillator,
    advance,
    all_derivatives,
    apart,
    coordinates,
    oscillator,
    position,
    propagate,
)
from kernel.numerics.quartic import paired, roots
from kernel.portable_math import atan2, hypot, log
from kernel.restitution import scalar_damping_ratio

#: As in `rigid`: the relative distance to an undamped resonance is kept above this.
NEAREST_RESONANCE: Final = 1e-8

#: The modes of a cell whose parameters are too far apart to find any factors: the cell diverges.
UNDEFINED: Final = Oscillator(*(math.nan,) * len(Oscillator._fields))


class Coupling(NamedTuple):
    """A quantity that follows a mode's leading one: first * x + second * x', or of its amplitudes a and b."""

    first: float
    second: float


class Modes(NamedTuple):
    """The free motion in contact as two damped oscillators."""

    gap_mode: Oscillator
    elongation_mode: Oscillator
    elongation: Coupling  # the elongation in the gap mode
    gap: Coupling  # the gap in the elongation mode


class _Contact(NamedTuple):
    """The coefficients of the free motion in contact."""

    b: float  # of the spring: 2 xi/Omega
    w: float  # 1/Omega**2
    beta: float
    kappa: float


class SoftSpring(NamedTuple):
    """One cell's constants."""

    gravity: float  # 1/Gamma
    kappa: float  # contact stiffness 1/d**2
    beta: float  # contact damping 2 zeta/d
    adhesive: bool
    flight: Oscillator  # the elongation's in flight
    gap_mode: Oscillator
    elongation_mode: Oscillator
    elongation: Coupling  # the elongation in the gap mode
    gap: Coupling  # the gap in the elongation mode
    gap_lift: Coupling  # the lift-off function in the gap mode
    elongation_lift: Coupling  # and in the elongation mode
    decoupling: tuple[float, float, float, float]  # the inverse of 1 - gap * elongation, by rows
    static_elongation: float  # < 0
    static_gap: float  # < 0
    q_re: float  # driven elongation Re(Q e^{i phi})
    q_im: float
    g_re: float  # driven gap Re(G e^{i phi})
    g_im: float
    static_lift: float  # of the lift-off function, > 0
    wave_re: float  # its driven part Re(W e^{i phi})
    wave_im: float
    margin: float  # static_lift - |W|: if positive, a take-off needs free modes of this size


class ModalState(NamedTuple):
    """The free motion in contact: the coordinates of each mode."""

    gap_a: float
    gap_b: float
    elongation_a: float
    elongation_b: float


class LiftoffFunction(NamedTuple):
    """The phase function of a contact: -kappa gap (adhesive) or n (nonadhesive), zero at lift-off."""

    slow_osc: Oscillator
    fast_osc: Oscillator
    phi: float
    static: float  # the static part
    wave_re: float  # the driven part Re(W e^{i phi})
    wave_im: float
    slow_a: float  # the coordinates of the two modes' parts at tau = 0
    slow_b: float
    fast_a: float
    fast_b: float


@jit
def soft_spring(
    gamma: float, omega: float, xi: float, restitution: float, d: float, adhesive: bool
) -> SoftSpring:
    """The constants of one cell whose contact has this restitution and penetration d (plate amplitudes)."""
    kappa, beta = contact_constants(d, scalar_damping_ratio(restitution, adhesive))
    w, b = 1.0 / (omega * omega), 2.0 * xi / omega
    flight = oscillator(b, 2.0 * w)  # not shifted from a resonance, which is of the contact
    # G (K (z - 1) - (2z - 1)) = 2z - 1 and (2z - 1) Q = K G, with z = w + i b and K = kappa + i beta
    z, k = complex(w, b), complex(kappa, beta)
    below = (z - 1.0) - (2.0 * z - 1.0) / k
    if hypot(below.real, below.imag) < NEAREST_RESONANCE * w:
        w *= 1.0 + 2.0 * NEAREST_RESONANCE
        z = complex(w, b)
        below = (z - 1.0) - (2.0 * z - 1.0) / k
    driven_q = 1.0 / below
    driven_gap = (2.0 * z - 1.0) / k * driven_q
    c = _Contact(b, w, beta, kappa)
    free = _separate_modes(c)
    static_gap, static_elongation = static_state(gamma, w, kappa)
    c1 = 0.0 if adhesive else beta
    wave_re = -(kappa * driven_gap.real - c1 * driven_gap.imag)
    wave_im = -(kappa * driven_gap.imag + c1 * driven_gap.real)
    return SoftSpring(
        gravity=1.0 / gamma,
        kappa=kappa,
        beta=beta,
        adhesive=adhesive,
        flight=flight,
        gap_mode=free.gap_mode,
        elongation_mode=free.elongation_mode,
        elongation=free.elongation,
        gap=free.gap,
        gap_lift=_gap_lift(c, free.gap_mode, adhesive),
        elongation_lift=_elongation_lift(c, free.elongation_mode, free.gap, adhesive),
        decoupling=_decoupling(free),
        static_elongation=static_elongation,
        static_gap=static_gap,
        q_re=driven_q.real,
        q_im=driven_q.imag,
        g_re=driven_gap.real,
        g_im=driven_gap.imag,
        static_lift=-kappa * static_gap,
        wave_re=wave_re,
        wave_im=wave_im,
        margin=-kappa * static_gap - hypot(wave_re, wave_im),
    )


@inlined
def _sum(x: float, y: float, z: float) -> tuple[float, float]:
    """x + y + z, and the part of it, 0 to 1, that did not cancel."""
    total = x + y + z
    return total, abs(total) / (abs(x) + abs(y) + abs(z))


@jit
def _gap_to_elongation(c: _Contact, rate: float) -> float:
    """q/gap of a free motion exp(rate tau), from (rate**2 + b rate + w) q = -rate**2 gap."""
    return -rate * rate / (rate * rate + c.b * rate + c.w)


@jit
def _elongation_to_gap(c: _Contact, rate: float) -> float:
    """gap/q of a free motion exp(rate tau)."""
    # (rate**2 + beta rate + kappa) gap = (b rate + w) q, or with the spring's force on both masses below
    driving, kept = _sum(c.b * rate, c.w, 0.0)
    if kept > 0.5:
        return driving / (rate * rate + c.beta * rate + c.kappa)
    return -rate * rate / (2.0 * rate * rate + c.beta * rate + c.kappa)


@jit
def _gap_to_force(c: _Contact, rate: float) -> float:
    """n/gap of a free motion exp(rate tau): -(kappa + beta rate), or as n = gap'' - b q' - w q."""
    # the first cancels where the mass creeps in an overdamped contact, the second where it is hardly felt
    force, kept = _sum(c.kappa, c.beta * rate, 0.0)
    free, kept1 = _sum(rate * rate, 2.0 * c.b * rate, 2.0 * c.w)  # zero in flight
    stuck, kept2 = _sum(rate * rate, c.b * rate, c.w)  # zero on a rigid plate
    return -force if kept > min(kept1, kept2) else rate * rate * free / stuck


@jit
def _elongation_to_force(c: _Contact, rate: float) -> float:
    """n/q of a free motion exp(rate tau), by the same choice as in `_gap_to_force`."""
    force, kept = _sum(c.kappa, c.beta * rate, 0.0)
    both, kept1 = _sum(force, 2.0 * rate * rate, 0.0)
    free, kept2 = _sum(rate * rate, 2.0 * c.b * rate, 2.0 * c.w)
    return force * rate * rate / both if min(kept, kept1) > kept2 else -free


@jit
def _gap_lift(c: _Contact, mode: Oscillator, adhesive: bool) -> Coupling:
    """The lift-off function -kappa gap (adhesive) or n in the gap mode."""
    if adhesive:
        return Coupling(-c.kappa, -c.kappa) if apart(mode) else Coupling(-c.kappa, 0.0)
    if apart(mode):
        return Coupling(_gap_to_force(c, mode.slow), _gap_to_force(c, mode.fast))
    return Coupling(-c.kappa, -c.beta)


@jit
def _elongation_lift(c: _Contact, mode: Oscillator, gap: Coupling, adhesive: bool) -> Coupling:
    """The lift-off function -kappa gap (adhesive) or n in the elongation mode, whose gap is `gap`."""
    if adhesive:
        return Coupling(-c.kappa * gap.first, -c.kappa * gap.second)
    if apart(mode):
        return Coupling(_elongation_to_force(c, mode.slow), _elongation_to_force(c, mode.fast))
    # -(kappa + beta d/dtau)(first + second d/dtau), with q'' from the mode's equation
    return Coupling(
        -(c.kappa * gap.first - c.beta * gap.second * mode.stiffness),
        -(c.kappa * gap.second + c.beta * (gap.first - 2.0 * mode.damping * gap.second)),
    )


@jit
def _coupling(osc: Oscillator, b: float, w: float, c1: float, c0: float) -> tuple[Coupling, float]:
    """The y of y'' + b y' + w y = c1 x' + c0 x, where x moves as the oscillator, as first * x + second * x'.

    Also returns the quality, 0 to 1: the part of the terms it was computed from that did not cancel.
    """
    a1, a0 = 2.0 * osc.damping, osc.stiffness
    # (value + rate s)(p + r s) = c0 + c1 s wherever s**2 + a1 s + a0 = 0
    # with p**2 - p r a1 + r**2 a0 and c1 p - c0 r expanded, so that nothing large cancels
    p, r = w - a0, b - a1
    det = p * p + r * (b * a0 - w * a1)
    size, size1 = w + a0, b + a1
    quality = abs(det) / (size * size + size * size1 * a1 + size1 * size1 * a0)
    value, rate = c0 * p + r * (c1 * a0 - c0 * a1), (c1 * w - c0 * b) + (c0 * a1 - c1 * a0)
    return Coupling(value / det, rate / det), quality


@jit
def _separate_modes(c: _Contact) -> Modes:
    """The free motion in two modes: of the six ways to choose them, that in which least cancels.

    It obeys q'' + b q' + w q = -gap'' and gap'' + beta gap' + kappa gap = b q' + w q. The characteristic
    quartic has three pairs of quadratic factors, and either of a pair may be the gap mode.
    """
    b, w, beta, kappa = c
    c3, c2, c1, c0 = beta + 2.0 * b, kappa + 2.0 * w + b * beta, b * kappa + w * beta, w * kappa
    z = roots(c3, c2, c1, c0)
    best_quality, best = -1.0, Modes(UNDEFINED, UNDEFINED, Coupling(0.0, 0.0), Coupling(0.0, 0.0))
    for partner in (1, 2, 3):
        separation, f = paired(c3, c2, c1, c0, z, partner)
        if separation == 0.0:
            continue
        slow, fast = oscillator(0.5 * f.a1, f.b1), oscillator(0.5 * f.a2, f.b2)
        for gap_mode, elongation_mode in ((fast, slow), (slow, fast)):
            elongation, kept = _coupling(gap_mode, b, w, 2.0 * gap_mode.damping, gap_mode.stiffness)
            gap, kept1 = _coupling(elongation_mode, beta, kappa, b, w)
            quality = separation * kept * kept1
            if quality > best_quality:
                best_quality, best = quality, Modes(gap_mode, elongation_mode, elongation, gap)
    elongation, gap = best.elongation, best.gap
    if apart(best.gap_mode):
        slow_rate, fast_rate = best.gap_mode.slow, best.gap_mode.fast
        elongation = Coupling(_gap_to_elongation(c, slow_rate), _gap_to_elongation(c, fast_rate))
    if apart(best.elongation_mode):
        slow_rate, fast_rate = best.elongation_mode.slow, best.elongation_mode.fast
        gap = Coupling(_elongation_to_gap(c, slow_rate), _elongation_to_gap(c, fast_rate))
    return Modes(best.gap_mode, best.elongation_mode, elongation, gap)


@inlined
def _coupled(coupling: Coupling, osc: Oscillator, a: float, b: float) -> tuple[float, float]:
    """The coordinates of the coupled quantity, those of the leading one being a and b."""
    if apart(osc):
        return coupling.first * a, coupling.second * b
    b1 = -2.0 * osc.damping * b - osc.stiffness * a
    return coupling.first * a + coupling.second * b, coupling.first * b + coupling.second * b1


@inlined
def _following(coupling: Coupling, osc: Oscillator, x: float, x1: float) -> tuple[float, float]:
    """The coupled quantity and its rate, the leading one being x with rate x1."""
    a, b = coordinates(osc, x, x1)
    a, b = _coupled(coupling, osc, a, b)
    return position(osc, a, b)


@jit
def _decoupling(f: Modes) -> tuple[float, float, float, float]:
    """The inverse of 1 - G E by rows, E being the gap mode's coupling as a matrix and G the other's."""
    q, q1 = _following(f.elongation, f.gap_mode, 1.0, 0.0)
    m00, m10 = _following(f.gap, f.elongation_mode, q, q1)
    q, q1 = _following(f.elongation, f.gap_mode, 0.0, 1.0)
    m01, m11 = _following(f.gap, f.elongation_mode, q, q1)
    m00, m01, m10, m11 = 1.0 - m00, -m01, -m10, 1.0 - m11
    det = m00 * m11 - m01 * m10
    return m11 / det, -m01 / det, -m10 / det, m00 / det


@inlined
def separate(s: SoftSpring, state: State) -> ModalState:
    """The modes of a free motion, without static and driven part, or of a small difference of two motions.

    gap = g + G h and q = h + E g, g and h being the leading coordinates and E and G the couplings. Solved
    for g = (1 - G E)^-1 (gap - G q) and h = q - E g, so that the small gap of the elongation mode is never a
    difference of large numbers.
    """
    gap, gap1, q, q1 = state
    coupled, coupled1 = _following(s.gap, s.elongation_mode, q, q1)
    left, left1 = gap - coupled, gap1 - coupled1
    m00, m01, m10, m11 = s.decoupling
    gap, gap1 = m00 * left + m01 * left1, m10 * left + m11 * left1
    coupled, coupled1 = _following(s.elongation, s.gap_mode, gap, gap1)
    gap_a, gap_b = coordinates(s.gap_mode, gap, gap1)
    elongation_a, elongation_b = coordinates(s.elongation_mode, q - coupled, q1 - coupled1)
    return ModalState(gap_a, gap_b, elongation_a, elongation_b)


@inlined
def combine(
    s: SoftSpring,
    m: ModalState,
    gap_over: tuple[float, float, float],
    elongation_over: tuple[float, float, float],
) -> State:
    """The state of a free motion after the time of both modes' propagators."""
    a, b = propagate(s.gap_mode, m.gap_a, m.gap_b, gap_over)
    gap, gap1 = position(s.gap_mode, a, b)
    a, b = _coupled(s.elongation, s.gap_mode, a, b)
    coupled_q, coupled_q1 = position(s.gap_mode, a, b)
    a, b = propagate(s.elongation_mode, m.elongation_a, m.elongation_b, elongation_over)
    q, q1 = position(s.elongation_mode, a, b)
    a, b = _coupled(s.gap, s.elongation_mode, a, b)
    coupled_gap, coupled_gap1 = position(s.elongation_mode, a, b)
    return State(gap + coupled_gap, gap1 + coupled_gap1, q + coupled_q, q1 + coupled_q1)


@inlined
def forced(s: SoftSpring, cos: float, sin: float, unit: float) -> State:
    """The static part times `unit`, and the driven part, (cos, sin) being the plate's motion."""
    return State(
        s.static_gap * unit + s.g_re * cos - s.g_im * sin,
        -(s.g_re * sin + s.g_im * cos),
        s.static_elongation * unit + s.q_re * cos - s.q_im * sin,
        -(s.q_re * sin + s.q_im * cos),
    )


@inlined
def modes_of(s: SoftSpring, phi: PlatePhase, state: State) -> ModalState:
    """The free modes of a state at phi: the motion without its static and driven parts."""
    gap, gap1, q, q1 = forced(s, phi.cos, phi.sin, 1.0)
    return separate(s, State(state.gap - gap, state.gap1 - gap1, state.q - q, state.q1 - q1))


@inlined
def state_of(
    s: SoftSpring, m: ModalState, phi: PlatePhase, gap_over: tuple[float, float, float],
    elongation_over: tuple[float, float, float],
) -> State:  # fmt: skip
    """The state at phi, from the modes `m` before and the propagators over the time since."""
    gap, gap1, q, q1 = forced(s, phi.cos, phi.sin, 1.0)
    free = combine(s, m, gap_over, elongation_over)
    return State(gap + free.gap, gap1 + free.gap1, q + free.q, q1 + free.q1)


@inlined
def gap_rings(s: SoftSpring) -> bool:
    """Whether the gap mode is the ringing part of the lift-off function: the stiffer of the two."""
    return s.gap_mode.stiffness >= s.elongation_mode.stiffness


@inlined
def liftoff_function(s: SoftSpring, m: ModalState, phi: float) -> LiftoffFunction:
    """The lift-off function from phi on."""
    f_a, f_b = _coupled(s.gap_lift, s.gap_mode, m.gap_a, m.gap_b)
    g_a, g_b = _coupled(s.elongation_lift, s.elongation_mode, m.elongation_a, m.elongation_b)
    rings = gap_rings(s)
    slow_a, slow_b, fast_a, fast_b = (g_a, g_b, f_a, f_b) if rings else (f_a, f_b, g_a, g_b)
    return LiftoffFunction(
        s.elongation_mode if rings else s.gap_mode,
        s.gap_mode if rings else s.elongation_mode,
        phi,
        static=s.static_lift,
        wave_re=s.wave_re,
        wave_im=s.wave_im,
        slow_a=slow_a,
        slow_b=slow_b,
        fast_a=fast_a,
        fast_b=fast_b,
    )


@terms.register(LiftoffFunction)
@inlined
def _liftoff_terms(p: LiftoffFunction, tau: float) -> Terms:
    """The static and driven parts and the slower mode are smooth, the faster mode rings."""
    sin, cos = sincos(p.phi + tau)
    a, b = advance(p.slow_osc, p.slow_a, p.slow_b, tau)
    slow = all_derivatives(p.slow_osc, a, b)
    a, b = advance(p.fast_osc, p.fast_a, p.fast_b, tau)
    return terms_of_parts(p, sin, cos, slow, all_derivatives(p.fast_osc, a, b))


@inlined
def terms_of_parts(p: LiftoffFunction, sin: float, cos: float, slow: Derivatives, fast: Derivatives) -> Terms:
    """The lift-off function's terms from its modes' parts and the sine and cosine of the plate's phase."""
    wave, wave1 = p.wave_re * cos - p.wave_im * sin, -(p.wave_re * sin + p.wave_im * cos)
    bound = abs(p.wave_re) + abs(p.wave_im)
    return Terms(
        smooth=p.static + wave + slow.x,
        smooth1=wave1 + slow.x1,
        smooth2=slow.x2 - wave,
        smooth3=slow.x3 - wave1,
        smooth4=slow.x4 + bound,
        ring=fast.x,
        ring1=fast.x1,
        ring2=fast.x2,
        ring3=fast.x3,
        ring4=fast.x4,
        amplitude=fast.size,
        noise=4.0 * EPS * (p.static + bound + slow.size + fast.size),
    )


# --- a time until which the mass surely stays ---------------------------------------------------------------
# An underdamped free oscillation x that rises is concave up to its maximum, then falls to its next zero, so
# that its values at two instants bound all between them. The smooth part is bounded by its Taylor polynomial.

#: The angle by which x is off a zero when the contact begins, up to which it stands for its arcus tangent.
SMALL_TILT: Final = 0.1
#: The angle before x's next zero, below which 1 - angle^2/6 is above 2/3.
MOST_TURNED: Final = 1.4


@jit
def sure_contact_time(p: LiftoffFunction, t: Terms) -> float:
    """A time (rad) until which the lift-off function surely stays positive; 0 where none is sure.

    `t`: its terms at the start of the contact, where it is not negative. The end is the next zero of the
    ringing part x, if the smooth part's lowest value until then is positive; else it is moved back to where
    x still outweighs that value.
    """
    osc, x, x1 = p.fast_osc, t.ring, t.ring1
    damping, root = osc.damping, osc.root
    if x + t.smooth < -t.noise or (x1 <= 0.0 and x <= 0.0) or (x < 0.0 <= t.ring2):
        return 0.0
    if apart(osc):  # x falls from the start, as a difference of two exponentials
        if not p.fast_a < 0.0 <= p.fast_a + p.fast_b:
            return 0.0
        end = log(-p.fast_b / p.fast_a) / (2.0 * root)
        fall, decay = -2.0 * root * p.fast_a, -osc.slow
    elif osc.discriminant < 0.0 and root > NEAR_CRITICAL * damping:
        # x = C exp(-damping tau) sin(root tau + tilt); C root sin(tilt) = swing, C root cos(tilt) = push
        push, swing = x1 + damping * x, root * x
        tilt = swing / push
        if abs(tilt) < SMALL_TILT and push > 0.0:  # pi - atan(tilt), or a little less
            angle = math.pi - tilt + min(tilt * tilt * tilt, 0.0) * (1.0 / 3.0)
        else:
            angle = atan2(swing, -push)
            angle += 0.0 if x >= 0.0 else TWO_PI
        end = angle / root
        fall, decay = math.sqrt(push * push + swing * swing), damping
    else:
        return 0.0
    slope = abs(t.smooth1) + end * (
        abs(t.smooth2) * 0.5 + end * (abs(t.smooth3) * (1.0 / 6.0) + end * t.smooth4 * (1.0 / 24.0))
    )
    lowest = t.smooth - end * slope - t.noise  # of the smooth part until `end`
    if lowest > 0.0 and (x >= 0.0 or -x > end * slope):
        return end  # x is positive, or outgrows the smooth part's decrease before it is
    rising = 0.0
    if x1 > 0.0:
        # before the maximum, since atan(u) >= u/(1 + 2 u/pi); there x is at least its Taylor polynomial
        rising = 1.0 / (max(damping + osc.stiffness * x / x1, 0.0) + (2.0 / math.pi) * root)
        gain = 0.5 * t.ring2 + rising * (t.ring3 * (1.0 / 6.0) - rising * t.ring4 * (1.0 / 24.0))
        gain = rising * (x1 + rising * gain)
        if rising >= end or x + gain <= -lowest or gain <= rising * slope:
            return 0.0
    if lowest > 0.0:
        return end
    # s before its zero x is at least fall s (1 - (root s)^2/6), of which more than half is left
    back = -2.0 * lowest / (fall * exp(-decay * end))
    return end - back if root * back < MOST_TURNED and end - back > rising else 0.0
