"""The spring in flight: its centre falls freely, its elongation oscillates (docs/model.md, section 3).

The same for every contact model; the lower mass may start below the plate's surface, as after a nonadhesive
contact. Lengths in plate amplitudes, times and phases in rad.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from kernel.interface import PlatePhase, State
from kernel.numerics.elementary import fma, sincos
from kernel.numerics.first_root import EPS, Terms, departure_step, first_root, householder, terms
from kernel.numerics.jit import inlined, jit
from kernel.numerics.oscillator import SHORT, Oscillator, derivatives, displacement, envelope, motion

#: `_soon_after` sums the power series of q in tau to this order, for tau * rate < SHORT. With |q^(4)| <= b,
#: |q^(k)| is at most 1.62 b rate^(k-4): the omitted terms are below 1.62 b tau^4 0.5**13/17! = 6e-19 b tau^4
#: in q and 1e-17 b tau^3 in q', rounding errors of the fourth order's terms. In a hop b tau^2 is at most 3
#: |gap''|, as HOP_VARIATION says, so that its end moves by less than 1e-16 of it.
SERIES_ORDER: Final = 16
#: Of the order n, at n.
_ONE_OVER: Final = np.array([math.inf, *(1.0 / n for n in range(1, SERIES_ORDER + 1))])

HOP_EVALUATIONS: Final = 2  # of the series; one is usual
HOP_GUESSES: Final = 2  # Newton's steps on the polynomial of degree 6

HOP_SPAN: Final = 2.5  # times gap'/|gap''|, in which a landing is sought; twice under a constant gap''

#: ... and only if, over that span w, w |gap'''|/3 + w^2 |gap''''|/12 stays below this part of p = |gap''|.
#: Then gap <= v w - 0.85 p w^2/2 = (2.5 - 2.66) v^2/p < 0 at the end, v being gap', and gap'' <= -0.1 p
#: throughout, so that the gap rises and falls once.
HOP_VARIATION: Final = 0.15


@jit
def remainders(tau: float) -> tuple[float, float]:
    """tau - sin(tau) and tau^2/2 - 1 + cos(tau) for |tau| < SHORT, by their power series."""
    t = tau * tau
    odd = 1.0 / 39916800.0 - t / 6227020800.0
    odd = 1.0 / 6.0 - t * (1.0 / 120.0 - t * (1.0 / 5040.0 - t * (1.0 / 362880.0 - t * odd)))
    even = 1.0 / 479001600.0 - t / 87178291200.0
    even = 1.0 / 24.0 - t * (1.0 / 720.0 - t * (1.0 / 40320.0 - t * (1.0 / 3628800.0 - t * even)))
    return tau * t * odd, t * t * even


#: Operations of the force that a take-off's time depends on, times three.
TAKEOFF_ERROR: Final = 12.0


class Flight(NamedTuple):
    """The gap as a phase function, from the state at tau = 0."""

    osc: Oscillator  # the elongation's
    gravity: float  # 1/Gamma
    phi: float
    sin: float  # of phi
    cos: float
    gap: float
    gap1: float
    gap2: float
    drift: float  # gap' - sin(phi) + q'/2: the velocity of the centre of mass
    q: float
    q1: float


@inlined
def begin_flight(osc: Oscillator, gravity: float, phi: PlatePhase, state: State) -> Flight:
    """The flight from this state, with gravity = 1/Gamma and `osc` the elongation's oscillator in flight."""
    gap, gap1, q, q1 = state
    gap2 = phi.cos - gravity + osc.damping * q1 + 0.5 * osc.stiffness * q
    if gap == 0.0 and gap1 == 0.0 and gap2 < 0.0:
        gap2 = 0.0  # a take-off is where n = 0; a negative value is rounding
    drift = gap1 - phi.sin + 0.5 * q1
    return Flight(osc, gravity, phi.rad, phi.sin, phi.cos, gap, gap1, gap2, drift, q, q1)


@jit
def landing(p: Flight, start: float, horizon: float, budget: int) -> tuple[float, int, int]:
    """The first time after `start` at which the gap falls to zero, as `first_root.first_root`."""
    if start == 0.0 and p.gap == 0.0 and p.gap1 == 0.0:
        q2, q3, bound4 = derivatives(p.osc, p.q, p.q1)
        gap3 = -p.sin - 0.5 * q3
        start = departure_step(p.gap2, gap3, 1.0 + 0.5 * bound4)
        if start == 0.0:  # n' was zero as well: gap' stays positive as long as its own bound says
            q4, _, _ = derivatives(p.osc, q2, q3)
            _, _, bound5 = derivatives(p.osc, p.q1, q2)
            start = departure_step(gap3, -p.cos - 0.5 * q4, 1.0 + 0.5 * bound5)
    return first_root(p, start, horizon, budget)


