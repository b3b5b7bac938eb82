"""The first moments of a soft contact: how long its ringing keeps the mass pressed, in closed form.

An impact compresses the contact within about d rad, and what ends it is the ringing's first
zero. A search by safe steps would follow that rise and fall; but between where it is known and
its next zero a free oscillation rises and falls once, so that its values at a few instants
bound all between them.
"""

import math

from kernel.models.soft_contact import Pressed
from kernel.numerics.first_root import Terms
from kernel.numerics.jit import jit
from kernel.numerics.oscillator import falling_zero, motion


@jit
def pressed_until(p: Pressed, t: Terms) -> float:
    """A time until which the phase function of contact surely stays positive; 0 where none is sure.

    `t`: its terms at the start of the contact, where it is not negative.
    """
    if t.ring + t.smooth < -t.noise or (t.ring1 <= 0.0 and t.ring <= 0.0) or (t.ring < 0.0 <= t.ring2):
        return 0.0
    end = falling_zero(p.fast_osc, t.ring, t.ring1)
    if end == math.inf:
        return 0.0
    drift = abs(t.smooth1) + end * (
        abs(t.smooth2) / 2.0 + end * (abs(t.smooth3) / 6.0 + end * t.smooth4 / 24.0)
    )
    least = t.smooth - end * drift - t.noise
    if least > 0.0 and (t.ring >= 0.0 or -t.ring > end * drift):
        return end  # the smooth part alone presses, as soon as the ringing has outrun it
    if t.ring1 > 0.0:  # rising, and concave up to its top
        top = falling_zero(p.fast_osc, t.ring1, t.ring2)
        height, _ = motion(p.fast_osc, t.ring, t.ring1, top)
        if top >= end or height <= -least or height - t.ring <= top * drift:
            return 0.0
    else:
        top = 0.0
    if least > 0.0:
        return end
    _, fall = motion(p.fast_osc, t.ring, t.ring1, end)
    end += 2.0 * least / abs(fall)
    last, _ = motion(p.fast_osc, t.ring, t.ring1, end)
    return end if end > top and last > -least else 0.0
