"""The free damped oscillator x'' + 2 a x' + w x = 0, without cancellation at any damping.

Its solution is x = x0 C + v0 S and x' = -w S x0 + S' v0, with C and S of docs/model.md, section 3. Every
derivative of x obeys the same equation, which gives n'', gap''' and so on without differencing. Times are
in rad of the plate's phase, rates in 1/rad.

An overdamped motion may also be carried by its *coordinates*, the amplitudes of its slow and its fast
exponential: x = a + b and x' = slow a + fast b. With damping ratio zeta, x0 C and v0 S cancel up to a part
1/(2 zeta)**4 in the force of a contact; the amplitudes never do. Where the roots are not apart, the
coordinates are x and x' themselves.
"""

import math
from typing import Final, NamedTuple

from kernel.numerics.elementary import LOWEST_EXPONENT, exp, expm1, sincos
from kernel.numerics.jit import inlined, jit
from kernel.portable_math import log

#: Overdamped, C and S are differences of two exponentials over sqrt(D). Above this ratio of sqrt(D) to a
#: that form loses at most a factor a/sqrt(D) = 10 of the precision, one digit. Below it they are written
#: with expm1(x)/x, which is continuous through D = 0.
NEAR_CRITICAL: Final = 0.1

#: `displacement` sums its power series to order SHORT_ORDER for tau * rate below SHORT. No root of the
#: motion is larger than `rate`, so that the first omitted term is of the order 0.5**16/16! = 7e-19.
SHORT: Final = 0.5
SHORT_ORDER: Final = 15


class Oscillator(NamedTuple):
    """The constants of one oscillator, computed once for each cell."""

    damping: float  # a, 1/rad
    stiffness: float  # w > 0, 1/rad**2
    discriminant: float  # D = a**2 - w
    root: float  # sqrt(|D|)
    inverse: float  # 1/root
    slow: float  # where D >= 0, the slow root -w/(a + sqrt(D)), without cancellation
    fast: float  # where D >= 0, the fast root -(a + sqrt(D))
    rate: float  # about the fastest rate of the motion, 1/rad: max(2 a, sqrt(w))


@jit
def oscillator(damping: float, stiffness: float) -> Oscillator:
    """The constants for a = damping >= 0 and w = stiffness > 0."""
    discriminant = damping * damping - stiffness
    root = math.sqrt(abs(discriminant))
    fast = -(damping + root)
    rate = max(2.0 * damping, math.sqrt(stiffness))
    return Oscillator(damping, stiffness, discriminant, root, 1.0 / root, stiffness / fast, fast, rate)


@inlined
def apart(osc: Oscillator) -> bool:
    """Whether both roots are real and far apart, so that the coordinates are two amplitudes."""
    return osc.discriminant > 0.0 and osc.root > NEAR_CRITICAL * osc.damping


@inlined
def response(osc: Oscillator, tau: float) -> tuple[float, float, float]:
    """C(tau), S(tau) and S'(tau) of docs/model.md, section 3; tau >= 0 in rad. C' = -w S."""
    if tau == 0.0:
        return 1.0, 0.0, 1.0
    if osc.discriminant < 0.0:
        decay = exp(-osc.damping * tau)
        # once nothing is left of the motion, its phase does not matter; for large ones `sincos` is slow
        sin, cos = sincos(osc.root * tau if osc.damping * tau < -LOWEST_EXPONENT else 0.0)
        cosine = decay * cos
        sine = decay * sin * osc.inverse
        return cosine + osc.damping * sine, sine, cosine - osc.damping * sine
    slow = exp(osc.slow * tau)
    spread = 2.0 * osc.root * tau
    if apart(osc):
        ratio = exp(-spread)  # of the fast exponential to the slow one
        scale = slow / (2.0 * osc.root)
        sine = -scale * expm1(-spread)
        return scale * (osc.slow * ratio - osc.fast), sine, scale * (osc.slow - osc.fast * ratio)
    sine = slow * tau if spread == 0.0 else -slow * tau * expm1(-spread) / spread
    return slow - osc.slow * sine, sine, slow + osc.fast * sine


@inlined
def motion(osc: Oscillator, x0: float, v0: float, tau: float) -> tuple[float, float]:
    """x and x' at tau >= 0 (rad) from x = x0 and x' = v0 at zero."""
    cosine, sine, sine1 = response(osc, tau)
    return x0 * cosine + v0 * sine, v0 * sine1 - osc.stiffness * sine * x0


@inlined
def derivatives(osc: Oscillator, x: float, v: float) -> tuple[float, float, float]:
    """x'', x''' and a bound on |x''''| from now on, with x and v = x' now.

    The energy of the third derivative bounds the fourth. Overdamped, so does the sum of the two
    exponentials' amplitudes, which is tighter once the fast one has decayed.
    """
    x2 = -2.0 * osc.damping * v - osc.stiffness * x
    x3 = -2.0 * osc.damping * x2 - osc.stiffness * v
    x4 = -2.0 * osc.damping * x3 - osc.stiffness * x2
    bound = math.sqrt(x4 * x4 + osc.stiffness * x3 * x3)
    if osc.discriminant > 0.0:
        roots = abs(osc.slow * (x4 - osc.fast * x3)) + abs(osc.fast * (osc.slow * x3 - x4))
        bound = min(bound, 0.5 * roots * osc.inverse)
    return x2, x3, bound


