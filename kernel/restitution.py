"""Isolated impacts on the spring-dashpot contact: duration, restitution and damping ratio; no numba.

An isolated impact is gap'' + 2 zeta gap' + gap = 0 from gap = 0, gap' = -1, one unit of time being d rad.
The adhesive contact ends where the gap is zero again, the nonadhesive one where the force is
(docs/model.md, section 2):

    adhesive     duration pi/sqrt(1 - zeta^2), zeta < 1                       (Eq. 11)
    nonadhesive  duration 2 arccos(zeta)/sqrt(1 - zeta^2), zeta < 1
                 duration 2 arccosh(zeta)/sqrt(zeta^2 - 1), zeta > 1
    both         e = exp(-zeta duration)                                      (Eq. 12)

The nonadhesive duration is 2 R_C(zeta^2, 1) at any zeta, R_C being Carlson's elementary integral, which needs
sqrt and the four operations only. So does the logarithm, so that the damping ratio has the same digits on
every machine. Each formula is written once, for one number: array functions apply it to every element, and
`soft` compiles it.
"""

import math
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: The smallest restitution an impact is computed for. A nonadhesive contact reaches e = 0 only at
#: infinite damping, and an adhesive one lasts for ever there; below this the contact is that of this e,
#: whose rebound is below the rounding of anything that follows it.
SMALLEST: Final = 1e-12

#: `_carlson` sums its series for |s| below this. The first omitted term is below 16 s**8 = 6e-18.
_SERIES: Final = 0.005

#: 1 - zeta**2 below this counts as zero in the slope of zeta * duration, whose quotient is 0/0 at zeta = 1;
#: the slope is then off by 1e-4 of itself, which costs Newton's method nothing.
_CRITICAL: Final = 1e-4

#: Relative size of Newton's step after which the next one, its square, is below rounding.
_CONVERGED: Final = 1e-9

#: Cap on Newton's steps; at most 7 are taken.
_NEWTON_STEPS: Final = 20

#: ln 2 in two parts, the first of 32 bits, so that its product with a whole number below 2**21 is exact.
_ONE_OVER_LN2: Final = 1.4426950408889634
_LN2_1: Final = 0.6931471803691238
_LN2_2: Final = 1.9082149292705877e-10

#: Order to which `_exp` sums its power series: 0.35**14/14! = 5e-18.
_EXP_ORDER: Final = 13

#: exp of anything below this is less than the smallest number.
_LOWEST_EXPONENT: Final = -745.0

_Array = NDArray[np.float64]


# --- one number -----------------------------------------------------------------------------


def carlson(x: float, y: float) -> float:
    """R_C(x, y) for x >= 0 and y > 0, by duplication (Carlson 1995, sections 1 and 2)."""
    while True:
        mean = (x + 2.0 * y) / 3.0
        s = (y - mean) / mean
        if not abs(s) >= _SERIES:  # a number that is none ends it too
            break
        shift = y + 2.0 * math.sqrt(x) * math.sqrt(y)
        x, y = 0.25 * (x + shift), 0.25 * (y + shift)
    odd = 1.0 / 7.0 + s * s * (9.0 / 22.0 + s * s * (9.0 / 8.0))
    even = 3.0 / 10.0 + s * s * (3.0 / 8.0 + s * s * (159.0 / 208.0))
    return (1.0 + s * s * (even + s * odd)) / math.sqrt(mean)


def minus_log(x: float) -> float:
    """-ln x >= 0 for 0 < x <= 1."""
    half = 0.5 * (1.0 + x)
    return (1.0 - x) * carlson(half * half, x)


