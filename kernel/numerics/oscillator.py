"""The free damped oscillator x'' + 2 a x' + w x = 0, safe at every damping.

Its solution is x = x0 C + v0 S and x' = -w S x0 + S' v0. Every derivative of x
obeys the same equation, which gives n'', gap''' and so on without differencing.
"""

import math
from typing import Final, NamedTuple

from kernel.numerics.elementary import exp, turned
from kernel.numerics.jit import inlined, jit

TWO_PI: Final = 2.0 * math.pi

#: Below this ratio of sqrt(D) to a the overdamped formulas give way to ones continuous through D = 0.
NEAR_CRITICAL: Final = 0.1

#: The power series below is used for tau * rate under this; its sixteenth term is then under 1e-17.
SHORT: Final = 0.5


class Oscillator(NamedTuple):
    """The constants of one oscillator, worked out once a cell."""

    damping: float  # a, 1/rad
    stiffness: float  # w > 0, 1/rad**2
    discriminant: float  # D = a**2 - w
    root: float  # sqrt(|D|)
    slow: float  # where D >= 0, the slow root -w/(a + sqrt(D)), without cancellation
    fast: float  # where D >= 0, the fast root -(a + sqrt(D))
    rate: float  # the fastest rate in it, 1/rad


@jit
def oscillator(damping: float, stiffness: float) -> Oscillator:
    """The constants for a = damping >= 0 and w = stiffness > 0."""
    discriminant = damping * damping - stiffness
    root = math.sqrt(abs(discriminant))
    fast = -(damping + root)
    rate = max(2.0 * damping, math.sqrt(stiffness))
    return Oscillator(damping, stiffness, discriminant, root, stiffness / fast, fast, rate)


@jit
def response(osc: Oscillator, tau: float) -> tuple[float, float, float]:
    """C(tau), S(tau) and S'(tau) of MODEL section 3; tau >= 0 in rad.

    C(0) = 1, C'(0) = 0, S(0) = 0, S'(0) = 1 and C' = -w S.
    """
    if tau == 0.0:
        return 1.0, 0.0, 1.0
    if osc.discriminant < 0.0:
        decay = exp(-osc.damping * tau)
        turn, turn1 = turned(osc.root * tau)
        cosine = decay * turn1
        sine = decay * turn / osc.root
        return cosine + osc.damping * sine, sine, cosine - osc.damping * sine
    slow = exp(osc.slow * tau)
    spread = 2.0 * osc.root * tau
    if osc.root > NEAR_CRITICAL * osc.damping:
        lost = exp(-spread)
        scale = slow / (2.0 * osc.root)
        sine = -scale * math.expm1(-spread)
        return scale * (osc.slow * lost - osc.fast), sine, scale * (osc.slow - osc.fast * lost)
    sine = slow * tau if spread == 0.0 else -slow * tau * math.expm1(-spread) / spread
    return slow - osc.slow * sine, sine, slow + osc.fast * sine


@jit
def motion(osc: Oscillator, x0: float, v0: float, tau: float) -> tuple[float, float]:
    """x and x' at tau from x0 and v0 at zero."""
    cosine, sine, sine1 = response(osc, tau)
    return x0 * cosine + v0 * sine, v0 * sine1 - osc.stiffness * sine * x0


@inlined
def derivatives(osc: Oscillator, x: float, v: float) -> tuple[float, float, float]:
    """Second and third derivative, and a bound on the fourth from now on.

    The energy of the third bounds it. So, overdamped, does the sum of what the two roots
    contribute, which is tighter once the fast one has died away.
    """
    x2 = -2.0 * osc.damping * v - osc.stiffness * x
    x3 = -2.0 * osc.damping * x2 - osc.stiffness * v
    x4 = -2.0 * osc.damping * x3 - osc.stiffness * x2
    bound = math.sqrt(x4 * x4 + osc.stiffness * x3 * x3)
    if osc.discriminant > 0.0:
        roots = abs(osc.slow * (x4 - osc.fast * x3)) + abs(osc.fast * (osc.slow * x3 - x4))
        bound = min(bound, roots / (2.0 * osc.root))
    return x2, x3, bound


@inlined
def envelope(osc: Oscillator, x: float, v: float) -> float:
    """A bound on |x| from now on: the energy v**2 + w x**2 never grows."""
    return math.sqrt(x * x + v * v / osc.stiffness)


@jit
def quiet_after(osc: Oscillator, x: float, v: float, level: float) -> float:
    """A time after which |x| surely stays below `level`; infinite where that is never sure."""
    if level <= 0.0:
        return math.inf
    if envelope(osc, x, v) < level:
        return 0.0
    if osc.discriminant < 0.0:
        size, rate = math.hypot(x, (v + osc.damping * x) / osc.root), osc.damping
    else:
        size, rate = (abs(v - osc.fast * x) + abs(v - osc.slow * x)) / (2.0 * osc.root), -osc.slow
    return max(math.log(size / level), 0.0) / rate if size < math.inf and rate > 0.0 else math.inf


@jit
def falling_zero(osc: Oscillator, x: float, v: float) -> float:
    """When a motion from x >= 0, or from below and rising, first falls to zero; infinite if never."""
    push = v + osc.damping * x
    if osc.discriminant < 0.0:
        turn = math.atan2(x, -push / osc.root)
        return (turn if x >= 0.0 else turn + TWO_PI) / osc.root
    if x < 0.0 or push >= 0.0:
        return math.inf
    if osc.root == 0.0:
        return -x / push
    lean = -x * osc.root / push
    return math.atanh(lean) / osc.root if lean < 1.0 else math.inf


@jit
def displacement(osc: Oscillator, x0: float, v0: float, tau: float) -> float:
    """x(tau) - x0 for tau * rate < SHORT by its power series, which keeps the digits x0 C - x0 loses."""
    before, last = x0, v0
    power = tau
    total = v0 * tau
    for order in range(2, 16):
        before, last = last, -2.0 * osc.damping * last - osc.stiffness * before
        power *= tau / order
        total += last * power
    return total
