"""Machine instructions without a Python name, for straight-line arithmetic in lanes.

A fused multiply-add that is written out gives the same bits wherever the code is compiled and inlined;
one left to the compiler does not (see `kernel.numerics.jit`). Without compilation (NUMBA_DISABLE_JIT=1)
its product is rounded, so that last digits may differ.
"""

import math
from typing import Any, Final

from numba import types
from numba.extending import intrinsic, overload

from kernel.numerics.compilation import Inner
from kernel.numerics.jit import inlined

#: IEEE double: the bits of the fraction, below the exponent, and the exponent's bias.
_FRACTION: Final = 52
_BIAS: Final = 1023


def fma(a: float, b: float, c: float) -> float:
    """a * b + c, rounded once."""
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
        bias, fraction = (context.get_constant(types.int64, bits) for bits in (_BIAS, _FRACTION))
        exponent = builder.add(arguments[0], bias)
        return builder.bitcast(builder.shl(exponent, fraction), context.get_value_type(types.float64))

    return types.float64(types.int64), generate


_fma: Final[Any] = intrinsic(_declare_fma)
_power_of_two: Final[Any] = intrinsic(_declare_power_of_two)
_INLINED: Final[Any] = {"forceinline": True, "pipeline_class": Inner}
# numba requires a Python function as the implementation, not the intrinsic itself
overload(fma, jit_options=_INLINED)(lambda a, b, c: lambda a, b, c: _fma(a, b, c))  # noqa: PLW0108
overload(power_of_two, jit_options=_INLINED)(lambda k: lambda k: _power_of_two(k))  # noqa: PLW0108


@inlined
def multiply_add(a: float, b: float, c: float, fused: bool) -> float:
    """a * b + c, rounded once if `fused`, else twice; a constant `fused` costs nothing."""
    return fma(a, b, c) if fused else a * b + c
