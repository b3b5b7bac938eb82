"""The spring in flight: its centre falls freely, its elongation rings (MODEL section 3).

The same for every model of the plate, with or without a lower mass that starts below it.
"""

import math
from typing import Final, NamedTuple

from kernel.numerics.elementary import turned
from kernel.numerics.first_root import EPS, ROOT, Terms, close_in, departure_step, first_root, terms
from kernel.numerics.jit import jit
from kernel.numerics.oscillator import SHORT, Oscillator, derivatives, displacement, envelope, motion

#: Terms of a power series smaller than this part of their sum are left out.
NEGLIGIBLE: Final = 1e-19

#: Evaluations for the end of a hop; two are the rule, and any other way to find it is as safe.
HOP_LOOKS: Final = 20


class Flight(NamedTuple):
    """The gap as a phase function, from what held at tau = 0."""

    osc: Oscillator  # the elongation's
    gravity: float  # 1/Gamma
    phi: float
    sin: float  # of phi
    cos: float
    gap: float
    gap1: float
    gap2: float
    drift: float  # the centre's velocity, gap' - sin phi + q'/2
    q: float
    q1: float


@jit
def take_off(
    osc: Oscillator, gravity: float, phi: float, gap: float, gap1: float, q: float, q1: float
) -> Flight:
    """A flight from this state."""
    sin, cos = turned(phi)
    gap2 = cos - gravity + osc.damping * q1 + 0.5 * osc.stiffness * q
    if gap == 0.0 and gap1 == 0.0 and gap2 < 0.0:
        gap2 = 0.0  # n = 0 where a stuck mass takes off; what is left is rounding
    return Flight(osc, gravity, phi, sin, cos, gap, gap1, gap2, gap1 - sin + 0.5 * q1, q, q1)


@jit
def landing(p: Flight, start: float, horizon: float, budget: int) -> tuple[float, int, int]:
    """When the gap first falls to zero after `start`: see events.first_root."""
    if start == 0.0 and p.gap == 0.0 and p.gap1 == 0.0:
        q2, q3, bound4 = derivatives(p.osc, p.q, p.q1)
        gap3 = -p.sin - 0.5 * q3
        start = departure_step(p.gap2, gap3, 1.0 + 0.5 * bound4)
        if start == 0.0:  # n' was zero as well: gap' stays positive as long as its own bound says
            q4, _, _ = derivatives(p.osc, q2, q3)
            _, _, bound5 = derivatives(p.osc, p.q1, q2)
            start = departure_step(gap3, -p.cos - 0.5 * q4, 1.0 + 0.5 * bound5)
    if p.gap <= 0.0 < p.gap1 and p.gap2 < 0.0:
        width, guess = _hop(p)
        if width < horizon and start < guess < width:
            tau, ending, used = close_in(p, start, width, guess, min(budget, HOP_LOOKS))
            if ending == ROOT:
                return tau, ending, used
    return first_root(p, start, horizon, budget)


@jit
def _hop(p: Flight) -> tuple[float, float]:
    """How long the gap, zero or below, surely rises and falls but once, being below zero at the end; and
    about when it falls to zero. 0 where that is not sure.
    """
    _, q3, bound4 = derivatives(p.osc, p.q, p.q1)
    press, gap3, gap4 = -p.gap2, -p.sin - 0.5 * q3, 1.0 + 0.5 * bound4
    width = 2.5 * p.gap1 / press
    slower = math.sqrt(max(p.gap1 * p.gap1 + 2.0 * press * p.gap, 0.0))
    if width * (abs(gap3) / 3.0 + width * gap4 / 12.0) > 0.15 * press or 2.0 * slower < p.gap1:
        return 0.0, 0.0
    guess = (p.gap1 + slower) / press
    bend = 0.5 * gap3 * guess * guess
    return width, guess + guess * bend / (3.0 * (slower - bend))


