"""A quartic with positive coefficients as two real quadratics, in each way there is.

The free motion of the spring on a soft plate has four roots. Taken in two pairs they are
two damped oscillators, whose closed forms are safe at every damping; a single root, which
may be one of a double pair, is never used by itself.
"""

import math
from typing import Final, NamedTuple

from kernel.numerics.jit import jit

#: Rounds of Aberth's method; a dozen is the rule, wide spreads of roots take more.
ROUNDS: Final = 100


class Factors(NamedTuple):
    """(s^2 + a1 s + b1)(s^2 + a2 s + b2) with b1 <= b2, but for rounding."""

    a1: float
    b1: float
    a2: float
    b2: float


@jit
def roots(c3: float, c2: float, c1: float, c0: float) -> tuple[complex, complex, complex, complex]:
    """The roots of s^4 + c3 s^3 + c2 s^2 + c1 s + c0, c0 > 0, by Aberth's method; the smallest first."""
    unit = c0**0.25  # in units of the geometric mean of the roots' sizes
    c3, c2, c1 = c3 / unit, c2 / unit**2, c1 / unit**3
    size = max(c3, math.sqrt(c2), c1 ** (1.0 / 3.0), 1.0)
    small = 1.0 / max(c1, math.sqrt(c2), c3 ** (1.0 / 3.0), 1.0)
    z = [complex(-0.6 * size, 0.8 * size), complex(-0.8 * size, -0.7 * size),
         complex(-0.6 * small, 0.8 * small), complex(-0.8 * small, -0.7 * small)]  # fmt: skip
    for _ in range(ROUNDS):
        moved = 0.0
        for i in range(4):
            s = z[i]
            value = (((s + c3) * s + c2) * s + c1) * s + 1.0
            slope = ((4.0 * s + 3.0 * c3) * s + 2.0 * c2) * s + c1
            crowd = complex(0.0, 0.0)
            for j in range(4):
                apart = s - z[j]
                if apart != 0.0:  # a complex division by zero would raise
                    crowd += 1.0 / apart
            slope -= crowd * value
            if value == 0.0 or slope == 0.0:
                continue
            step = value / slope
            z[i] = s - step
            moved = max(moved, abs(step) / abs(s))
        if moved < 1e-14:
            break
    for i in range(1, 4):
        for j in range(i, 0, -1):
            if abs(z[j]) < abs(z[j - 1]):
                z[j], z[j - 1] = z[j - 1], z[j]
    return unit * z[0], unit * z[1], unit * z[2], unit * z[3]


@jit
def _pairing(p: complex, q: complex, r: complex, s: complex) -> tuple[float, Factors]:
    """The quadratics of {p, q} and {r, s}, and how far apart their roots are, in [0, 1]; 0 if not real."""
    first, second = p * q, r * s
    strayed = abs(first.imag) / abs(first) + abs(second.imag) / abs(second)
    strayed += abs((p + q).imag) / (abs(p) + abs(q)) + abs((r + s).imag) / (abs(r) + abs(s))
    if strayed > 1e-4:
        return 0.0, Factors(0.0, 0.0, 0.0, 0.0)
    apart = abs(p - r) / (abs(p) + abs(r)) * (abs(p - s) / (abs(p) + abs(s)))
    apart *= abs(q - r) / (abs(q) + abs(r)) * (abs(q - s) / (abs(q) + abs(s)))
    if first.real <= second.real:
        return apart, Factors(-(p + q).real, first.real, -(r + s).real, second.real)
    return apart, Factors(-(r + s).real, second.real, -(p + q).real, first.real)


@jit
def paired(
    c3: float, c2: float, c1: float, c0: float, z: tuple[complex, complex, complex, complex], partner: int
) -> tuple[float, Factors]:
    """The quadratics in which the smallest of the roots z goes with z[partner], 1 to 3.

    First how far apart the two quadratics are, 0 to 1: at 0 they are not real or share a root, and
    mean nothing.
    """
    second, third = (2, 3) if partner == 1 else (1, 3) if partner == 2 else (1, 2)
    apart, f = _pairing(z[0], z[partner], z[second], z[third])
    return apart, _polished(c3, c2, c1, c0, f) if apart > 0.0 else f


@jit
def _polished(c3: float, c2: float, c1: float, c0: float, f: Factors) -> Factors:
    """Newton's method on the quadratic with the smaller linear term, a and b; the other is A and B.

    A = c3 - a and B = c0/b hold by construction, so that nothing is left to cancel in them.
    """
    swapped = f.a2 < f.a1
    a, b = (f.a2, f.b2) if swapped else (f.a1, f.b1)
    best, best_a, best_b = math.inf, a, b
    for _ in range(5):
        other_a, other_b = c3 - a, c0 / b
        off2, off1 = b + other_b + a * other_a - c2, a * other_b + other_a * b - c1
        off = abs(off2) / c2 + abs(off1) / (c1 + math.sqrt(c0 * c2))
        if off >= best:
            break  # rounding, or roots so near each other that there is no better
        best, best_a, best_b = off, a, b
        # their derivatives by a and b
        by_a2, by_b2 = other_a - a, 1.0 - other_b / b
        by_a1, by_b1 = other_b - b, other_a - a * other_b / b
        det = by_a2 * by_b1 - by_b2 * by_a1
        if det == 0.0:
            break
        a -= (off2 * by_b1 - by_b2 * off1) / det
        b -= (by_a2 * off1 - off2 * by_a1) / det
    a, b = best_a, best_b
    other_a, other_b = c3 - a, c0 / b
    return Factors(other_a, other_b, a, b) if swapped else Factors(a, b, other_a, other_b)