class Hop(NamedTuple):
    """The end of a short hop."""

    served: bool  # whether it was found
    tau: float
    phi: PlatePhase
    state: State
    used: int  # evaluations


@jit
def short_hop(p: Flight, lead: float, start: float, horizon: float, budget: int) -> Hop:
    """The end of a short hop: where gap + lead gap', at most zero now, is zero again.

    lead = 0 is a landing. Where HOP_VARIATION bounds its second derivative, the function rises and falls
    once, so that the zero at which it falls is the first. Newton's steps on its polynomial guess it; a power
    series of the state there and Householder's step end it to rounding, without a sine. Not served: where the
    second derivative may change too much, where the function leaves zero at less than half of its present
    rate, or where the series would be too long.
    """
    drag, pull = -2.0 * p.osc.damping, -p.osc.stiffness
    q2 = drag * p.q1 + pull * p.q
    q3 = drag * q2 + pull * p.q1
    q4 = drag * q3 + pull * q2
    q5 = drag * q4 + pull * q3
    gap3, gap4, gap5 = -p.sin - 0.5 * q3, -p.cos - 0.5 * q4, p.sin - 0.5 * q5
    f0, f1, f2, f3 = p.gap + lead * p.gap1, p.gap1 + lead * p.gap2, p.gap2 + lead * gap3, gap3 + lead * gap4
    bound4 = math.sqrt(q4 * q4 - pull * q3 * q3) + lead * math.sqrt(q5 * q5 - pull * q4 * q4)
    bound4 = 1.0 + lead + 0.5 * bound4
    leaving = f1  # the rate at which the function leaves zero
    if f0 < 0.0:
        leaving = math.sqrt(max(f1 * f1 - 2.0 * f2 * f0, 0.0))
    width = HOP_SPAN * f1 / -f2
    varies = width * (abs(f3) * (1.0 / 3.0) + width * bound4 * (1.0 / 12.0)) > HOP_VARIATION * -f2
    too_long = width * max(p.osc.rate, 1.0) > SHORT or budget < HOP_EVALUATIONS
    if not (f1 > 0.0 > f2) or varies or 2.0 * leaving < f1 or too_long:
        return Hop(False, 0.0, PlatePhase(0.0, 0.0, 0.0), State(0.0, 0.0, 0.0, 0.0), 0)
    q6 = drag * q5 + pull * q4
    gap6, gap7 = p.cos - 0.5 * q6, -p.sin - 0.5 * (drag * q6 + pull * q5)
    c2, c3, c4 = 0.5 * f2, f3 * (1.0 / 6.0), (gap4 + lead * gap5) * (1.0 / 24.0)
    c5, c6 = (gap5 + lead * gap6) * (1.0 / 120.0), (gap6 + lead * gap7) * (1.0 / 720.0)
    tau = (f1 + leaving) / -f2  # under a constant second derivative
    for _ in range(HOP_GUESSES):
        high, high1 = fma(fma(c6, tau, c5), tau, c4), fma(fma(6.0 * c6, tau, 5.0 * c5), tau, 4.0 * c4)
        value = fma(fma(fma(fma(high, tau, c3), tau, c2), tau, f1), tau, f0)
        tau -= value / fma(fma(fma(high1, tau, 3.0 * c3), tau, 2.0 * c2), tau, f1)
    for used in range(1, HOP_EVALUATIONS + 1):
        sin, cos, gap, gap1, q, q1 = _soon_after(p, q2, q3, tau)
        second = drag * q1 + pull * q
        third = drag * second + pull * q1
        fourth = drag * third + pull * second
        gap2, gap3, gap4 = cos - p.gravity - 0.5 * second, -sin - 0.5 * third, -cos - 0.5 * fourth
        falling = gap1 + lead * gap2
        step, error = householder(gap + lead * gap1, falling, gap2 + lead * gap3, gap3 + lead * gap4, bound4)
        tau += step
        if error <= EPS * tau:
            # by Taylor series in the step, which is below first_root.NEAR, so that the rest is rounding
            half, part = 0.5 * step, step * (1.0 / 3.0)
            gap += step * (gap1 + half * (gap2 + part * (gap3 + 0.25 * step * gap4)))
            gap1 += step * (gap2 + half * (gap3 + part * gap4))
            q += step * (q1 + half * (second + part * (third + 0.25 * step * fourth)))
            q1 += step * (second + half * (third + part * fourth))
            sine, versine = step * (1.0 - step * step * (1.0 / 6.0)), half * step
            sin, cos = sin + cos * sine - sin * versine, cos - sin * sine - cos * versine
            served = start < tau < min(width, horizon) and falling < 0.0
            return Hop(served, tau, PlatePhase(p.phi + tau, sin, cos), State(gap, gap1, q, q1), used)
    return Hop(False, 0.0, PlatePhase(0.0, 0.0, 0.0), State(0.0, 0.0, 0.0, 0.0), HOP_EVALUATIONS)