@inlined
def envelope(osc: Oscillator, x: float, v: float) -> float:
    """A bound on |x| from now on: the energy v**2 + w x**2 never grows."""
    return math.sqrt(x * x + v * v / osc.stiffness)


@jit
def decay_time(osc: Oscillator, x: float, v: float, level: float) -> float:
    """Rad after which |x| surely stays below `level`; infinite if level <= 0 or nothing is damped."""
    if level <= 0.0:
        return math.inf
    if envelope(osc, x, v) < level:
        return 0.0
    if osc.discriminant < 0.0:
        push = (v + osc.damping * x) / osc.root
        amplitude, rate = math.sqrt(x * x + push * push), osc.damping
    else:
        amplitude, rate = (abs(v - osc.fast * x) + abs(v - osc.slow * x)) / (2.0 * osc.root), -osc.slow
    if not (amplitude < math.inf and rate > 0.0):
        return math.inf
    return max(log(amplitude / level), 0.0) / rate


@jit
def displacement(osc: Oscillator, x0: float, v0: float, tau: float) -> float:
    """x(tau) - x0 by its power series, which keeps their digits, for tau * rate < SHORT."""
    before, last = x0, v0
    power = tau
    total = v0 * tau
    for order in range(2, SHORT_ORDER + 1):
        before, last = last, -2.0 * osc.damping * last - osc.stiffness * before
        power *= tau / order
        total += last * power
    return total


# --- in coordinates -------------------------------------------------------------------------


class Derivatives(NamedTuple):
    """A free motion at one instant, and bounds from then on."""

    x: float
    x1: float
    x2: float
    x3: float
    x4: float  # bound on |x''''|
    size: float  # bound on |x| and on the terms of its sum


@inlined
def coordinates(osc: Oscillator, x: float, v: float) -> tuple[float, float]:
    """The coordinates of the motion with this x and v = x'."""
    if apart(osc):
        half = 0.5 * osc.inverse
        return half * (v - osc.fast * x), half * (osc.slow * x - v)
    return x, v


@inlined
def position(osc: Oscillator, a: float, b: float) -> tuple[float, float]:
    """x and x' of the motion with these coordinates."""
    return (a + b, osc.slow * a + osc.fast * b) if apart(osc) else (a, b)


@inlined
def propagator(osc: Oscillator, tau: float) -> tuple[float, float, float]:
    """What `propagate` needs for tau >= 0 rad: one serves all motions of an oscillator."""
    if apart(osc):
        if tau == 0.0:
            return 1.0, 1.0, 0.0
        return exp(osc.slow * tau), exp(osc.fast * tau), 0.0
    return response(osc, tau)


@inlined
def propagate(osc: Oscillator, a: float, b: float, over: tuple[float, float, float]) -> tuple[float, float]:
    """The coordinates after the time of the propagator `over`."""
    if apart(osc):
        return a * over[0], b * over[1]
    cosine, sine, sine1 = over
    return a * cosine + b * sine, b * sine1 - osc.stiffness * sine * a


@jit
def advance(osc: Oscillator, a: float, b: float, tau: float) -> tuple[float, float]:
    """The coordinates tau >= 0 rad later."""
    return propagate(osc, a, b, propagator(osc, tau))


@jit
def all_derivatives(osc: Oscillator, a: float, b: float) -> Derivatives:
    """x and its derivatives from its coordinates."""
    if apart(osc):
        a1, b1 = osc.slow * a, osc.fast * b
        a2, b2 = osc.slow * a1, osc.fast * b1
        a3, b3 = osc.slow * a2, osc.fast * b2
        bound = abs(osc.slow * a3) + abs(osc.fast * b3)
        return Derivatives(a + b, a1 + b1, a2 + b2, a3 + b3, bound, abs(a) + abs(b))
    x2, x3, bound = derivatives(osc, a, b)
    return Derivatives(a, b, x2, x3, bound, envelope(osc, a, b))


@jit
def quiet_time(osc: Oscillator, a: float, b: float, level: float) -> float:
    """`decay_time` from the coordinates."""
    if not apart(osc):
        return decay_time(osc, a, b, level)
    if level <= 0.0:
        return math.inf
    slow, fast = 2.0 * abs(a) / level, 2.0 * abs(b) / level  # each below half of the level
    if not (slow < math.inf and fast < math.inf):
        return math.inf
    return max(log(max(slow, 1.0)) / -osc.slow, log(max(fast, 1.0)) / -osc.fast)
