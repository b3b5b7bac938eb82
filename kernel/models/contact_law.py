"""Contacts that models share: the spring-dashpot of `soft` and `stepped`, the chatter of `rigid` and `ball`.

Spring and dashpot (paper Eqs. 9 to 12; docs/model.md, section 2): with stiffness kappa = 1/d^2 and damping
beta = 2 zeta/d the plate pushes the lower mass with n = -(kappa gap + beta gap'), in m A omega^2. An adhesive
contact lasts while gap < 0 and may pull; a nonadhesive one while also n > 0.

Chatter is the infinite series of ever smaller hops by which a mass comes to rest on the plate. One that
leaves it at relative velocity v and is pressed back with n hops for 2 v/n and leaves again at e v. If n were
constant, the rest of the series would take the geometric sum T = 2 v/(n (1 - e)); if n changes at the rate
n', it takes T (1 - n' T/(3 n)) to first order. The gap's integral over it, likewise, is A (1 - L n'/n) with
A = 2 v^3/(3 n^2 (1 - e^3)) and L = T (1 - e + e^2)/(2 (1 + e^2)), and the integral of gap times time is A L.
"""

from typing import Final

from kernel.numerics.jit import compilable, inlined, jit
from kernel.restitution import nonadhesive_duration, scalar_damping_ratio, strong_damping_ratio

STEADY: Final = 1e-2  # part of n that chatter which is summed may change; its sums are exact to the square

compilable(nonadhesive_duration)
compilable(scalar_damping_ratio)
compilable(strong_damping_ratio)


@inlined
def contact_constants(d: float, zeta: float) -> tuple[float, float]:
    """kappa and beta for penetration d > 0 (plate amplitudes) and damping ratio zeta."""
    return 1.0 / (d * d), 2.0 * zeta / d


@inlined
def plate_force(kappa: float, beta: float, gap: float, gap1: float) -> float:
    """n of a mass in contact at this gap and gap'."""
    return -(kappa * gap + beta * gap1)


@inlined
def lifted_off(gap: float, gap1: float, kappa: float, beta: float) -> bool:
    """Whether a mass with this gap and gap' is not in contact; beta = 0 for the adhesive law."""
    if gap > 0.0 or (gap == 0.0 and gap1 >= 0.0):
        return True
    return beta > 0.0 and kappa * gap + beta * gap1 >= 0.0


@inlined
def static_state(gamma: float, stiffness: float, kappa: float) -> tuple[float, float]:
    """Gap and elongation, both < 0, of a spring at rest on a plate that does not move."""
    return -2.0 / (gamma * kappa), -1.0 / (gamma * stiffness)


@jit
def chatter_completes(hop: float, n: float, n1: float, n2: float, e: float) -> bool:
    """Whether the hops from velocity `hop` >= 0 on may be summed: n is STEADY, and they end on the plate.

    n > 0 is the force that presses the mass back, n1 its rate of change per rad, n2 >= 0 a bound on the rate
    of change of n1, e < 1 the restitution. False for any other n or e.
    """
    if n <= 0.0 or e >= 1.0:
        return False
    series = 2.0 * hop / (n * (1.0 - e))
    return series * series * (n1 * n1 + n2 * n) <= (STEADY * n) * (STEADY * n)


@jit
def chatter_time(hop: float, n: float, n1: float, e: float) -> float:
    """Rad from a hop at velocity `hop` to the end of the series, where `chatter_completes` holds."""
    series = 2.0 * hop / (n * (1.0 - e))
    return series * (1.0 - n1 * series / (3.0 * n))


@jit
def chatter_lift(hop: float, n: float, n1: float, e: float) -> tuple[float, float]:
    """Integrals of the gap, and of the gap times the time since `hop`, where `chatter_completes` holds."""
    area = 2.0 * hop * hop * hop / (3.0 * n * n * (1.0 - e * e * e))
    centre = hop / (n * (1.0 - e)) * (1.0 - e + e * e) / (1.0 + e * e)
    return area * (1.0 - centre * n1 / n), area * centre


@jit
def chatter_lift_variation(
    hop: float, n: float, n1: float, e: float, dhop: float, dn: float, dn1: float
) -> tuple[float, float]:
    """The variations of both integrals of `chatter_lift` with small changes of hop > 0, n and n1."""
    area, moment = chatter_lift(hop, n, 0.0, e)
    by_hop, by_n, slope = dhop / hop, dn / n, moment / n
    d_area = area * (3.0 * by_hop - 2.0 * by_n) - slope * (4.0 * n1 * (by_hop - by_n) + dn1)
    return d_area, moment * (4.0 * by_hop - 3.0 * by_n)


@inlined
def chatter_push(b: float, w: float, area: float, moment: float) -> tuple[float, float]:
    """Changes of q and q' of a stuck spring with dashpot b and stiffness w by both integrals of the gap."""
    return b * area - (w - b * b) * moment, (w - b * b) * area + b * (2.0 * w - b * b) * moment
