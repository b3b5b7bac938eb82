"""The first zero of a phase function, guaranteed.

Conservative advancement: from where F > 0 is known with its first three derivatives
and a bound on the fourth, step no further than the first zero of a lower bound of F.
No zero can lie inside a step, however short a graze is, and near a zero the bound
touches F to third order. Where F surely falls through zero, Householder's method closes in on it.

A phase function is given as a smooth part (a parabola and the plate's sinusoid) plus
a ringing part (a damped oscillation). Where the ringing is fast but small against the
smooth part, its amplitude alone bounds it and the steps stay as wide as the plate needs.
"""

import math
from typing import Any, Final, NamedTuple

from kernel.numerics.jit import by_type, inlined, jit

#: How a search ends.
ROOT: Final = 0
HORIZON: Final = 1  # no zero before the horizon
BUDGET_EXHAUSTED: Final = 2  # the budget of evaluations ran out
NON_FINITE: Final = 3  # a number stopped being finite

#: Rounding of one operation.
EPS: Final = 2.3e-16

#: A last step is shorter than this, in rad and in times over which F changes its shape: what the
#: step's formula leaves out is then below rounding.
NEAR: Final = 3e-4

#: No step is wider than this, rad.
WIDEST: Final = 1e3


class Terms(NamedTuple):
    """A phase function at one instant: values, three derivatives, bounds from then on."""

    smooth: float
    smooth1: float
    smooth2: float
    smooth3: float
    smooth4: float  # bound on |smooth''''|
    ring: float
    ring1: float
    ring2: float
    ring3: float
    ring4: float  # bound on |ring''''|
    amplitude: float  # bound on |ring|; infinite where the parts are not told apart
    noise: float  # what rounding may have done to the value


class Phase(NamedTuple):
    """The end of one contact or flight, and the state there."""

    tau: float  # rad since it began
    ending: int  # ROOT, HORIZON, BUDGET_EXHAUSTED or NON_FINITE
    in_flight: bool  # what follows
    gap: float
    gap1: float
    q: float
    q1: float
    used: int  # evaluations


@by_type
def terms(phase: Any, tau: float) -> Terms:
    """The phase function tau rad into `phase`."""
    raise TypeError(f"no phase function for {type(phase).__name__}")


@inlined
def departure_step(f2: float, f3: float, f4: float) -> float:
    """A first step from F = F' = 0: half of where f2/2 + f3 s/6 - f4 s^2/24 reaches zero."""
    half = 2.0 * f3 / f4
    return 0.5 * (half + math.sqrt(max(half * half + 12.0 * max(f2, 0.0) / f4, 0.0)))


@jit
def safe_step(f0: float, f1: float, f2: float, f3: float, f4: float, guess: float) -> float:
    """How far f0 + f1 s + f2 s^2/2 + f3 s^3/6 - f4 s^4/24 surely stays positive, f0 >= 0, f4 >= 0.

    That is f0 + f1 s + (f2 + f3 s/3 - f4 s^2/12) s^2/2, where the bracket is concave: on [0, h]
    it is at least what it is at the ends, which leaves a parabola to solve. h is widened or
    narrowed until it is about the step it allows.
    """
    if f0 == 0.0 and f1 == 0.0:
        return departure_step(f2, f3, f4)
    h = guess
    best = 0.0
    for _ in range(8):
        curve = max((f4 * h / 12.0 - f3 / 3.0) * h, 0.0) - f2
        if curve > 0.0:
            root = math.sqrt(f1 * f1 + 2.0 * curve * f0)
            step = (f1 + root) / curve if f1 > 0.0 else 2.0 * f0 / (root - f1)
        elif f1 < 0.0:
            step = -f0 / f1
        else:
            step = h
        if step >= h:
            best = max(best, h)
            h *= 3.0
            if h > WIDEST:
                break
        else:
            best = max(best, step)
            if step > 0.5 * h or 1.5 * step <= best:
                break
            h = 1.5 * step
    return best


