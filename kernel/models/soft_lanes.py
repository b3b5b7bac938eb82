"""The contacts and flights of `soft` in lanes: searches whose phase function has two free modes.

The phase function is that of `kernel.models.lanes`, with two oscillators instead of one:

    F(tau) = k0 + k1 tau - k2 tau^2 + a cos(phi + tau) + b sin(phi + tau) + x + y

In contact it is the lift-off function (`soft_contact.LiftoffFunction`), x being the slow and y the fast mode;
in flight the gap, x being zero and y the elongation's part. Each mode is carried by two coordinates, in which
the underdamped and the overdamped motion have one form,

    u = e^(g tau) (u0 cos(r tau) + v0 sin(r tau))      u' = g u + r v
    v = e^(h tau) (v0 cos(r tau) - u0 sin(r tau))      v' = h v - r u

Underdamped, g = h = -damping, r is the frequency and the mode is u; overdamped, g and h are the slow and the
fast root, r = 0 and the mode is u + v, whose two amplitudes never cancel (`kernel.numerics.oscillator`). Any
derivative of it is bounded from now on by |u| + |v| of that derivative.
"""

import math
from typing import Any, Final

from kernel.cell import Progress
from kernel.interface import advance_lanes, load_lane, unload_lane
from kernel.models.flight import begin_flight, state_after
from kernel.models.lanes import (
    AT_ROOT,
    CLOSING,
    COUNT,
    FIRST_WIDTH,
    GROW,
    GUESS,
    HORIZON,
    K0,
    K1,
    K2,
    KEEP,
    MOVE,
    NOISE,
    PHI,
    SHORT_FLIGHT,
    SHORT_START,
    STATUS,
    TAU,
    A,
    B,
    move_on,
    safe_step_once,
    smooth_coefficients,
    supports,
)
from kernel.models.soft import SoftPlate, begin_contact, emergence_bound
from kernel.models.soft_contact import ModalState, SoftSpring, state_of
from kernel.numerics import first_root
from kernel.numerics.elementary import LOWEST_EXPONENT, exp, sincos, sincos_small
from kernel.numerics.first_root import EPS, NEAR, Phase, Terms, departure_step
from kernel.numerics.intrinsics import fma
from kernel.numerics.jit import inlined, jit
from kernel.numerics.oscillator import NEAR_CRITICAL, Oscillator, coordinates, derivatives, motion
from kernel.params import LANES

#: rad up to which `sincos_small` keeps its accuracy; a mode's angle must stay below, ...
LARGEST_ANGLE: Final = 1e5

#: ... until the mode has decayed by exp of this, to nothing.
GONE: Final = -LOWEST_EXPONENT

#: A contact that begins with a force of zero is searched from where that is above so many times its rounding.
RISEN: Final = 16.0

# Rows of the table, in place of those of one oscillator in `lanes`. For each mode: g, h and r, its
# coordinates at tau = 0, and the part of v in it, 1 or 0. The width of the next step over the smooth part.
# The free modes at tau = 0.
(X_G, X_H, X_R, X_U, X_V, X_SUM) = range(16, 22)
(Y_G, Y_H, Y_R, Y_U, Y_V, Y_SUM) = range(22, 28)
WIDE: Final = 28
(GAP_A, GAP_B, ELONGATION_A, ELONGATION_B) = range(29, 33)


@inlined
def _load_mode(table: Any, k: int, first: int, osc: Oscillator, a: float, b: float) -> None:
    """Put a mode with these coordinates (`oscillator.coordinates`) into the six rows from `first`."""
    under = osc.discriminant < 0.0
    table[first * LANES + k] = -osc.damping if under else osc.slow
    table[(first + 1) * LANES + k] = -osc.damping if under else osc.fast
    table[(first + 2) * LANES + k] = osc.root if under else 0.0
    table[(first + 3) * LANES + k] = a
    table[(first + 4) * LANES + k] = (b + osc.damping * a) / osc.root if under else b
    table[(first + 5) * LANES + k] = 0.0 if under else 1.0


