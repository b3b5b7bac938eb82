"""The first zero of a phase function, guaranteed: no zero is stepped over, however short a graze.

A contact or flight ends at the first zero of a *phase function* F(tau), positive after tau = 0: the
normal force in contact, the gap in flight. `first_root` finds it by conservative advancement. Where F,
three derivatives and a bound on the fourth are known, it steps no further than the first zero of a
lower bound of F (`safe_step`), so no zero lies inside a step. Near a zero the bound touches F to third
order. Once F surely falls through zero (`monotone_width`), `polish` closes in on it.

F is given as a smooth part (a parabola and the plate's sinusoid) plus a ringing part (a damped
oscillation). Where the ringing is fast but small against the smooth part, its amplitude alone bounds
it, and the steps are as wide as the smooth part allows.
"""

import math
from typing import Any, Final, NamedTuple

from kernel.numerics.elementary import multiply_add
from kernel.numerics.jit import by_type, inlined, jit

#: How a search ends.
ROOT: Final = 0
HORIZON: Final = 1  # no zero before the horizon
BUDGET_EXHAUSTED: Final = 2  # the budget of evaluations ran out
NON_FINITE: Final = 3  # a number stopped being finite
EPS: Final = 2.3e-16  # bound on the relative rounding error of one operation, 2**-52 rounded up

#: Householder's error estimate counts for Newton steps below this, in rad and in units of the time over which
#: F changes its shape. It omits the fifth order, (3e-4)**5 = 2.4e-18, a hundredth of EPS.
NEAR: Final = 3e-4

WIDEST: Final = 1e3  # rad, some 160 plate periods: no wider step is tried

#: In `householder_step`, the weight of the known part of the error. The step agrees with the series of
#: the zero in powers of N up to N**3; at N**4 they differ by 2 c2 c3 - c2**3 - c4, whose first two terms
#: are at most 2 |c2| (c2**2 + |c3|). 5, the largest coefficient of either series there, leaves a factor
#: of 2.5 for the higher orders.
HOUSEHOLDER_WEIGHT: Final = 5.0

#: How `safe_step` finds the width h over which its parabola is built. Any h gives a safe step, so these set
#: the cost only, and were chosen by trial. A step that fills h is tried again with h WIDEN times as wide; one
#: of less than half of h with h = NARROW steps, unless that cannot improve the best step so far.
WIDEN: Final = 3.0
NARROW: Final = 1.5
SAFE_STEP_ROUNDS: Final = 8


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
    amplitude: float  # bound on |ring|; infinite where the parts are not separated
    noise: float  # bound on the rounding error of the value


@by_type
def terms(phase: Any, tau: float) -> Terms:  # type: ignore[empty-body]
    """The phase function `tau` rad into `phase`."""


@inlined
def departure_step(f2: float, f3: float, f4: float) -> float:
    """A first step (rad) from F = F' = 0, where a search from zero would not move.

    Half of where the lower bound f2/2 + f3 s/6 - f4 s^2/24 of F/s^2 reaches zero, so that F is positive
    all the way and clearly so at its end. f4 > 0 bounds |F''''|; a negative f2 counts as zero.
    """
    half = 2.0 * f3 / f4
    return 0.5 * (half + math.sqrt(max(half * half + 12.0 * max(f2, 0.0) / f4, 0.0)))


@inlined
def safe_step(f0: float, f1: float, f2: float, f3: float, f4: float, guess: float) -> float:
    """How far (rad) f0 + f1 s + f2 s^2/2 + f3 s^3/6 - f4 s^4/24 surely stays positive; f0, f4 >= 0.

    The polynomial is f0 + f1 s + (f2 + f3 s/3 - f4 s^2/12) s^2/2, where the parenthesis is concave: on
    [0, h] it is at least the smaller of its values at the ends. That leaves a parabola, whose zero is
    in closed form. h starts at `guess` and follows the step it allows: see WIDEN.
    """
    if f0 == 0.0 and f1 == 0.0:
        return departure_step(f2, f3, f4)
    h = guess
    best = 0.0
    for _ in range(SAFE_STEP_ROUNDS):
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
            h *= WIDEN
            if h > WIDEST:
                break
        else:
            best = max(best, step)
            if step > 0.5 * h or NARROW * step <= best:
                break
            h = NARROW * step
    return best


@jit
def monotone_width(f0: float, f1: float, f2: float, f3: float, f4: float) -> float:
    """A width (rad) over which F surely falls all the way and through zero; 0 where that is not sure.

    Twice Newton's step -f0/f1, if F' is bounded over it by a negative slope that takes F below zero.
    """
    if f1 >= 0.0:
        return 0.0
    width = -2.0 * f0 / f1
    steepest = f1 + width * (max(f2, 0.0) + width * (0.5 * max(f3, 0.0) + width * f4 / 6.0))
    return width if f0 + steepest * width < 0.0 else 0.0


