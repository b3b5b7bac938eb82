"""sin, cos and exp as straight-line arithmetic, so that lanes of cells can share one instruction.

A call into the C library takes one number at a time. Each function here reduces its argument
by constants split so that the reduction is exact, then takes a polynomial fitted (Chebyshev,
in 50-digit arithmetic) below the rounding of the result, summed in pairs to shorten the chain.
Accurate to two units in the last place; the tests compare with 50 digits.
"""

import math
from typing import Final

import numpy as np

from kernel.numerics.intrinsics import fma, power_of_two
from kernel.numerics.jit import inlined, jit

_TWO_OVER_PI: Final = 2.0 / math.pi
_HALF_PI_1: Final = 1.5707963267341256
_HALF_PI_2: Final = 6.077100506303966e-11
_HALF_PI_3: Final = 2.0222662487959506e-21
_ONE_OVER_LN2: Final = 1.4426950408889634
_LN2_1: Final = 0.6931471803691238
_LN2_2: Final = 1.9082149292705877e-10

#: Beyond this many rad the reduction of `sincos` loses digits.
_FAR: Final = 1e5

#: How far `bent` follows sinh and cosh to rounding.
GENTLE: Final = 0.25

#: Exponents below this are taken as it: 2**k with less would no longer have all its digits.
_LEAST: Final = -708.0


@jit
def sincos(x: float) -> tuple[float, float]:
    """sin x and cos x for |x| < _FAR rad."""
    return bent(x, 1.0)


@inlined
def bent(x: float, sign: float) -> tuple[float, float]:
    """sin x and cos x for |x| < _FAR rad; with sign = -1, sinh x and cosh x for |x| <= GENTLE.

    Their power series are the same but for the sign of x squared.
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
def turned(x: float) -> tuple[float, float]:
    """sin x and cos x for any x."""
    return sincos(x) if abs(x) < _FAR else (math.sin(x), math.cos(x))


@jit
def exp(x: float) -> float:
    """The exponential of x <= 0; of x < -708 that of -708."""
    x = max(x, _LEAST)
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