@jit
def state_after(p: Flight, tau: float) -> tuple[float, float, float, float]:
    """Gap, gap', q, q' tau rad into the flight."""
    q, q1 = motion(p.osc, p.q, p.q1, tau)
    if tau * max(p.osc.rate, 1.0) < SHORT:
        gap, gap1, _ = _short(p, tau)
        return gap, gap1, q, q1
    sin, cos = turned(p.phi + tau)
    gap = p.gap + (p.cos - cos) + p.drift * tau - 0.5 * p.gravity * tau * tau
    gap1 = sin + p.drift - p.gravity * tau - 0.5 * q1
    return gap - 0.5 * (q - p.q), gap1, q, q1


@terms.register(Flight)
@jit
def flight_terms(p: Flight, tau: float) -> Terms:
    """The gap, written so that a short flight keeps its digits."""
    sin, cos = turned(p.phi + tau)
    q, q1 = motion(p.osc, p.q, p.q1, tau)
    q2, q3, q4 = derivatives(p.osc, q, q1)
    if tau * max(p.osc.rate, 1.0) < SHORT:
        gap, gap1, noise = _short(p, tau)
        # from gap2, as the series is: what take_off called rounding must not come back here
        gap2 = p.gap2 + (cos - p.cos) - 0.5 * (q2 + 2.0 * p.osc.damping * p.q1 + p.osc.stiffness * p.q)
        gap3, bound = -sin - 0.5 * q3, 1.0 + 0.5 * q4
        return Terms(gap, gap1, gap2, gap3, bound, 0.0, 0.0, 0.0, 0.0, 0.0, math.inf, noise)
    fall = 0.5 * p.gravity * tau * tau
    smooth = p.gap + (p.cos - cos) + p.drift * tau - fall
    if tau * p.osc.rate < SHORT:
        stretch = displacement(p.osc, p.q, p.q1, tau)
        ring, amplitude, size = -0.5 * stretch, math.inf, abs(stretch)
    else:
        smooth += 0.5 * p.q
        ring, amplitude, size = -0.5 * q, 0.5 * envelope(p.osc, q, q1), abs(p.q) + abs(q)
    return Terms(
        smooth=smooth,
        smooth1=sin + p.drift - p.gravity * tau,
        smooth2=cos - p.gravity,
        smooth3=-sin,
        smooth4=1.0,
        ring=ring,
        ring1=-0.5 * q1,
        ring2=-0.5 * q2,
        ring3=-0.5 * q3,
        ring4=0.5 * q4,
        amplitude=amplitude,
        noise=2.0 * EPS * (abs(p.gap) + 2.0 + abs(p.drift) * tau + fall + size),
    )


@jit
def _short(p: Flight, tau: float) -> tuple[float, float, float]:
    """Gap, gap' and the gap's rounding by the power series, whose first terms vanish at a take-off."""
    before = -2.0 * p.osc.damping * p.q1 - p.osc.stiffness * p.q
    last = -2.0 * p.osc.damping * before - p.osc.stiffness * p.q1
    turn, turn_next = -p.sin, -p.cos  # third and fourth derivative of -cos(phi)
    power = 0.5 * tau * tau
    gap = p.gap + p.gap1 * tau + p.gap2 * power
    gap1 = p.gap1 + p.gap2 * tau
    size = abs(p.gap) + abs(p.gap1) * tau + abs(p.gap2) * power
    size1 = abs(p.gap1) + abs(p.gap2) * tau
    previous = math.inf
    for order in range(3, 17):
        derivative = turn - 0.5 * last
        gap1 += derivative * power
        size1 += abs(derivative) * power
        largest = abs(turn) + 0.5 * abs(last)
        if (largest + previous) * power <= NEGLIGIBLE * size1:
            break  # and so is the rest, for what follows is made of these two
        previous = largest
        power *= tau / order
        gap += derivative * power
        size += abs(derivative) * power
        before, last = last, -2.0 * p.osc.damping * last - p.osc.stiffness * before
        turn, turn_next = turn_next, -turn
    return gap, gap1, 4.0 * EPS * size
