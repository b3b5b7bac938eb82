"""log, exp, hypot, atan2 and other functions whose last digit is the same on every machine.

The functions of the C library and of numpy differ between versions, and between processors with and without
fused multiply-adds; that can change the outcome of a cell near a bifurcation. Here they are written with
+, -, *, / and square roots, each correctly rounded everywhere, and frexp and ldexp, which are exact. So
plain Python, which the specification uses, and compiled code give the same bytes.

Each function reduces its argument exactly, or carries the rounding error of the reduction, and evaluates a
polynomial: a Chebyshev fit in 50-digit arithmetic, with an error below a hundredth of the rounding of the
result. Results are within two units in the last place, most within one; the tests compare them with 50
digits. Subnormal numbers, zeros, infinities and NaN are treated as in C. No numba here: compiled code uses
these functions through `kernel.numerics.elementary`, which also has those for lanes.
"""

import math
from typing import Final

#: exp(r) = 1 + r + r^2 p(r) for |r| <= ln(2)/2, p to 1.4e-18.
EXP_POLYNOMIAL: Final = (
    0.5, 0.1666666666666667, 0.04166666666666667, 0.008333333333326084, 0.0013888888888883711,
    0.0001984126987500228, 2.480158732567746e-05, 2.755725517000089e-06, 2.755727347871858e-07,
    2.5105312729622103e-08, 2.09147553258932e-09,
)  # fmt: skip

#: ln((1 + s)/(1 - s)) = 2 s + s z p(z) with z = s^2, for |s| <= (sqrt(2) - 1)/(sqrt(2) + 1), p to 2.1e-18.
_LOG_POLYNOMIAL: Final = (
    0.6666666666666666, 0.40000000000000885, 0.28571428570799784, 0.22222222392581045,
    0.18181795547521137, 0.15386244737621665, 0.13268638369266825, 0.13088034850927555,
)  # fmt: skip

#: atan(u) = u - u z p(z) with z = u^2, for |u| <= 7/16, p to 4.0e-18.
_ATAN_POLYNOMIAL: Final = (
    0.3333333333333333, -0.19999999999999404, 0.14285714285565465, -0.111111110965279,
    0.09090908350382436, -0.07692285419714515, 0.06666239748865294, -0.05876924062763387,
    0.05216532007308444, -0.044916556747777434, 0.033114228762660534, -0.014759380407779157,
)  # fmt: skip

#: ln 2 in two parts, the first of 32 bits, so that its product with an exponent is exact (Cody and Waite).
LN2_HIGH: Final = 0.6931471803691238
LN2_LOW: Final = 1.9082149292705877e-10
ONE_OVER_LN2: Final = 1.4426950408889634

# Numbers rounded to double, and the rest.
_PI: Final = (3.141592653589793, 1.2246467991473532e-16)
_HALF_PI: Final = (1.5707963267948966, 6.123233995736766e-17)
_QUARTER_PI: Final = (0.7853981633974483, 3.061616997868383e-17)
_ATAN_HALF: Final = (0.4636476090008061, 2.2698777452961687e-17)

_SQRT_HALF: Final = 0.7071067811865476

#: The largest argument with a finite exponential, ln of the largest double, and one below which the
#: exponential is less than half of the smallest, 2**-1075.
_HIGHEST_EXPONENT: Final = 709.782712893384
_LOWEST_EXPONENT: Final = -745.2

#: `hypot` squares numbers between these as they are: 2**+-500, whose squares are normal. `_SCALE` brings
#: all others there.
_LARGE: Final = 2.0**500
_SMALL: Final = 2.0**-500
_SCALE: Final = 2.0**600

#: Above this sqrt(1 + x^2) = x to half a unit in the last place: 1/(2 x^2) < 2**-54.
_FAR: Final = 2.0**28


def log(x: float) -> float:
    """The natural logarithm; -inf at 0, NaN for x < 0."""
    return _log_of_sum(x, 0.0)


def log1p(x: float) -> float:
    """ln(1 + x) without cancellation for small x; -inf at -1, NaN below."""
    u = 1.0 + x
    if u == math.inf:
        return u
    return _log_of_sum(u, x - (u - 1.0) if x <= 1.0 else 1.0 - (u - x))


