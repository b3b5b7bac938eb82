"""Isolated impacts on the spring-dashpot contact: duration, restitution and damping ratio; no numba.

An isolated impact is gap'' + 2 zeta gap' + gap = 0 from gap = 0, gap' = -1, one unit of time being d rad.
The adhesive contact ends where the gap is zero again, the nonadhesive one where the force is
(docs/model.md, section 2):

    adhesive     duration pi/s                 e = exp(-zeta duration), zeta < 1    (Eqs. 11 and 12)
    nonadhesive  duration 2 atan2(s, zeta)/s   e = exp(-zeta duration), zeta < 1
                 duration 2 asinh(s)/s         e = exp(-zeta duration), zeta > 1

with s = sqrt(|1 - zeta^2|). Both are inverted for zeta: the adhesive law in closed form, the nonadhesive
one by bisection, since e falls monotonically from 1 at zeta = 0 towards 0 at infinity.

The formulas exist twice below, for arrays and for numbers. The array functions serve the specification,
`stepped` and `ball`. The scalar ones are plain Python that `soft` compiles. The two agree to rounding;
every stored result of one model or another depends on the last digit of each, so joining them takes a
new KERNEL_VERSION.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: The smallest restitution an impact is computed for. A nonadhesive contact reaches e = 0 only at
#: infinite damping, and an adhesive one lasts for ever there; below this the contact is that of this e,
#: whose rebound is below the rounding of anything that follows it.
SMALLEST: Final = 1e-12

#: Nearer to critical damping than this s the quotients below are 0/0; their limits, with an error of
#: order s**2 = 1e-14, take their place.
CRITICAL: Final = 1e-7

#: Halvings of the bracket [0, max(2, 1/sqrt(e))] of zeta in the array functions: from its widest, 1e6, to
#: 1e-12, below the effect of rounding on e.
_ARRAY_HALVINGS: Final = 60

#: Halvings in the scalar function, which stops once no number is left between the ends of the bracket.
#: Only e = 1, where zeta = 0, needs so many.
_SCALAR_HALVINGS: Final = 100

_Array = NDArray[np.float64]


# --- arrays ---------------------------------------------------------------------------------


def duration(zeta: ArrayLike, adhesive: bool) -> _Array:
    """Duration of an isolated impact in units of d rad (Eq. 11), of the shape of zeta >= 0.

    Infinite for an adhesive contact with zeta >= 1, which never ends.
    """
    zeta = np.asarray(zeta, dtype=np.float64)
    s = np.sqrt(np.abs((1.0 - zeta) * (1.0 + zeta)))
    with np.errstate(divide="ignore", invalid="ignore"):
        if adhesive:
            return np.asarray(np.where(zeta < 1.0, np.pi / s, np.inf))
        angle = np.where(zeta < 1.0, np.arctan2(s, zeta), np.arcsinh(s))
        return np.asarray(np.where(s > CRITICAL, 2.0 * angle / s, 2.0))


def restitution(zeta: ArrayLike, adhesive: bool) -> _Array:
    """Restitution e = exp(-zeta * duration) in [0, 1] (Eq. 12), of the shape of zeta >= 0."""
    zeta = np.asarray(zeta, dtype=np.float64)
    return np.asarray(np.exp(-zeta * duration(zeta, adhesive)))


def damping_ratio(e: ArrayLike, adhesive: bool) -> _Array:
    """The damping ratio zeta that gives restitution e in [0, 1], of its shape.

    Adhesive e = 0 is critical damping, zeta = 1. Nonadhesive e below SMALLEST is taken as SMALLEST.
    """
    e = np.asarray(e, dtype=np.float64)
    if adhesive:
        log = -np.log(np.where(e > 0.0, e, 1.0))
        return np.asarray(np.where(e > 0.0, log / np.hypot(np.pi, log), 1.0))
    e = np.asarray(np.maximum(e, SMALLEST))
    low, high = np.zeros_like(e), np.maximum(2.0, 1.0 / np.sqrt(e))
    for _ in range(_ARRAY_HALVINGS):
        middle = 0.5 * (low + high)
        too_elastic = restitution(middle, False) > e
        low, high = np.where(too_elastic, middle, low), np.where(too_elastic, high, middle)
    return np.asarray(0.5 * (low + high))


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


# --- numbers, for compiled code -------------------------------------------------------------


def nonadhesive_restitution(zeta: float) -> float:
    """Restitution of a nonadhesive impact for one damping ratio zeta >= 0."""
    if zeta < 1.0:
        s = math.sqrt((1.0 - zeta) * (1.0 + zeta))
        if s <= CRITICAL:
            return math.exp(-2.0)
        return math.exp(-zeta / s * math.atan2(2.0 * zeta * s, 2.0 * zeta * zeta - 1.0))
    s = math.sqrt((zeta - 1.0) * (zeta + 1.0))
    return math.exp(-2.0 * zeta / s * math.asinh(s)) if s > CRITICAL else math.exp(-2.0)


def scalar_damping_ratio(e: float, adhesive: bool) -> float:
    """`damping_ratio` of one restitution e in [0, 1]."""
    if adhesive:
        if e == 0.0:
            return 1.0
        log = -math.log(e)
        return log / math.hypot(math.pi, log)
    e = max(e, SMALLEST)
    low, high = 0.0, max(2.0, 1.0 / math.sqrt(e))
    for _ in range(_SCALAR_HALVINGS):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        if nonadhesive_restitution(middle) > e:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