@inlined
def _serves(osc: Oscillator, end: float) -> bool:
    """Whether lanes can compute this mode up to `end` rad: not near critical damping, nor over many turns."""
    if not osc.root > NEAR_CRITICAL * osc.damping:
        return False
    return osc.discriminant > 0.0 or osc.root * min(end, GONE / osc.damping) < LARGEST_ANGLE


@inlined
def _load_search(table: Any, k: int, phi: float, start: float, horizon: float, guess: float) -> None:
    """Begin a search in lane k, of which the coefficients and modes are loaded."""
    table[PHI * LANES + k] = phi
    table[HORIZON * LANES + k] = horizon
    table[TAU * LANES + k] = min(start, horizon)
    table[GUESS * LANES + k] = guess
    table[WIDE * LANES + k] = FIRST_WIDTH
    table[CLOSING * LANES + k] = 0.0
    table[COUNT * LANES + k] = 0.0


@jit
def _rising_time(t: Terms) -> float:
    """A time (rad) at which F, zero to rounding in `t`, has surely risen clearly above; 0 if it may not."""
    f1, f2, f3, f4 = t.smooth1 + t.ring1, t.smooth2 + t.ring2, t.smooth3 + t.ring3, t.smooth4 + t.ring4
    width = 2.0 * max(abs(f3), math.sqrt(abs(f2) * f4)) / f4
    if not (f1 > 0.0 and width > 0.0):
        return 0.0
    # F is above a parabola from zero to zero, half-way at f1 time / 2
    time = 0.5 * safe_step_once(0.0, f1, f2, f3, f4, width)
    return time if 0.5 * f1 * time > RISEN * t.noise else 0.0


@jit
def _load_contact(
    s: SoftSpring, table: Any, k: int, run: Progress, sin: float, cos: float, horizon: float
) -> bool:
    """Put a contact into lane k, unless it never ends or might end at once."""
    m, p, t, start, decayed = begin_contact(s, run.phase, sin, cos, run.gap, run.gap1, run.q, run.q1)
    end = min(horizon, decayed)
    f0 = t.smooth + t.ring
    if start == 0.0 and abs(f0) <= 4.0 * t.noise:
        start = _rising_time(t)
    at_once = start == 0.0 and f0 <= 4.0 * t.noise
    if at_once or decayed == 0.0 or not (_serves(p.slow_osc, end) and _serves(p.fast_osc, end)):
        return False
    _load_mode(table, k, X_G, p.slow_osc, p.slow_a, p.slow_b)
    _load_mode(table, k, Y_G, p.fast_osc, p.fast_a, p.fast_b)
    smooth_coefficients(table, k, p.static, 0.0, 0.0, p.wave_re, -p.wave_im, 0.0)
    _load_search(table, k, run.phase, start, end, 0.0)
    table[GAP_A * LANES + k] = m.gap_a
    table[GAP_B * LANES + k] = m.gap_b
    table[ELONGATION_A * LANES + k] = m.elongation_a
    table[ELONGATION_B * LANES + k] = m.elongation_b
    return True


