"""The spring in flight: its centre falls freely, its elongation oscillates (docs/model.md, section 3).

The same for every contact model; the lower mass may start below the plate's surface, as after a nonadhesive
contact. Lengths in plate amplitudes, times and phases in rad.
"""

import math
from typing import Final, NamedTuple

from kernel.numerics.elementary import sincos
from kernel.numerics.first_root import EPS, ROOT, Terms, departure_step, first_root, polish, terms
from kernel.numerics.jit import inlined, jit
from kernel.numerics.oscillator import SHORT, Oscillator, derivatives, displacement, envelope, motion

NEGLIGIBLE: Final = 1e-19  # part of their sum below which terms of the power series are omitted: EPS/1000
MAX_ORDER: Final = 16  # of that series; its terms for tau * rate < 0.5 are of the order 0.5**16/16! = 7e-19

#: Evaluations for the landing of a hop before the general search takes over. Two or three are usual.
HOP_EVALUATIONS: Final = 20

HOP_SPAN: Final = 2.5  # times gap'/|gap''|, in which a landing is sought; twice under a constant gap''

#: ... and only if, over that span w, w |gap'''|/3 + w^2 |gap''''|/12 stays below this part of p = |gap''|.
#: Then gap <= v w - 0.85 p w^2/2 = (2.5 - 2.66) v^2/p < 0 at the end, v being gap', and gap'' <= -0.1 p
#: throughout, so that the gap rises and falls once.
HOP_VARIATION: Final = 0.15


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
def begin_flight(
    osc: Oscillator, gravity: float, phi: float, gap: float, gap1: float, q: float, q1: float
) -> Flight:
    """The flight from this state, with gravity = 1/Gamma and `osc` the elongation's oscillator in flight."""
    sin, cos = sincos(phi)
    gap2 = cos - gravity + osc.damping * q1 + 0.5 * osc.stiffness * q
    if gap == 0.0 and gap1 == 0.0 and gap2 < 0.0:
        gap2 = 0.0  # a take-off is where n = 0; a negative value is rounding
    return Flight(osc, gravity, phi, sin, cos, gap, gap1, gap2, gap1 - sin + 0.5 * q1, q, q1)


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
    if p.gap <= 0.0 < p.gap1 and p.gap2 < 0.0:
        width, guess = _hop_bracket(p)
        if width < horizon and start < guess < width:
            tau, ending, used = polish(p, start, width, guess, min(budget, HOP_EVALUATIONS))
            if ending == ROOT:
                return tau, ending, used
    return first_root(p, start, horizon, budget)


@jit
def _hop_bracket(p: Flight) -> tuple[float, float]:
    """A time by which a short hop has surely landed, having risen and fallen once, and a guess of when.

    (0, 0) where that is not sure: where gap'' may change too much, or where the mass, starting below the
    plate, emerges with less than half of its velocity.
    """
    _, q3, bound4 = derivatives(p.osc, p.q, p.q1)
    press, gap3, gap4 = -p.gap2, -p.sin - 0.5 * q3, 1.0 + 0.5 * bound4
    width = HOP_SPAN * p.gap1 / press
    emerging = math.sqrt(max(p.gap1 * p.gap1 + 2.0 * press * p.gap, 0.0))  # gap' where the gap is zero
    varies = width * (abs(gap3) / 3.0 + width * gap4 / 12.0) > HOP_VARIATION * press
    if varies or 2.0 * emerging < p.gap1:
        return 0.0, 0.0
    # the landing under a constant gap'', corrected by Newton's step for the cubic term
    guess = (p.gap1 + emerging) / press
    cubic = 0.5 * gap3 * guess * guess
    return width, guess + guess * cubic / (3.0 * (emerging - cubic))


@inlined
def state_after(p: Flight, tau: float) -> tuple[float, float, float, float]:
    """gap, gap', q, q' at tau."""
    q, q1 = motion(p.osc, p.q, p.q1, tau)
    if tau * max(p.osc.rate, 1.0) < SHORT:
        gap, gap1, _ = _power_series(p, tau)
        return gap, gap1, q, q1
    sin, cos = sincos(p.phi + tau)
    gap = p.gap + (p.cos - cos) + p.drift * tau - 0.5 * p.gravity * tau * tau
    gap1 = sin + p.drift - p.gravity * tau - 0.5 * q1
    return gap - 0.5 * (q - p.q), gap1, q, q1


@terms.register(Flight)
@inlined
def flight_terms(p: Flight, tau: float) -> Terms:
    """The gap as a phase function. For short times a power series keeps its digits."""
    sin, cos = sincos(p.phi + tau)
    q, q1 = motion(p.osc, p.q, p.q1, tau)
    q2, q3, q4 = derivatives(p.osc, q, q1)
    if tau * max(p.osc.rate, 1.0) < SHORT:
        gap, gap1, noise = _power_series(p, tau)
        # from gap2, as the series is: the rounding that begin_flight removed must not return here
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


@inlined
def _power_series(p: Flight, tau: float) -> tuple[float, float, float]:
    """gap, gap' and a bound on the gap's rounding error at tau, by the power series about tau = 0."""
    before = -2.0 * p.osc.damping * p.q1 - p.osc.stiffness * p.q
    last = -2.0 * p.osc.damping * before - p.osc.stiffness * p.q1
    plate, plate_next = -p.sin, -p.cos  # third and fourth derivative of -cos(phi)
    power = 0.5 * tau * tau
    gap = p.gap + p.gap1 * tau + p.gap2 * power
    gap1 = p.gap1 + p.gap2 * tau
    size = abs(p.gap) + abs(p.gap1) * tau + abs(p.gap2) * power
    size1 = abs(p.gap1) + abs(p.gap2) * tau
    previous = 0.0
    for order in range(3, MAX_ORDER + 1):
        derivative = plate - 0.5 * last
        gap1 += derivative * power
        size1 += abs(derivative) * power
        largest = abs(plate) + 0.5 * abs(last)
        if order > 3 and (largest + previous) * power <= NEGLIGIBLE * size1:
            break  # the derivatives that follow are combinations of these two
        previous = largest
        power *= tau / order
        gap += derivative * power
        size += abs(derivative) * power
        before, last = last, -2.0 * p.osc.damping * last - p.osc.stiffness * before
        plate, plate_next = plate_next, -plate
    return gap, gap1, 4.0 * EPS * size