def _log_of_sum(u: float, rest: float) -> float:
    """ln(u + rest), with |rest| at most half a unit in the last place of u."""
    if not u > 0.0:
        return -math.inf if u == 0.0 else math.nan
    if u == math.inf:
        return u
    m, k = math.frexp(u)
    if m < _SQRT_HALF:
        m, k = 2.0 * m, k - 1
    f = m - 1.0  # exact
    half_square, s = 0.5 * f * f, f / (2.0 + f)
    z = s * s
    c0, c1, c2, c3, c4, c5, c6, c7 = _LOG_POLYNOMIAL
    p = z * (c0 + z * (c1 + z * (c2 + z * (c3 + z * (c4 + z * (c5 + z * (c6 + z * c7)))))))
    # ln m = 2 s + s p = f - f^2/2 + s (f^2/2 + p), with f exact
    low = s * (half_square + p) + (k * LN2_LOW + rest / u)
    return k * LN2_HIGH - ((half_square - low) - f)


def exp(x: float) -> float:
    """The exponential of any x."""
    if math.isnan(x):
        return x
    if x > _HIGHEST_EXPONENT:
        return math.inf
    if x < _LOWEST_EXPONENT:
        return 0.0
    k = math.floor(x * ONE_OVER_LN2 + 0.5)
    r = (x - k * LN2_HIGH) - k * LN2_LOW
    c0, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10 = EXP_POLYNOMIAL
    p = c5 + r * (c6 + r * (c7 + r * (c8 + r * (c9 + r * c10))))
    p = c0 + r * (c1 + r * (c2 + r * (c3 + r * (c4 + r * p))))
    return math.ldexp(1.0 + (r + r * r * p), int(k))


def hypot(x: float, y: float) -> float:
    """sqrt(x^2 + y^2), without overflow or underflow on the way."""
    a, b = abs(x), abs(y)
    if math.isinf(a) or math.isinf(b):
        return math.inf
    if a < b:
        a, b = b, a
    scale = 1.0 / _SCALE if a > _LARGE else (_SCALE if a < _SMALL else 1.0)
    a, b = a * scale, b * scale
    return math.sqrt(a * a + b * b) / scale


def atan2(y: float, x: float) -> float:
    """The angle of the point (x, y) in [-pi, pi] rad, with C's signs at zeros and infinities."""
    if math.isnan(x) or math.isnan(y):
        return math.nan
    a, b = abs(x), abs(y)
    steep = b > a
    if steep:
        a, b = b, a
    angle = _atan_of_ratio(b, a)
    if steep:
        high, low = _HALF_PI
        angle = high + (angle + low) if x < 0.0 else high - (angle - low)
    elif math.copysign(1.0, x) < 0.0:
        high, low = _PI
        angle = high - (angle - low)
    return math.copysign(angle, y)


def _atan_of_ratio(b: float, a: float) -> float:
    """atan(b/a) for 0 <= b <= a, with 0/0 = 0 and inf/inf = 1; from 0, atan(1/2) or pi/4 on."""
    if b == 0.0:
        return 0.0
    if b == math.inf:
        return _QUARTER_PI[0]
    if a < _SMALL:  # so that a half of a is exact
        a, b = a * _SCALE, b * _SCALE
    if b <= 0.4375 * a:
        high, low, u = 0.0, 0.0, b / a
    else:
        if a > _LARGE:  # so that a + b does not overflow
            a, b = a / _SCALE, b / _SCALE
        if b <= 0.6875 * a:
            (high, low), u = _ATAN_HALF, (b - 0.5 * a) / (a + 0.5 * b)
        else:
            (high, low), u = _QUARTER_PI, (b - a) / (a + b)
    z = u * u
    c0, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10, c11 = _ATAN_POLYNOMIAL
    p = c6 + z * (c7 + z * (c8 + z * (c9 + z * (c10 + z * c11))))
    p = c0 + z * (c1 + z * (c2 + z * (c3 + z * (c4 + z * (c5 + z * p)))))
    return high + (u - (u * z * p - low))


def asinh(x: float) -> float:
    """The inverse hyperbolic sine."""
    a = abs(x)
    if a > _FAR:
        value = log(a) + (LN2_HIGH + LN2_LOW)
    elif a > 2.0:
        value = log(2.0 * a + 1.0 / (math.sqrt(a * a + 1.0) + a))
    else:
        value = log1p(a + a * a / (1.0 + math.sqrt(1.0 + a * a)))
    return math.copysign(value, x)
