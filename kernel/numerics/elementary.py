"""sin, cos and exp as straight-line arithmetic, which the compiler can vectorise over lanes of cells.

A call into the C library takes one number at a time, and its last digit depends on the library. Each
function here reduces its argument by a constant split into parts, so that the reduction is exact, then
evaluates a polynomial (a Chebyshev fit in 50-digit arithmetic whose error is below the rounding of the
result), summed in pairs to shorten the chain of dependent operations. Results are accurate to two units
in the last place; the tests compare them with 50 digits.
"""

import math
from typing import Final

import numpy as np

from kernel.numerics.intrinsics import fma, power_of_two
from kernel.numerics.jit import inlined, jit

TWO_PI: Final = 2.0 * math.pi

_TWO_OVER_PI: Final = 2.0 / math.pi

# pi/2 in three parts and ln 2 in two (Cody and Waite). The first parts of pi/2 have 31 and 32 significant
# bits, that of ln 2 has 32, so that their products with a number of turns below 2**21 are exact. The parts
# add up to pi/2 within 1e-37 and to ln 2 within 1.2e-26.
_HALF_PI_1: Final = 1.5707963267341256
_HALF_PI_2: Final = 6.077100506303966e-11
_HALF_PI_3: Final = 2.0222662487959506e-21
_ONE_OVER_LN2: Final = 1.4426950408889634
_LN2_1: Final = 0.6931471803691238
_LN2_2: Final = 1.9082149292705877e-10

#: rad up to which `sincos_small` keeps its accuracy: 6.4e4 turns of pi/2, whose products with the parts of
#: pi/2 are exact, and whose remainder is known to 6.4e4 * 1e-37.
_REDUCTION_LIMIT: Final = 1e5

#: Up to this argument `circular_or_hyperbolic` gives sinh and cosh to rounding. Its polynomials are fitted
#: for x^2 > 0, |x| <= pi/4; with -x^2 they are extrapolated, whose error stays below two units in the last
#: place up to here (measured against 50 digits; a test does so).
HYPERBOLIC_LIMIT: Final = 0.25

#: `exp` of any x below this is exp(-708) = 3.3e-308, about the smallest normal double, which is the least
#: that `power_of_two` makes.
_LOWEST_EXPONENT: Final = -708.0


@jit
def sincos_small(x: float) -> tuple[float, float]:
    """(sin x, cos x) for |x| < 1e5 rad; beyond that the reduction loses digits."""
    return circular_or_hyperbolic(x, 1.0)


@inlined
def circular_or_hyperbolic(x: float, sign: float) -> tuple[float, float]:
    """(sin x, cos x) for sign = 1 and |x| < 1e5 rad; (sinh x, cosh x) for sign = -1 and
    |x| <= HYPERBOLIC_LIMIT.

    The power series of the two pairs differ only in the sign of x squared, so that each lane may choose
    without a branch.
    """
    turns = math.floor(fma(x, _TWO_OVER_PI, 0.5))
    r = fma(turns, -_HALF_PI_3, fma(turns, -_HALF_PI_2, fma(turns, -_HALF_PI_1, x)))
    u = sign * r * r
    v = u * u
    odd = fma(
        v,
        fma(
            v,
            fma(u, 1.591784866512194e-10, -2.505112794596564e-08),
            fma(u, 2.755731608382574e-06, -0.00019841269836722437),
        ),
        fma(u, 0.008333333333330925, -0.16666666666666666),
    )
    even = fma(
        v,
        fma(
            v,
            fma(u, -1.1382456865840483e-11, 2.0876143829213935e-09),
            fma(u, -2.755731726001471e-07, 2.480158729874308e-05),
        ),
        fma(u, -0.0013888888888887382, 0.041666666666666664),
    )
    sine, cosine = fma(r * u, odd, r), 1.0 - fma(-v, even, 0.5 * u)
    quadrant = np.int64(turns)
    swapped = (quadrant & 1) != 0
    first, second = (cosine, sine) if swapped else (sine, cosine)
    return (
        -first if (quadrant & 2) != 0 else first,
        -second if ((quadrant + 1) & 2) != 0 else second,
    )


@jit
def sincos(x: float) -> tuple[float, float]:
    """(sin x, cos x) for any x in rad."""
    return sincos_small(x) if abs(x) < _REDUCTION_LIMIT else (math.sin(x), math.cos(x))


@jit
def exp(x: float) -> float:
    """The exponential of x <= 0; exp(-708) = 3.3e-308 for all x below -708."""
    x = max(x, _LOWEST_EXPONENT)
    k = math.floor(fma(x, _ONE_OVER_LN2, 0.5))
    r = fma(k, -_LN2_2, fma(k, -_LN2_1, x))
    s = r * r
    t = s * s
    low = fma(s, fma(r, 0.008333333333326084, 0.04166666666666667), fma(r, 0.1666666666666667, 0.5))
    high = fma(
        s, fma(r, 2.755725517000089e-06, 2.480158732567746e-05),
        fma(r, 0.0001984126987500228, 0.0013888888888883711),
    )  # fmt: skip
    top = fma(s, 2.09147553258932e-09, fma(r, 2.5105312729622103e-08, 2.755727347871858e-07))
    p = fma(t, fma(t, top, high), low)
    return (1.0 + fma(s, p, r)) * power_of_two(int(k))
