"""A quartic with positive coefficients as the product of two real quadratics, in every way there is.

The free motion of the spring on a soft plate has four roots. In two pairs they are two damped
oscillators, whose closed forms (`kernel.numerics.oscillator`) do not cancel at any damping. A single root,
which may be one of a nearly double pair, is never used by itself.
"""

import math
from typing import Final, NamedTuple

from kernel.numerics.jit import allocating, inlined, jit

ROUNDS: Final = 100  # cap on those of Aberth's method; a dozen is usual
CONVERGED: Final = 1e-14  # relative change at which Aberth's method, of third order, has converged

#: First guesses, in units of the largest and smallest roots' sizes: in the left half-plane, where the roots
#: are, off the real axis, and apart from each other's conjugates, as symmetric guesses would stay symmetric.
_FIRST_GUESS: Final = complex(-0.6, 0.8)
_SECOND_GUESS: Final = complex(-0.8, -0.7)

#: Relative imaginary part above which a pair's sum or product is not that of a real quadratic. Rounding moves
#: the roots of a double pair by 1.5e-8 and more; complex roots that are not conjugates differ by order 1.
_REAL: Final = 1e-4

_NEWTON_ROUNDS: Final = 5  # on a quadratic, from errors of 1e-8; ends where a round does not improve


class Factors(NamedTuple):
    """(s^2 + a1 s + b1)(s^2 + a2 s + b2) with b1 <= b2, up to rounding."""

    a1: float
    b1: float
    a2: float
    b2: float


@allocating
def roots(c3: float, c2: float, c1: float, c0: float) -> tuple[complex, complex, complex, complex]:
    """The roots of s^4 + c3 s^3 + c2 s^2 + c1 s + c0, by absolute value, by Aberth's method.

    c3, c2, c1 >= 0, c0 > 0. Not polished: a double root has half of the digits.
    """
    unit = math.sqrt(math.sqrt(c0))  # in units of the geometric mean of the roots' sizes
    c3, c2, c1 = c3 / unit, c2 / (unit * unit), c1 / (unit * unit * unit)
    # the largest root and, from the reversed polynomial, the smallest, up to factors of order 1. The roots
    # are damped, so that c1 <= c3 c2 and c3 <= c1 c2: no cube root of c1 or c3 is larger
    large = max(c3, math.sqrt(c2), 1.0)
    small = 1.0 / max(c1, math.sqrt(c2), 1.0)
    z = [large * _FIRST_GUESS, large * _SECOND_GUESS, small * _FIRST_GUESS, small * _SECOND_GUESS]
    for _ in range(ROUNDS):
        moved = 0.0
        for i in range(4):
            s = z[i]
            value = (((s + c3) * s + c2) * s + c1) * s + 1.0
            slope = ((4.0 * s + 3.0 * c3) * s + 2.0 * c2) * s + c1
            repulsion = complex(0.0, 0.0)  # of the other roots: Aberth's term beside Newton's
            for j in range(4):
                apart = s - z[j]
                if apart != 0.0:  # a complex division by zero would raise
                    repulsion += 1.0 / apart
            slope -= repulsion * value
            if value == 0.0 or slope == 0.0:
                continue
            step = value / slope
            z[i] = s - step
            moved = max(moved, _square(step) / _square(s))
        if moved < CONVERGED * CONVERGED:
            break
    for i in range(1, 4):
        for j in range(i, 0, -1):
            if _square(z[j]) < _square(z[j - 1]):
                z[j], z[j - 1] = z[j - 1], z[j]
    return unit * z[0], unit * z[1], unit * z[2], unit * z[3]


@inlined
def _square(z: complex) -> float:
    """|z|^2; its square root would be the C library's hypot."""
    return z.real * z.real + z.imag * z.imag


@inlined
def _size(z: complex) -> float:
    """|z|, of numbers whose squares are finite."""
    return math.sqrt(_square(z))


@jit
def _pairing(p: complex, q: complex, r: complex, s: complex) -> tuple[float, Factors]:
    """The quadratics with the roots {p, q} and {r, s}, and their separation.

    The separation, in [0, 1], is the product of the relative distances between the roots of one and those
    of the other; 0 stands also for quadratics that are not real.
    """
    first, second = p * q, r * s
    imaginary = abs(first.imag) / _size(first) + abs(second.imag) / _size(second)
    imaginary += abs((p + q).imag) / (_size(p) + _size(q)) + abs((r + s).imag) / (_size(r) + _size(s))
    if imaginary > _REAL:
        return 0.0, Factors(0.0, 0.0, 0.0, 0.0)
    apart = _size(p - r) / (_size(p) + _size(r)) * (_size(p - s) / (_size(p) + _size(s)))
    apart *= _size(q - r) / (_size(q) + _size(r)) * (_size(q - s) / (_size(q) + _size(s)))
    if first.real <= second.real:
        return apart, Factors(-(p + q).real, first.real, -(r + s).real, second.real)
    return apart, Factors(-(r + s).real, second.real, -(p + q).real, first.real)


@jit
def paired(
    c3: float, c2: float, c1: float, c0: float, z: tuple[complex, complex, complex, complex], partner: int
) -> tuple[float, Factors]:
    """Separation (see `_pairing`) and factors that pair the smallest of the roots z with z[partner].

    At separation 0 they are not real or share a root, and are not to be used.
    """
    second, third = (2, 3) if partner == 1 else (1, 3) if partner == 2 else (1, 2)
    apart, f = _pairing(z[0], z[partner], z[second], z[third])
    return apart, _polished(c3, c2, c1, c0, f) if apart > 0.0 else f


@jit
def _polished(c3: float, c2: float, c1: float, c0: float, f: Factors) -> Factors:
    """The factors to rounding, by Newton's method for the s^2 and s^1 coefficients of their product.

    The unknowns are a and b of s^2 + a s + b, the factor with the smaller linear term. The other's follow
    as c3 - a and c0/b, without cancellation.
    """
    swapped = f.a2 < f.a1
    a, b = (f.a2, f.b2) if swapped else (f.a1, f.b1)
    best, best_a, best_b = math.inf, a, b
    for _ in range(_NEWTON_ROUNDS):
        other_a, other_b = c3 - a, c0 / b
        residual2, residual1 = b + other_b + a * other_a - c2, a * other_b + other_a * b - c1
        residual = abs(residual2) / c2 + abs(residual1) / (c1 + math.sqrt(c0 * c2))
        if residual >= best:
            break  # down to rounding, or limited by nearly equal roots
        best, best_a, best_b = residual, a, b
        # derivatives of the residuals with respect to a and b
        by_a2, by_b2 = other_a - a, 1.0 - other_b / b
        by_a1, by_b1 = other_b - b, other_a - a * other_b / b
        det = by_a2 * by_b1 - by_b2 * by_a1
        if det == 0.0:
            break
        a -= (residual2 * by_b1 - by_b2 * residual1) / det
        b -= (by_a2 * residual1 - residual2 * by_a1) / det
    a, b = best_a, best_b
    other_a, other_b = c3 - a, c0 / b
    return Factors(other_a, other_b, a, b) if swapped else Factors(a, b, other_a, other_b)
