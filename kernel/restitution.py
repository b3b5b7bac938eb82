"""Isolated impacts on the spring-dashpot contact: duration, restitution and damping ratio; no numba.

An isolated impact is gap'' + 2 zeta gap' + gap = 0 from gap = 0, gap' = -1, in units of d rad, to where the
gap (adhesive) or the force (nonadhesive) is zero again (docs/model.md, section 2):

    adhesive     duration pi/s                 zeta < 1                (Eq. 11)
    nonadhesive  duration 2 atan2(s, zeta)/s   zeta < 1
                 duration 2 asinh(s)/s         zeta > 1
    both         e = exp(-zeta duration)                               (Eq. 12)

with s = sqrt(|1 - zeta^2|). Each formula is written once, for one number, with functions that give the same
digits on every machine: array functions apply it to every element, and `soft` compiles it.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kernel.portable_math import asinh, atan2, exp, log, log1p

#: The smallest restitution of an impact, whose rebound is below the rounding of the motion after it. At e = 0
#: a nonadhesive contact has infinite damping, and an adhesive one never ends.
SMALLEST: Final = 1e-12

#: 1 - zeta**2 below this counts as zero in the slope of zeta * duration, whose quotient is 0/0 at zeta = 1;
#: the slope is then off by 1e-4 of itself, which costs Newton's method nothing.
_CRITICAL: Final = 1e-4

_CONVERGED: Final = 1e-9  # relative size of Newton's step after which the next one, its square, is rounding
_STRONG: Final = 4.0  # -ln e above which (zeta > 3.4) zeta is computed by `strong_damping_ratio`
_NEWTON_STEPS: Final = 20  # cap on Newton's steps; at most 7 are taken

_Array = NDArray[np.float64]


# --- one number -----------------------------------------------------------------------------


def nonadhesive_duration(zeta: float) -> float:
    """Duration of a nonadhesive impact in units of d rad, for zeta >= 0."""
    s = math.sqrt(abs((1.0 - zeta) * (1.0 + zeta)))
    if s == 0.0:
        return 2.0
    return 2.0 * (atan2(s, zeta) if zeta < 1.0 else asinh(s)) / s


def scalar_damping_ratio(e: float, adhesive: bool) -> float:
    """The damping ratio zeta that gives restitution e in [0, 1].

    Adhesive e = 0 is critical damping, zeta = 1. Nonadhesive e below SMALLEST is taken as SMALLEST.
    """
    if adhesive:
        if e == 0.0:
            return 1.0
        loss = abs(log(e))
        return loss / math.sqrt(math.pi * math.pi + loss * loss)
    e = max(e, SMALLEST)
    loss = abs(log(e))
    # zeta * duration = loss is concave, so that Newton's method from below never overshoots; for strong
    # damping, where it is 2 ln(2 zeta), the first step comes from above and ends just below
    zeta = loss / math.pi if loss < 2.0 else 0.5 / math.sqrt(e)
    for _ in range(_NEWTON_STEPS):
        duration = nonadhesive_duration(zeta)
        square = (1.0 - zeta) * (1.0 + zeta)
        slope = (duration - 2.0 * zeta) / square if abs(square) > _CRITICAL else 4.0 / 3.0
        step = (loss - zeta * duration) / slope
        zeta += step
        if abs(step) <= _CONVERGED * zeta:
            break
    return zeta if loss < _STRONG else strong_damping_ratio(e, zeta)


def strong_damping_ratio(e: float, zeta: float) -> float:
    """zeta > 1 without the rounding of ln e, which is several times that of e; from zeta next to it."""
    # e = exp(-r)/(2 zeta)**2, where r = zeta * duration - 2 ln(2 zeta) is written so that nothing cancels
    s = math.sqrt((zeta - 1.0) * (zeta + 1.0))
    r = 2.0 * asinh(s) / (s * (s + zeta)) + 2.0 * log1p(-0.5 / (zeta * (s + zeta)))
    return 0.5 * exp(-0.5 * r) / math.sqrt(e)


def _adhesive_duration(zeta: float) -> float:
    """Duration of an adhesive impact in units of d rad (Eq. 11), for zeta < 1: at 1 it never ends."""
    return math.pi / math.sqrt((1.0 - zeta) * (1.0 + zeta))


def _nonadhesive_restitution(zeta: float) -> float:
    """Restitution in [0, 1] of a nonadhesive impact (Eq. 12), for zeta >= 0."""
    return exp(-zeta * nonadhesive_duration(zeta))


# --- arrays ---------------------------------------------------------------------------------


def _each(formula: Callable[[float], float], values: ArrayLike) -> _Array:
    """The formula of every element, computed once for each distinct value: in a sweep most are equal."""
    array = np.asarray(values, dtype=np.float64)
    distinct, places = np.unique(array, return_inverse=True)
    computed = np.array([formula(float(value)) for value in distinct], dtype=np.float64)
    return computed[places].reshape(array.shape)


def damping_ratio(e: ArrayLike, adhesive: bool) -> _Array:
    """`scalar_damping_ratio` of restitutions e in [0, 1], of their shape."""
    return _each(partial(scalar_damping_ratio, adhesive=adhesive), e)


def contact_time(e: ArrayLike, penetration: ArrayLike, adhesive: bool) -> _Array:
    """Duration in rad of an isolated impact of restitution e on a contact of penetration d (Eq. 11).

    e in [0, 1] and d > 0 (plate amplitudes) broadcast together. The paper's contact is the adhesive one,
    whose duration grows like -d log(e) as e -> 0; e below SMALLEST is taken as SMALLEST under either law.
    """
    e = np.maximum(np.asarray(e, dtype=np.float64), SMALLEST)
    duration = _each(_adhesive_duration if adhesive else nonadhesive_duration, damping_ratio(e, adhesive))
    return np.asarray(penetration, dtype=np.float64) * duration


def restitution_of(xi: ArrayLike) -> _Array:
    """Restitution epsilon = f(xi) in [0, 1/2] of the ball equivalent to a rigid spring of damping xi >= 0.

    Half that of a nonadhesive impact at zeta = xi (docs/model.md, section 5; the paper leaves f open).
    """
    return 0.5 * _each(_nonadhesive_restitution, xi)