@inlined
def _soon_after(
    p: Flight, q2: float, q3: float, tau: float
) -> tuple[float, float, float, float, float, float]:
    """sin and cos of the plate's phase, gap, gap', q and q' at tau by power series, from q'' and q'''."""
    drag, pull = -2.0 * p.osc.damping, -p.osc.stiffness
    odd, even = remainders(tau)
    half = 0.5 * tau * tau
    sine, versine = tau - odd, half - even
    # q and q' without the terms that gap'' has
    before, last, power = q2, q3, half
    rest, rest1 = 0.0, 0.0
    for order in range(3, SERIES_ORDER + 1):
        rest1 = fma(last, power, rest1)
        power *= tau * _ONE_OVER[order]
        rest = fma(last, power, rest)
        before, last = last, fma(drag, last, pull * before)
    gap = p.gap + tau * p.gap1 + half * p.gap2 - (p.sin * odd + p.cos * even + 0.5 * rest)
    gap1 = p.gap1 + tau * p.gap2 - (p.sin * versine + p.cos * odd + 0.5 * rest1)
    q, q1 = p.q + (tau * p.q1 + half * q2 + rest), p.q1 + (tau * q2 + rest1)
    sin, cos = p.sin + (p.cos * sine - p.sin * versine), p.cos - (p.sin * sine + p.cos * versine)
    return sin, cos, gap, gap1, q, q1


@inlined
def state_after(p: Flight, tau: float) -> State:
    """The state at tau."""
    if tau * max(p.osc.rate, 1.0) < SHORT:
        q2, q3, _ = derivatives(p.osc, p.q, p.q1)
        _, _, gap, gap1, q, q1 = _soon_after(p, q2, q3, tau)
        return State(gap, gap1, q, q1)
    q, q1 = motion(p.osc, p.q, p.q1, tau)
    sin, cos = sincos(p.phi + tau)
    gap = p.gap + (p.cos - cos) + p.drift * tau - 0.5 * p.gravity * tau * tau
    gap1 = sin + p.drift - p.gravity * tau - 0.5 * q1
    return State(gap - 0.5 * (q - p.q), gap1, q, q1)


@terms.register(Flight)
@inlined
def flight_terms(p: Flight, tau: float) -> Terms:
    """The gap as a phase function. For short times a power series keeps its digits."""
    if tau * max(p.osc.rate, 1.0) < SHORT:
        q2, q3, q4 = derivatives(p.osc, p.q, p.q1)
        # the sizes of the first terms; later ones are small against the larger of the last two
        third, fourth = abs(p.sin) + 0.5 * abs(q3), 1.0 + 0.5 * q4
        size = abs(p.gap2) + tau * (third * (1.0 / 3.0) + tau * fourth * (1.0 / 12.0))
        noise = 4.0 * EPS * (abs(p.gap) + tau * (abs(p.gap1) + 0.5 * tau * size))
        sin, cos, gap, gap1, q, q1 = _soon_after(p, q2, q3, tau)
        q2, q3, q4 = derivatives(p.osc, q, q1)
        # from gap2, as the series is: the rounding that begin_flight removed must not return here
        gap2 = p.gap2 + (cos - p.cos) - 0.5 * (q2 + 2.0 * p.osc.damping * p.q1 + p.osc.stiffness * p.q)
        gap3, bound = -sin - 0.5 * q3, 1.0 + 0.5 * q4
        return Terms(gap, gap1, gap2, gap3, bound, 0.0, 0.0, 0.0, 0.0, 0.0, math.inf, noise)
    sin, cos = sincos(p.phi + tau)
    q, q1 = motion(p.osc, p.q, p.q1, tau)
    q2, q3, q4 = derivatives(p.osc, q, q1)
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
def landing_error(p: Flight, tau: float) -> float:
    """How far rounding may move the landing at tau, in rad: far for a touch, where the gap's rate is small.

    Includes the error of the take-off, which is large if the force, minus the gap's second derivative, falls
    through zero slowly. A delay of the take-off makes the flight longer by three times as much.
    """
    f = flight_terms(p, tau)
    rate = abs(f.smooth1 + f.ring1)
    error = f.noise / rate if rate > 0.0 else math.inf
    if p.gap == 0.0 and p.gap1 == 0.0:
        _, q3, _ = derivatives(p.osc, p.q, p.q1)
        noise = p.gravity + 1.0 + abs(p.osc.damping * p.q1) + 0.5 * abs(p.osc.stiffness * p.q)
        error += TAKEOFF_ERROR * EPS * noise / abs(p.sin + 0.5 * q3)
    return error