@jit
def monotone_width(f0: float, f1: float, f2: float, f3: float, f4: float) -> float:
    """A width over which F surely falls all the way and through zero; 0 where that is not sure."""
    if f1 >= 0.0:
        return 0.0
    width = -2.0 * f0 / f1
    steepest = f1 + width * (max(f2, 0.0) + width * (0.5 * max(f3, 0.0) + width * f4 / 6.0))
    return width if f0 + steepest * width < 0.0 else 0.0


@jit
def householder(f0: float, f1: float, f2: float, f3: float, f4: float) -> tuple[float, float]:
    """Householder's third-order step from F and its derivatives to its zero, and about what that leaves.

    f4 bounds the fourth derivative.
    """
    inverse = 1.0 / f1
    newton, bend, twist = -f0 * inverse, 0.5 * f2 * inverse, f3 * inverse / 6.0
    step = newton * (1.0 + bend * newton) / (1.0 + (2.0 * bend + twist * newton) * newton)
    astray = 5.0 * abs(bend) * (bend * bend + abs(twist)) + f4 * abs(inverse) / 24.0
    cube = abs(newton * newton * newton)
    near = abs(newton) < NEAR and cube * f4 * abs(inverse) < NEAR * NEAR * NEAR
    return step, abs(newton) * cube * astray if near else math.inf


@jit
def close_in(phase: Any, low: float, high: float, tau: float, budget: int) -> tuple[float, int, int]:
    """The only zero in [low, high], where F falls monotonically; as first_root."""
    for used in range(budget):
        t = terms(phase, tau)
        f0 = t.smooth + t.ring
        step, left = householder(
            f0, t.smooth1 + t.ring1, t.smooth2 + t.ring2, t.smooth3 + t.ring3, t.smooth4 + t.ring4
        )
        tau = min(max(tau + step, low), high)
        if left <= EPS * tau or abs(f0) <= t.noise:
            return tau, ROOT, used + 1
    return tau, BUDGET_EXHAUSTED, budget


@jit
def first_root(phase: Any, start: float, horizon: float, budget: int) -> tuple[float, int, int]:
    """First time after `start` at which the phase's function, positive just after it, falls to zero.

    Times in rad from the start of the phase. Returns
    (tau, ROOT | HORIZON | BUDGET_EXHAUSTED | NON_FINITE, evaluations used).
    """
    tau = start
    guess = 0.0
    for used in range(1, budget + 1):
        if tau >= horizon:
            return horizon, HORIZON, used
        t = terms(phase, tau)
        f0, f1 = t.smooth + t.ring, t.smooth1 + t.ring1
        f2, f3, f4 = t.smooth2 + t.ring2, t.smooth3 + t.ring3, t.smooth4 + t.ring4
        if not math.isfinite(f0 + f1 + f4):
            return tau, NON_FINITE, used
        if f0 <= max(t.noise, -f1 * 4.0 * EPS * tau) and (f1 < 0.0 or (f1 == 0.0 and f2 < 0.0)):
            # from F = F' = 0 about to fall no step could be told from none
            return max(tau - f0 / f1, start) if f1 < 0.0 else tau, ROOT, used
        f0 = max(f0, t.noise)  # or where F is all rounding, steps would vanish
        width = monotone_width(f0, f1, f2, f3, f4)
        if width > 0.0:
            step, left = householder(f0, f1, f2, f3, f4)
            if left <= EPS * tau and tau + step < horizon:
                return tau + step, ROOT, used
            tau, ending, more = close_in(phase, tau, tau + width, tau + step, budget - used)
            beyond = tau >= horizon
            return (horizon if beyond else tau), (HORIZON if beyond else ending), used + more
        if guess == 0.0:  # the time over which F can change its shape
            guess = 2.0 * max(abs(f3), math.sqrt(abs(f2) * f4)) / max(f4, EPS)
        step = safe_step(f0, f1, f2, f3, f4, guess)
        if t.ring4 > t.smooth4 and t.smooth > t.amplitude:
            step = max(
                step, safe_step(t.smooth - t.amplitude, t.smooth1, t.smooth2, t.smooth3, t.smooth4, guess)
            )
        if step == 0.0:
            return tau, ROOT, used  # it never left zero
        guess = 2.0 * step
        tau += max(step, EPS * tau)
    return tau, BUDGET_EXHAUSTED, budget
