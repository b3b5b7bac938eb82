"""Elementary functions for compiled code; no other module under `kernel` calls the C library's.

A call into the C library takes one number at a time, and its last digit depends on the library. log, hypot,
atan2 and others are those of `kernel.portable_math`, in which plain Python and compiled code agree. sin, cos,
exp, expm1 and the fused multiply-add are here, as straight-line arithmetic, which the compiler can vectorise
over lanes of cells. Each reduces its argument by a constant split into parts, so that the reduction is exact,
then evaluates a polynomial (a Chebyshev fit in 50-digit arithmetic whose error is below the rounding of the
result), summed in pairs to shorten the chain of dependent operations. Results are accurate to two units in
the last place; the tests compare them with 50 digits.
"""

import math
from typing import Any, Final

import numpy as np
from numba import types
from numba.extending import intrinsic, overload

from kernel import portable_math
from kernel.numerics.jit import PIPELINE, compilable, inlined, jit
from kernel.portable_math import EXP_POLYNOMIAL, LN2_HIGH, LN2_LOW, ONE_OVER_LN2

for _name in ("_log_of_sum", "_atan_of_ratio", "exp", "asinh", "atan2", "hypot", "log", "log1p"):
    compilable(getattr(portable_math, _name))

TWO_PI: Final = 2.0 * math.pi

_TWO_OVER_PI: Final = 2.0 / math.pi

# pi/2 in three parts (Cody and Waite). The first two have 31 and 32 significant bits, so that their products
# with a number of turns below 2**21 are exact. The parts add up to pi/2 within 1e-37.
_HALF_PI_1: Final = 1.5707963267341256
_HALF_PI_2: Final = 6.077100506303966e-11
_HALF_PI_3: Final = 2.0222662487959506e-21

_REDUCTION_LIMIT: Final = 1e5  # rad up to which `sincos_small` is exact: 6.4e4 quarter turns

#: 2/pi in pieces of 24 bits, for larger arguments: piece i counts 2**(-24 (i + 1)). The largest double begins
#: at 2**(24 * 42), whose seven pieces behind the point need 49 of these.
_PIECE_BITS: Final = 24
_PIECE: Final = 2**_PIECE_BITS
_PIECES_BEHIND: Final = 7
_HALF_PI: Final = 0.5 * math.pi
_HALF_PI_REST: Final = 6.123233995736766e-17
_TWO_OVER_PI_PIECES: Final = np.array(
    [
        10680707, 7228996, 1387004, 2578385, 16069853, 12639074, 9804092, 4427841, 16666979, 11263675,
        12935607, 2387514, 4345298, 14681673, 3074569, 13734428, 16653803, 1880361, 10960616, 8533493,
        3062596, 8710556, 7349940, 6258241, 3772886, 3769171, 3798172, 8675211, 12450088, 3874808,
        9961438, 366607, 15675153, 9132554, 7151469, 3571407, 2607881, 12013382, 4155038, 6285869,
        7677882, 13102053, 15825725, 473591, 9065106, 15363067, 6271263, 9264392, 5636912, 4652155,
    ],
    dtype=np.int64,
)  # fmt: skip

#: `exp` of any x below this is exp(-300) = 5e-131: nothing beside any number it is added to. Products and
#: their squares are normal doubles: subnormal ones, a hundred times as slow, took a third of `soft`.
LOWEST_EXPONENT: Final = -300.0


def fma(a: float, b: float, c: float) -> float:
    """a * b + c, rounded once, wherever the code is inlined; rounded twice without compilation."""
    return a * b + c


def power_of_two(k: int) -> float:
    """2**k for -1022 <= k <= 1023."""
    return math.ldexp(1.0, int(k))