@jit
def _load_flight(
    s: SoftSpring, table: Any, k: int, run: Progress, sin: float, cos: float, horizon: float
) -> bool:
    """Put a flight into lane k, unless it begins with a short hop or too close to the surface.

    One that begins below the surface is searched from where it surely has emerged, if it cannot return to
    contact before.
    """
    if not (supports(s.flight) and _serves(s.flight, horizon)):
        return False
    emerged, sin0, cos0 = 0.0, sin, cos
    gap, gap1, q, q1 = run.gap, run.gap1, run.q, run.q1
    if gap < 0.0:
        p = begin_flight(s.flight, s.gravity, run.phase, gap, gap1, q, q1)
        emerged = emergence_bound(s, p)
        if emerged == 0.0 or emerged >= horizon:
            return False
        gap, gap1, q, q1 = state_after(p, emerged)
        sin, cos = sincos(run.phase + emerged)
    start = emerged
    if emerged > 0.0 or gap == 0.0:
        q2, q3, q4 = derivatives(s.flight, q, q1)
        gap2 = cos - s.gravity - 0.5 * q2
        if gap1 >= 0.0 and (gap2 >= 0.0 or gap1 == 0.0):
            safe = departure_step(max(gap2, 0.0), -sin - 0.5 * q3, 1.0 + 0.5 * q4)
            if safe < SHORT_START:
                return False
            start += safe
        elif 2.0 * gap1 < -gap2 * SHORT_FLIGHT:
            return False
    _load_mode(table, k, X_G, s.flight, 0.0, 0.0)
    a, b = coordinates(s.flight, -0.5 * run.q, -0.5 * run.q1)
    _load_mode(table, k, Y_G, s.flight, a, b)
    smooth_coefficients(
        table, k, run.gap + (cos0 + 0.5 * run.q), run.gap1 + (0.5 * run.q1 - sin0), 0.5 * s.gravity,
        -1.0, 0.0, 0.5 * abs(run.q),
    )  # fmt: skip
    _load_search(table, k, run.phase, start, horizon, FIRST_WIDTH)
    return True


@load_lane.register(SoftSpring)
@inlined
def _load(s: SoftSpring, table: Any, k: int, run: Progress, sin: float, cos: float, horizon: float) -> bool:
    """Put the run's next phase into lane k."""
    if run.in_flight:
        return _load_flight(s, table, k, run, sin, cos, horizon)
    return _load_contact(s, table, k, run, sin, cos, horizon)


@unload_lane.register(SoftSpring)
@jit
def _unload(s: SoftSpring, table: Any, k: int, run: Progress) -> tuple[Phase, float, float]:
    """The phase that ended in lane k, with sin and cos of the plate's phase at its end."""
    tau, ending = table[TAU * LANES + k] + table[MOVE * LANES + k], first_root.HORIZON
    if table[STATUS * LANES + k] == AT_ROOT:
        ending = first_root.ROOT
    used = int(table[COUNT * LANES + k])
    sin, cos = sincos(run.phase + tau)
    if run.in_flight:
        q, q1 = motion(s.flight, run.q, run.q1, tau)
        drift = table[K1 * LANES + k]
        gap1 = sin + drift - s.gravity * tau - 0.5 * q1
        if ending == first_root.ROOT:
            gap, gap1 = 0.0, min(gap1, 0.0)
        else:
            gap = table[K0 * LANES + k] - cos + (drift - 0.5 * s.gravity * tau) * tau - 0.5 * q
        return Phase(tau, ending, ending != first_root.ROOT, gap, gap1, q, q1, used), sin, cos
    m = ModalState(
        table[GAP_A * LANES + k], table[GAP_B * LANES + k], table[ELONGATION_A * LANES + k],
        table[ELONGATION_B * LANES + k],
    )  # fmt: skip
    gap, gap1, q, q1 = state_of(s, m, sin, cos, tau)
    if s.adhesive:
        gap, gap1 = 0.0, max(gap1, 0.0)
    return Phase(tau, ending, True, gap, gap1, q, q1, used), sin, cos


@inlined
def _mode_at(table: Any, k: int, first: int, tau: float) -> tuple[float, float]:
    """The coordinates u and v of a mode at tau."""
    g, h = table[first * LANES + k], table[(first + 1) * LANES + k]
    sin, cos = sincos_small(table[(first + 2) * LANES + k] * tau)
    u, v = table[(first + 3) * LANES + k], table[(first + 4) * LANES + k]
    return exp(g * tau) * fma(u, cos, v * sin), exp(h * tau) * fma(v, cos, -u * sin)


