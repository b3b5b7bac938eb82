"""Chatter: the infinite series of ever smaller hops by which a mass comes to rest on the plate.

A mass that leaves the plate at relative velocity v and is pressed back with n hops for 2 v/n and leaves
again at e v. If n were constant, the rest of the series would take the geometric sum T = 2 v/(n (1 - e));
if n changes at the rate n', it takes T (1 - n' T/(3 n)) to first order.
"""

from typing import Final

from kernel.numerics.jit import jit

#: The rest of a series of hops is summed once n changes over it by less than this part of itself. The
#: formula then places its end with a relative error of the order of the square, 1e-6 of a span of about
#: 1e-3 rad or less.
STEADY: Final = 1e-3


@jit
def chatter_completes(hop: float, n: float, n1: float, n2: float, e: float) -> bool:
    """Whether the hops from velocity `hop` >= 0 on may be summed: n is STEADY, and they end on the plate.

    n > 0 is the force that presses the mass back, n1 its rate of change per rad, n2 >= 0 a bound on the rate
    of change of n1, e < 1 the restitution. False for any other n or e.
    """
    if n <= 0.0 or e >= 1.0:
        return False
    series = 2.0 * hop / (n * (1.0 - e))
    return series * series * (n1 * n1 + n2 * n) <= (STEADY * n) ** 2


@jit
def chatter_time(hop: float, n: float, n1: float, e: float) -> float:
    """Rad from a hop at velocity `hop` to the end of the series, where `chatter_completes` holds."""
    series = 2.0 * hop / (n * (1.0 - e))
    return series * (1.0 - n1 * series / (3.0 * n))