def _declare_fma(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """LLVM's fma, as numba's `intrinsic` wants it: a signature and a code generator."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), generate


def _declare_power_of_two(typing: Any, k: Any) -> Any:
    """The double whose biased exponent is k and whose fraction is zero."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bias, fraction = (context.get_constant(types.int64, bits) for bits in (1023, 52))  # of an IEEE double
        exponent = builder.add(arguments[0], bias)
        return builder.bitcast(builder.shl(exponent, fraction), context.get_value_type(types.float64))

    return types.float64(types.int64), generate


_fma: Final[Any] = intrinsic(_declare_fma)
_power_of_two: Final[Any] = intrinsic(_declare_power_of_two)
# numba requires a Python function as the implementation, not the intrinsic itself
_INLINED: Final[Any] = {"forceinline": True, **PIPELINE}
overload(fma, jit_options=_INLINED)(lambda a, b, c: lambda a, b, c: _fma(a, b, c))  # noqa: PLW0108
overload(power_of_two, jit_options=_INLINED)(lambda k: lambda k: _power_of_two(k))  # noqa: PLW0108


@inlined
def multiply_add(a: float, b: float, c: float, fused: bool) -> float:
    """a * b + c, rounded once if `fused`, else twice; a constant `fused` costs nothing."""
    return fma(a, b, c) if fused else a * b + c


@inlined
def sincos_small(x: float) -> tuple[float, float]:
    """(sin x, cos x) for |x| < 1e5 rad; beyond that the reduction loses digits."""
    turns = math.floor(fma(x, _TWO_OVER_PI, 0.5))
    r = fma(turns, -_HALF_PI_3, fma(turns, -_HALF_PI_2, fma(turns, -_HALF_PI_1, x)))
    return _of_remainder(r, np.int64(turns))


@inlined
def _of_remainder(r: float, quadrant: np.int64) -> tuple[float, float]:
    """sin and cos of r + quadrant pi/2, |r| <= pi/4."""
    u = r * r
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
    swapped = (quadrant & 1) != 0
    first, second = (cosine, sine) if swapped else (sine, cosine)
    return (-first if (quadrant & 2) != 0 else first, -second if ((quadrant + 1) & 2) != 0 else second)


@inlined
def sincos(x: float) -> tuple[float, float]:
    """(sin x, cos x) for any x in rad; NaN where x is not finite."""
    return sincos_small(x) if abs(x) < _REDUCTION_LIMIT else _sincos_large(x)


@jit
def _sincos_large(x: float) -> tuple[float, float]:
    """(sin x, cos x) for |x| >= 1, by the method of Payne and Hanek."""
    # |x| is four pieces of 24 bits. Of its product with 2/pi the seven pieces behind the point determine the
    # remainder to 2**-140, 2**-78 of the smallest one that a double leaves
    t, top = abs(x), 0  # the first piece counts 2**(24 * top)
    if not t < math.inf:
        return math.nan, math.nan
    while t >= _PIECE:
        t /= _PIECE
        top += 1
    first = math.floor(t)
    t = (t - first) * _PIECE
    second = math.floor(t)
    t = (t - second) * _PIECE
    third = math.floor(t)
    fourth = (t - third) * _PIECE
    pieces = (np.int64(first), np.int64(second), np.int64(third), np.int64(fourth))
    carry, total = np.int64(0), np.int64(0)
    fraction, rest = 0.0, 0.0  # of a quarter turn, and 1 - fraction
    for behind in range(_PIECES_BEHIND, -1, -1):
        total = carry
        for k in range(4):
            i = behind + top - 1 - k
            if i >= 0:
                total += pieces[k] * _TWO_OVER_PI_PIECES[i]
        carry = total >> _PIECE_BITS
        if behind > 0:
            piece = total & (_PIECE - 1)
            fraction = (fraction + piece) / _PIECE
            rest = (rest + (_PIECE - 1 - piece)) / _PIECE
    if fraction >= 0.5:
        fraction, total = -rest, total + 1
    r = fraction * _HALF_PI
    lost = fma(fraction, _HALF_PI, -r) + fraction * _HALF_PI_REST  # the rounding error of r
    sine, cosine = _of_remainder(r, np.int64(total))
    sine, cosine = fma(lost, cosine, sine), fma(-lost, sine, cosine)
    return -sine if x < 0.0 else sine, cosine


@inlined
def _exp_parts(x: float) -> tuple[float, float]:
    """2**k and e with exp(x) = 2**k (1 + e), for -708 <= x <= 709."""
    c0, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10 = EXP_POLYNOMIAL
    k = math.floor(fma(x, ONE_OVER_LN2, 0.5))
    r = fma(k, -LN2_LOW, fma(k, -LN2_HIGH, x))
    s = r * r
    t = s * s
    low = fma(s, fma(r, c3, c2), fma(r, c1, c0))
    high = fma(s, fma(r, c7, c6), fma(r, c5, c4))
    top = fma(s, c10, fma(r, c9, c8))
    p = fma(t, fma(t, top, high), low)
    return power_of_two(int(k)), fma(s, p, r)


@jit
def exp(x: float) -> float:
    """The exponential of x <= 0; exp(-300) = 5e-131 for all x below -300."""
    scale, e = _exp_parts(max(x, LOWEST_EXPONENT))
    return (1.0 + e) * scale


@jit
def expm1(x: float) -> float:
    """exp(x) - 1 for x <= 0, without cancellation for small x."""
    scale, e = _exp_parts(max(x, LOWEST_EXPONENT))
    return fma(scale, e, scale - 1.0)