@inlined
def _mode_derivative(table: Any, k: int, first: int, u: float, v: float) -> tuple[float, float]:
    """The coordinates of the derivative of the mode with coordinates u and v."""
    g, h, r = table[first * LANES + k], table[(first + 1) * LANES + k], table[(first + 2) * LANES + k]
    return fma(g, u, r * v), fma(h, v, -r * u)


@advance_lanes.register(SoftPlate)
@jit
def _advance(plate: SoftPlate, table: Any, used: int) -> None:
    """As `lanes.advance`, with two modes."""
    for k in range(used):
        tau = table[TAU * LANES + k]
        sin, cos = sincos_small(table[PHI * LANES + k] + tau)
        x_sum, y_sum = table[X_SUM * LANES + k], table[Y_SUM * LANES + k]
        u0, v0 = _mode_at(table, k, X_G, tau)
        u1, v1 = _mode_derivative(table, k, X_G, u0, v0)
        u2, v2 = _mode_derivative(table, k, X_G, u1, v1)
        u3, v3 = _mode_derivative(table, k, X_G, u2, v2)
        u4, v4 = _mode_derivative(table, k, X_G, u3, v3)
        a, b = table[A * LANES + k], table[B * LANES + k]
        k0, k1, k2 = table[K0 * LANES + k], table[K1 * LANES + k], table[K2 * LANES + k]
        wave, wave1 = fma(a, cos, b * sin), fma(b, cos, -a * sin)
        smooth = fma(fma(-k2, tau, k1), tau, k0) + wave + fma(x_sum, v0, u0)
        smooth1 = fma(-2.0 * k2, tau, k1) + wave1 + fma(x_sum, v1, u1)
        smooth2 = fma(-2.0, k2, -wave) + fma(x_sum, v2, u2)
        smooth3 = fma(x_sum, v3, u3) - wave1
        smooth4 = abs(a) + abs(b) + abs(u4) + abs(v4)
        size = abs(u0) + abs(v0)
        u0, v0 = _mode_at(table, k, Y_G, tau)
        u1, v1 = _mode_derivative(table, k, Y_G, u0, v0)
        u2, v2 = _mode_derivative(table, k, Y_G, u1, v1)
        u3, v3 = _mode_derivative(table, k, Y_G, u2, v2)
        u4, v4 = _mode_derivative(table, k, Y_G, u3, v3)
        f0, f1 = smooth + fma(y_sum, v0, u0), smooth1 + fma(y_sum, v1, u1)
        f2, f3 = smooth2 + fma(y_sum, v2, u2), smooth3 + fma(y_sum, v3, u3)
        f4 = smooth4 + (abs(u4) + abs(v4))
        amplitude = abs(u0) + abs(v0)
        clear = smooth - amplitude
        drift = fma(2.0 * EPS * tau, fma(k2, tau, abs(k1)), table[NOISE * LANES + k])
        noise = fma(4.0 * EPS, size + amplitude, drift)
        # about the time over which F changes its shape, as in first_root
        natural = 2.0 * max(abs(f3), math.sqrt(abs(f2) * f4)) / f4
        guess = table[GUESS * LANES + k]
        guess = guess if guess > 0.0 else natural
        wide = table[WIDE * LANES + k]
        over = safe_step_once(max(clear, 0.0), smooth1, smooth2, smooth3, smooth4, wide)
        inverse = 1.0 / f1
        newton = abs(-f0 * inverse)
        near = (newton < NEAR) & (newton * newton * newton * f4 * abs(inverse) < NEAR * NEAR * NEAR)
        step = move_on(table, k, tau, guess, f0, f1, f2, f3, f4, over if clear > 0.0 else 0.0, noise, near)
        table[GUESS * LANES + k] = (GROW if step >= guess else KEEP) * step
        table[WIDE * LANES + k] = (GROW if over >= wide else KEEP) * over if clear > 0.0 else wide
