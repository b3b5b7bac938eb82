"""The beginning of a soft contact: a time until which the mass surely stays in contact, in closed form.

An impact compresses the contact within about d rad, and the first zero of the contact's ringing ends it. A
search by safe steps would follow that rise and fall in many steps. But between now and its next zero a free
oscillation rises and falls once, so that its values at a few instants bound all between them, and the
smooth part, which is slow, is bounded by its Taylor polynomial.
"""

import math

from kernel.models.soft_contact import LiftoffFunction
from kernel.numerics.first_root import Terms
from kernel.numerics.jit import jit
from kernel.numerics.oscillator import advance, derivative, first_falling_zero, position


@jit
def _ringing(p: LiftoffFunction, tau: float) -> tuple[float, float]:
    """The ringing part and its rate at tau."""
    return position(p.fast_osc, *advance(p.fast_osc, p.fast_a, p.fast_b, tau))


@jit
def sure_contact_time(p: LiftoffFunction, t: Terms) -> float:
    """A time (rad) until which the lift-off function surely stays positive; 0 where none is sure.

    `t`: its terms at the start of the contact, where it is not negative. Three steps: the end is the
    ringing's next zero; the smooth part's lowest value until then decides whether the end holds as it is;
    if not, it is moved back to where the ringing still outweighs that value.
    """
    if t.ring + t.smooth < -t.noise or (t.ring1 <= 0.0 and t.ring <= 0.0) or (t.ring < 0.0 <= t.ring2):
        return 0.0
    end = first_falling_zero(p.fast_osc, p.fast_a, p.fast_b)
    if end == math.inf:
        return 0.0
    slope = abs(t.smooth1) + end * (
        abs(t.smooth2) / 2.0 + end * (abs(t.smooth3) / 6.0 + end * t.smooth4 / 24.0)
    )
    lowest = t.smooth - end * slope - t.noise  # of the smooth part until `end`
    if lowest > 0.0 and (t.ring >= 0.0 or -t.ring > end * slope):
        return end  # the ringing is positive, or outgrows the smooth part's decrease before it is
    if t.ring1 > 0.0:  # rising, and concave up to its maximum
        top = first_falling_zero(p.fast_osc, *derivative(p.fast_osc, p.fast_a, p.fast_b))
        height, _ = _ringing(p, top)
        if top >= end or height <= -lowest or height - t.ring <= top * slope:
            return 0.0
    else:
        top = 0.0
    if lowest > 0.0:
        return end
    # back by twice the time in which the ringing, at its speed at the zero, falls by -lowest
    _, fall = _ringing(p, end)
    end += 2.0 * lowest / abs(fall)
    if end <= top:
        return 0.0
    last, _ = _ringing(p, end)
    return end if last > -lowest else 0.0