@inlined
def householder_step(newton: float, c2: float, c3: float, c4: float, fused: bool) -> tuple[float, float]:
    """Householder's third-order step to a zero of F (rad), and a bound on its error for small `newton`.

    newton = -f0/f1, c2 = f2/(2 f1), c3 = f3/(6 f1), and c4 >= 0 bounds |f4/(24 f1)|. With N = newton the
    zero solves N = s + c2 s^2 + c3 s^3 + c4 s^4, and the step is N (1 + c2 N)/(1 + 2 c2 N + c3 N^2).
    `fused`, a constant where this is called, chooses fused multiply-adds, as lanes use them.
    """
    numerator = multiply_add(c2, newton, 1.0, fused)
    denominator = multiply_add(multiply_add(c3, newton, 2.0 * c2, fused), newton, 1.0, fused)
    square = newton * newton
    known = HOUSEHOLDER_WEIGHT * abs(c2) * multiply_add(c2, c2, abs(c3), fused)
    return newton * numerator / denominator, square * square * (known + c4)


@jit
def householder(f0: float, f1: float, f2: float, f3: float, f4: float) -> tuple[float, float]:
    """`householder_step` from F and its derivatives; the error is infinite for steps that are not NEAR."""
    inverse = 1.0 / f1
    newton = -f0 * inverse
    rate4 = f4 * abs(inverse)
    step, error = householder_step(newton, 0.5 * f2 * inverse, f3 * inverse / 6.0, rate4 / 24.0, False)
    cube = abs(newton * newton * newton)
    near = abs(newton) < NEAR and cube * rate4 < NEAR * NEAR * NEAR
    return step, error if near else math.inf


@inlined
def polish(phase: Any, low: float, high: float, tau: float, budget: int) -> tuple[float, int, int]:
    """The zero in [low, high] where F falls from positive to negative, from a first guess `tau`.

    Householder's step is taken if F falls at tau and it stays in the bracket; otherwise that is halved, so
    that the search ends whatever F does: where the error is rounding, or no number is left between the ends.
    Times in rad from the start of the phase. Returns (tau, ROOT, evaluations used), or NON_FINITE or,
    after `budget` evaluations, BUDGET_EXHAUSTED in ROOT's place. Two or three evaluations are usual.
    """
    for used in range(1, budget + 1):
        t = terms(phase, tau)
        f0, f1 = t.smooth + t.ring, t.smooth1 + t.ring1
        if not math.isfinite(f0):
            return tau, NON_FINITE, used
        step, error = householder(f0, f1, t.smooth2 + t.ring2, t.smooth3 + t.ring3, t.smooth4 + t.ring4)
        done = f1 < 0.0 and (error <= EPS * (tau + step) or abs(f0) <= t.noise)
        if f0 > 0.0:
            low = tau
        else:
            high = tau
        if not done and not (f1 < 0.0 and low <= tau + step <= high):
            step = 0.5 * (low + high) - tau
            done = not low < tau + step < high
        tau = min(max(tau + step, low), high)
        if done:
            return tau, ROOT, used
    return tau, BUDGET_EXHAUSTED, budget


@jit
def first_root(phase: Any, start: float, horizon: float, budget: int) -> tuple[float, int, int]:
    """The first time after `start` at which F, positive just after it, falls to zero.

    Times in rad from the start of the phase. Returns
    (tau, ROOT | HORIZON | BUDGET_EXHAUSTED | NON_FINITE, evaluations used). An F that never leaves zero
    has its root at `start`.
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
        # zero to rounding, of F itself or of tau, and falling
        if f0 <= max(t.noise, -f1 * 4.0 * EPS * tau) and (f1 < 0.0 or (f1 == 0.0 and f2 < 0.0)):
            # from F = F' = 0 about to fall no step could be told from none
            return max(tau - f0 / f1, start) if f1 < 0.0 else tau, ROOT, used
        f0 = max(f0, t.noise)  # where F is all rounding, steps would vanish
        width = monotone_width(f0, f1, f2, f3, f4)
        if width > 0.0:
            step, error = householder(f0, f1, f2, f3, f4)
            if error <= EPS * tau and tau + step < horizon:
                return tau + step, ROOT, used
            tau, ending, more = polish(phase, tau, tau + width, tau + step, budget - used)
            beyond = tau >= horizon
            return (horizon if beyond else tau), (HORIZON if beyond else ending), used + more
        if guess == 0.0:  # about the time over which F changes its shape: where f2 or f3 balances f4
            guess = 2.0 * max(abs(f3), math.sqrt(abs(f2) * f4)) / max(f4, EPS)
        if guess == 0.0:  # F'' = F''' = 0: where F itself balances f4
            guess = math.sqrt(math.sqrt(f0 / max(f4, EPS)))
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