def scalar_damping_ratio(e: float, adhesive: bool) -> float:
    """The damping ratio zeta that gives restitution e in [0, 1].

    Adhesive e = 0 is critical damping, zeta = 1. Nonadhesive e below SMALLEST is taken as SMALLEST.
    """
    if adhesive:
        if e == 0.0:
            return 1.0
        log = minus_log(e)
        return log / math.sqrt(math.pi * math.pi + log * log)
    e = max(e, SMALLEST)
    log = minus_log(e)
    # zeta * duration = log is concave, so that Newton's method from below never overshoots; for strong
    # damping, where it is 2 ln(2 zeta), the first step comes from above and ends just below
    zeta = log / math.pi if log < 2.0 else 0.5 / math.sqrt(e)
    for _ in range(_NEWTON_STEPS):
        half = carlson(zeta * zeta, 1.0)
        square = (1.0 - zeta) * (1.0 + zeta)
        slope = 2.0 * (half - zeta) / square if abs(square) > _CRITICAL else 4.0 / 3.0
        step = (log - 2.0 * zeta * half) / slope
        zeta += step
        if abs(step) <= _CONVERGED * zeta:
            break
    return zeta


def _exp(x: float) -> float:
    """The exponential of x <= 0."""
    if x < _LOWEST_EXPONENT:
        return 0.0
    k = math.floor(x * _ONE_OVER_LN2 + 0.5)
    r = (x - k * _LN2_1) - k * _LN2_2
    total = 1.0
    for order in range(_EXP_ORDER, 0, -1):
        total = 1.0 + total * r / order
    return math.ldexp(total, k)


def _duration(zeta: float, adhesive: bool) -> float:
    if not adhesive:
        return 2.0 * carlson(zeta * zeta, 1.0)
    return math.pi / math.sqrt((1.0 - zeta) * (1.0 + zeta)) if zeta < 1.0 else math.inf


def _restitution(zeta: float, adhesive: bool) -> float:
    return _exp(-zeta * _duration(zeta, adhesive)) if zeta > 0.0 else 1.0


# --- arrays ---------------------------------------------------------------------------------


def _each(formula: Callable[[float, bool], float], values: ArrayLike, adhesive: bool) -> _Array:
    """The formula of every element, computed once for each distinct one: in a sweep most are the same."""
    array = np.asarray(values, dtype=np.float64)
    distinct, places = np.unique(array, return_inverse=True)
    computed = np.array([formula(float(value), adhesive) for value in distinct], dtype=np.float64)
    return computed[places].reshape(array.shape)


def duration(zeta: ArrayLike, adhesive: bool) -> _Array:
    """Duration of an isolated impact in units of d rad (Eq. 11), of the shape of zeta >= 0.

    Infinite for an adhesive contact with zeta >= 1, which never ends.
    """
    return _each(_duration, zeta, adhesive)


def restitution(zeta: ArrayLike, adhesive: bool) -> _Array:
    """Restitution e = exp(-zeta * duration) in [0, 1] (Eq. 12), of the shape of zeta >= 0."""
    return _each(_restitution, zeta, adhesive)


def damping_ratio(e: ArrayLike, adhesive: bool) -> _Array:
    """`scalar_damping_ratio` of restitutions e in [0, 1], of their shape."""
    return _each(scalar_damping_ratio, e, adhesive)


def contact_time(e: ArrayLike, penetration: ArrayLike, adhesive: bool) -> _Array:
    """Duration in rad of an isolated impact of restitution e on a contact of penetration d (Eq. 11).

    e in [0, 1] and d > 0 (plate amplitudes) broadcast together. The paper's contact is the adhesive one,
    whose duration grows like -d log(e) as e -> 0; e below SMALLEST is taken as SMALLEST under either law.
    """
    e = np.maximum(np.asarray(e, dtype=np.float64), SMALLEST)
    return np.asarray(penetration, dtype=np.float64) * duration(damping_ratio(e, adhesive), adhesive)


def restitution_of(xi: ArrayLike) -> _Array:
    """Restitution epsilon = f(xi) in [0, 1/2] of the ball equivalent to a rigid spring of damping xi >= 0.

    Half the restitution of a nonadhesive impact at zeta = xi: the lower mass stops, the upper one
    rebounds from it, and both share the remaining momentum (docs/model.md, section 5; the paper leaves f
    open).
    """
    return 0.5 * restitution(xi, adhesive=False)
