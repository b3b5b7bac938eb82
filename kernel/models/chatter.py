"""The end of a cascade: ever smaller hops on a plate that presses steadily.

A mass that leaves the plate at relative velocity v, pressed back with n, hops for 2v/n and
leaves again at e v. If n stayed as it is the rest of the cascade would take the geometric
series 2v/(n(1 - e)); if it drifts at the rate n', that times 1 - n'T/(3n), T being the series.
"""

from typing import Final

from kernel.numerics.jit import jit

#: A cascade is closed in one go once n changes over the rest of it by less than this part of
#: itself. What is left out then moves its end by less than the square of this, relatively.
STEADY: Final = 1e-3


@jit
def chatter_completes(hop: float, n: float, n1: float, n2: float, e: float) -> bool:
    """Whether the hops from velocity `hop` on may be summed up: STEADY holds, and they end on the plate.

    n > 0 presses the mass back, changing at the rate n1 per rad; n2 >= 0 bounds the rate of
    change of n1; e < 1 is the restitution. Any other n or e: no.
    """
    if n <= 0.0 or e >= 1.0:
        return False
    series = 2.0 * hop / (n * (1.0 - e))
    return series * series * (n1 * n1 + n2 * n) <= (STEADY * n) ** 2


@jit
def chatter_time(hop: float, n: float, n1: float, e: float) -> float:
    """Rad from a hop at velocity `hop` to the last of those that follow, under `chatter_completes`."""
    series = 2.0 * hop / (n * (1.0 - e))
    return series * (1.0 - n1 * series / (3.0 * n))
