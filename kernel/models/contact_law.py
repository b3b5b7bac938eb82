"""The spring-dashpot contact's two laws: where it ends, what an isolated impact gives back (MODEL section 2).

gap'' + 2 zeta gap' + gap = 0 from gap = 0, gap' = -1: `adhesive` leaves where the gap is zero
again, `nonadhesive` where the force is.
"""

import math
from typing import Final

from kernel.numerics.jit import inlined, jit

#: Restitutions below this ask for a damping without meaning; they get its damping.
SMALLEST: Final = 1e-12


@inlined
def lets_go(gap: float, gap1: float, kappa: float, beta: float) -> bool:
    """Whether the plate does not bear a mass in this state; beta is 0 where the contact may pull."""
    if gap > 0.0 or (gap == 0.0 and gap1 >= 0.0):
        return True
    return beta > 0.0 and kappa * gap + beta * gap1 >= 0.0


@jit
def restitution(zeta: float, adhesive: bool) -> float:
    """Restitution for a damping ratio zeta >= 0. Adhesive contacts (Eq. 12) do not rebound at zeta >= 1."""
    if adhesive:
        return math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta * zeta)) if zeta < 1.0 else 0.0
    if zeta < 1.0:
        s = math.sqrt((1.0 - zeta) * (1.0 + zeta))
        return (
            math.exp(-zeta / s * math.atan2(2.0 * zeta * s, 2.0 * zeta * zeta - 1.0))
            if s > 1e-7
            else math.exp(-2.0)
        )
    s = math.sqrt((zeta - 1.0) * (zeta + 1.0))
    return math.exp(-2.0 * zeta / s * math.asinh(s)) if s > 1e-7 else math.exp(-2.0)


@jit
def damping_ratio(e: float, adhesive: bool) -> float:
    """The zeta that gives restitution e in [0, 1]; adhesive e = 0 is critical damping.

    Nonadhesive e -> 0 only as zeta -> infinity: below SMALLEST it is taken as SMALLEST.
    """
    if adhesive:
        if e == 0.0:
            return 1.0
        log = -math.log(e)
        return log / math.hypot(math.pi, log)
    e = max(e, SMALLEST)
    low, high = 0.0, max(2.0, 1.0 / math.sqrt(e))
    for _ in range(100):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        if restitution(middle, False) > e:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
