"""sin, cos and exp as straight-line arithmetic, so that lanes of cells can share one instruction.

A call into the C library takes one number at a time. Each function here reduces its argument
by constants split so that the reduction is exact, then takes a polynomial fitted (Chebyshev,
in 50-digit arithmetic) below the rounding of the result, summed in pairs to shorten the chain.
Accurate to two units in the last place; the tests compare with 50 digits.
"""

import math
from typing import Final

import numpy as np

from kernel.jit import jit

_TWO_OVER_PI: Final = 2.0 / math.pi
_HALF_PI_1: Final = 1.5707963267341256
_HALF_PI_2: Final = 6.077100506303966e-11
_HALF_PI_3: Final = 2.0222662487959506e-21
_ONE_OVER_LN2: Final = 1.4426950408889634
_LN2_1: Final = 0.6931471803691238
_LN2_2: Final = 1.9082149292705877e-10

#: The most negative exponent whose exponential is not zero.
_LEAST: Final = -745.0

#: 2**-k, by index k.
_POWERS: Final = np.array([math.ldexp(1.0, -k) for k in range(1080)])


@jit
def sincos(x: float) -> tuple[float, float]:
    """sin x and cos x for |x| < 1e5 rad."""
    turns = math.floor(x * _TWO_OVER_PI + 0.5)
    r = ((x - turns * _HALF_PI_1) - turns * _HALF_PI_2) - turns * _HALF_PI_3
    u = r * r
    v = u * u
    odd = (
        (-0.16666666666666666 + u * 0.008333333333330925)
        + v * (-0.00019841269836722437 + u * 2.755731608382574e-06)
        + v * v * (-2.505112794596564e-08 + u * 1.591784866512194e-10)
    )
    even = (
        (0.041666666666666664 - u * 0.0013888888888887382)
        + v * (2.480158729874308e-05 - u * 2.755731726001471e-07)
        + v * v * (2.0876143829213935e-09 - u * 1.1382456865840483e-11)
    )
    sine, cosine = r + r * (u * odd), 1.0 - (0.5 * u - v * even)
    quadrant = np.int64(turns)
    swapped = (quadrant & 1) != 0
    first, second = (cosine, sine) if swapped else (sine, cosine)
    return (
        -first if (quadrant & 2) != 0 else first,
        -second if ((quadrant + 1) & 2) != 0 else second,
    )


@jit
def exp(x: float) -> float:
    """The exponential of x <= 0."""
    x = max(x, _LEAST)
    k = math.floor(x * _ONE_OVER_LN2 + 0.5)
    r = (x - k * _LN2_1) - k * _LN2_2
    s = r * r
    t = s * s
    p = (
        (0.5 + r * 0.1666666666666667)
        + s * (0.04166666666666667 + r * 0.008333333333326084)
        + t * (0.0013888888888883711 + r * 0.0001984126987500228)
        + t * s * (2.480158732567746e-05 + r * 2.755725517000089e-06)
        + t * t * ((2.755727347871858e-07 + r * 2.5105312729622103e-08) + s * 2.09147553258932e-09)
    )
    return float((1.0 + (r + s * p)) * _POWERS[-np.int64(k)])
