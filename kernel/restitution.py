"""Isolated impacts and the ball a spring is like, for whole arrays and without numba.

What a specification must know of the contact before anything runs. `kernel.models.contact_law` says the
same to compiled code. The impact is gap'' + 2 zeta gap' + gap = 0 from gap = 0, gap' = -1,
one unit of time being d rad; it ends where the gap is zero again (`adhesive`) or where the
force is (MODEL section 2).
"""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Restitutions below this ask for a contact without end; they get the duration of this one.
SMALLEST: Final = 1e-12

_Array = NDArray[np.float64]


def duration(zeta: ArrayLike, adhesive: bool) -> _Array:
    """How long an isolated impact lasts, in units of d rad (Eq. 11); infinite if it has no end."""
    zeta = np.asarray(zeta, dtype=np.float64)
    s = np.sqrt(np.abs((1.0 - zeta) * (1.0 + zeta)))
    with np.errstate(divide="ignore", invalid="ignore"):
        if adhesive:
            return np.asarray(np.where(zeta < 1.0, np.pi / s, np.inf))
        turn = np.where(zeta < 1.0, np.arctan2(s, zeta), np.arcsinh(s))
        return np.asarray(np.where(s > 1e-7, 2.0 * turn / s, 2.0))


def restitution(zeta: ArrayLike, adhesive: bool) -> _Array:
    """Restitution for a damping ratio zeta >= 0: e = exp(-zeta * duration), under either law (Eq. 12)."""
    zeta = np.asarray(zeta, dtype=np.float64)
    return np.asarray(np.exp(-zeta * duration(zeta, adhesive)))


def damping_ratio(e: ArrayLike, adhesive: bool) -> _Array:
    """The zeta that gives restitution e in [0, 1]; adhesive e = 0 is critical damping.

    Nonadhesive e -> 0 only as zeta -> infinity: below SMALLEST it is taken as SMALLEST.
    """
    e = np.asarray(e, dtype=np.float64)
    if adhesive:
        log = -np.log(np.where(e > 0.0, e, 1.0))
        return np.asarray(np.where(e > 0.0, log / np.hypot(np.pi, log), 1.0))
    e = np.asarray(np.maximum(e, SMALLEST))
    low, high = np.zeros_like(e), np.maximum(2.0, 1.0 / np.sqrt(e))
    for _ in range(60):
        middle = 0.5 * (low + high)
        bouncy = restitution(middle, False) > e
        low, high = np.where(bouncy, middle, low), np.where(bouncy, high, middle)
    return np.asarray(0.5 * (low + high))


def contact_time(e: ArrayLike, penetration: ArrayLike, adhesive: bool) -> _Array:
    """Duration in rad of an isolated impact of restitution e on a contact of depth d (Eq. 11).

    The paper's contact is the adhesive one, whose duration grows like -d log(e) as e -> 0; for
    e below SMALLEST, where it has no end, and for the nonadhesive law, whose impact ends where
    the force does, it is d * `duration` of the damping ratio that gives max(e, SMALLEST).
    """
    e = np.maximum(np.asarray(e, dtype=np.float64), SMALLEST)
    return np.asarray(penetration, dtype=np.float64) * duration(damping_ratio(e, adhesive), adhesive)


def restitution_of(xi: ArrayLike) -> _Array:
    """Restitution epsilon = f(xi) in [0, 1/2] of the ball that a rigid spring of damping xi is like.

    Half the restitution of a nonadhesive impact at zeta = xi: the lower mass stops, the upper
    one rebounds from it, and the two share what is left (MODEL section 5; the paper leaves f open).
    """
    return 0.5 * restitution(xi, adhesive=False)
