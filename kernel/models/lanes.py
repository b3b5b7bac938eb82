"""Phase functions of many cells advanced in lockstep, one lane a cell.

The same search as `events.first_root`, for phase functions of one form,

    F(tau) = k0 + k1 tau - k2 tau^2 + a cos(phi + tau) + b sin(phi + tau) + p y + r y',

with y a free damped oscillator: a rigid plate's normal force and the gap of a flight are both
of it. One call of `advance` evaluates every lane's F once and moves every lane on, without a
branch, so that the compiler turns it into vector instructions. What a lane does never depends
on its neighbours.
"""

import math
from typing import Any, Final

from kernel.numerics.elementary import GENTLE, bent, exp, sincos
from kernel.numerics.first_root import EPS, NEAR
from kernel.numerics.intrinsics import fma
from kernel.numerics.jit import inlined, jit
from kernel.numerics.oscillator import NEAR_CRITICAL, Oscillator

#: Lanes: two vectors of eight doubles, so that one computes while the other waits.
LANES: Final = 16

#: Evaluations after which a lane's search is handed to `events.first_root`.
PATIENCE: Final = 60

#: A lane's status after `advance`.
SEARCHING: Final = 0.0
AT_ROOT: Final = 1.0  # the zero is MOVE away from TAU
AT_HORIZON: Final = 2.0
FALLBACK: Final = 3.0  # patience ran out, or a number stopped being finite

# Rows of the table of lanes, each LANES wide: what a phase is, ...
(PHI, DAMPING, ROOT, INVERSE, SLOW, RATE, PERIOD, UNDER, NEARLY, STIFFNESS, Y0, V0) = range(12)
(P, R, K0, K1, K2, A, B, HORIZON, NOISE) = range(12, 21)
# ... where the search for its root stands, and what F's last evaluation gave.
(TAU, GUESS, CLOSING, COUNT, STATUS, MOVE, Y, Y1, SIN, COS) = range(21, 31)
ROWS: Final = 31


@inlined
def fits(osc: Oscillator) -> bool:
    """Whether lanes can compute this oscillator: all but very slow ones."""
    return osc.rate > 0.03


@inlined
def load(
    table: Any, k: int, osc: Oscillator, phi: float, y: float, v: float, start: float, horizon: float
) -> None:
    """Begin a phase in lane k; its coefficients P to B are the caller's to set, then `settle`."""
    table[PHI * LANES + k] = phi
    table[DAMPING * LANES + k] = osc.damping
    table[ROOT * LANES + k] = osc.root
    table[INVERSE * LANES + k] = 1.0 / osc.root
    table[SLOW * LANES + k] = osc.slow
    table[RATE * LANES + k] = math.sqrt(osc.stiffness)
    table[PERIOD * LANES + k] = 1.0 / math.sqrt(osc.stiffness)
    table[UNDER * LANES + k] = 1.0 if osc.discriminant < 0.0 else 0.0
    table[NEARLY * LANES + k] = 1.0 if osc.root <= NEAR_CRITICAL * osc.damping else 0.0
    table[STIFFNESS * LANES + k] = osc.stiffness
    table[Y0 * LANES + k] = y
    table[V0 * LANES + k] = v
    table[HORIZON * LANES + k] = horizon
    table[TAU * LANES + k] = min(start, horizon)
    table[GUESS * LANES + k] = min(1.5, 3.0 / osc.rate)
    table[CLOSING * LANES + k] = 0.0
    table[COUNT * LANES + k] = 0.0


@inlined
def coefficients(
    table: Any, k: int, p: float, r: float, k0: float, k1: float, k2: float, a: float, b: float
) -> None:
    """The coefficients of lane k's phase function, and what rounding does to it at tau = 0."""
    table[P * LANES + k] = p
    table[R * LANES + k] = r
    table[K0 * LANES + k] = k0
    table[K1 * LANES + k] = k1
    table[K2 * LANES + k] = k2
    table[A * LANES + k] = a
    table[B * LANES + k] = b
    ring = abs(p * table[Y0 * LANES + k]) + abs(r * table[V0 * LANES + k])
    table[NOISE * LANES + k] = 4.0 * EPS * (abs(k0) + abs(a) + abs(b) + ring)


@jit
def _parabola(f0: float, f1: float, f2: float, f3: float, f4: float, h: float) -> float:
    """One round of events.safe_step: a step of at most h on which F stays positive."""
    curve = max(max(fma(f4 * (1.0 / 12.0), h, f3 * (-1.0 / 3.0)) * h, 0.0) - f2, 1e-300)
    root = math.sqrt(fma(f1, f1, 2.0 * curve * f0))
    rising = f1 > 0.0
    return min((f1 + root if rising else 2.0 * f0) / (curve if rising else root - f1), h)


@jit
def advance(table: Any) -> None:
    """Evaluate every lane once and move it on; a lane whose phase has ended stays, with its STATUS."""
    for k in range(LANES):
        tau = table[TAU * LANES + k]
        sin, cos = sincos(table[PHI * LANES + k] + tau)
        damping, stiffness = table[DAMPING * LANES + k], table[STIFFNESS * LANES + k]
        drag = -2.0 * damping
        root, slow, under = table[ROOT * LANES + k], table[SLOW * LANES + k], table[UNDER * LANES + k] > 0.0
        # the free oscillator, under- and overdamped alike (oscillator.response); from where it is overdamped
        # and has not turned far yet, by sinh and cosh, which need not know that root may be zero
        turned = root * tau
        gentle = (turned <= GENTLE) & (not under)
        about = under | gentle
        decay = exp((-damping if about else slow) * tau)
        lost = exp(-2.0 * turned)
        turn, turn1 = bent(turned, -1.0 if gentle else 1.0)
        fast = -(damping + root)
        scale = 0.5 * decay * table[INVERSE * LANES + k]
        sine = 2.0 * scale * turn if about else scale * (1.0 - lost)
        sine = decay * tau if turned == 0.0 else sine
        cosine = fma(decay, turn1, damping * sine) if about else scale * fma(slow, lost, -fast)
        sine1 = fma(decay, turn1, -damping * sine) if about else scale * fma(-fast, lost, slow)
        y0, v0 = table[Y0 * LANES + k], table[V0 * LANES + k]
        y = fma(y0, cosine, v0 * sine)
        y1 = fma(v0, sine1, -stiffness * sine * y0)
        y2 = fma(drag, y1, -stiffness * y)
        y3 = fma(drag, y2, -stiffness * y1)
        y4 = fma(drag, y3, -stiffness * y2)
        y5 = fma(drag, y4, -stiffness * y3)
        # F = smooth + ring with its derivatives, and bounds on the fourth and on the ring from now on
        p, r, a, b = table[P * LANES + k], table[R * LANES + k], table[A * LANES + k], table[B * LANES + k]
        k0, k1, k2 = table[K0 * LANES + k], table[K1 * LANES + k], table[K2 * LANES + k]
        rate, period = table[RATE * LANES + k], table[PERIOD * LANES + k]
        wave, wave1 = fma(a, cos, b * sin), fma(b, cos, -a * sin)
        smooth, smooth1 = fma(fma(-k2, tau, k1), tau, k0) + wave, fma(-2.0 * k2, tau, k1) + wave1
        smooth2, smooth3, smooth4 = fma(-2.0, k2, -wave), -wave1, abs(a) + abs(b)
        f0, f1 = smooth + fma(p, y, r * y1), smooth1 + fma(p, y1, r * y2)
        f2, f3 = smooth2 + fma(p, y2, r * y3), smooth3 + fma(p, y3, r * y4)
        half = 0.5 * table[INVERSE * LANES + k]
        swing, swing1 = fma(rate, abs(y3), abs(y4)), fma(rate, abs(y4), abs(y5))
        fade = half * fma(-slow, abs(fma(-fast, y3, y4)), -fast * abs(fma(slow, y3, -y4)))
        fade1 = half * fma(-slow, abs(fma(-fast, y4, y5)), -fast * abs(fma(slow, y4, -y5)))
        # for F's bound the roots apart are of use where they are apart
        whole = under | (table[NEARLY * LANES + k] > 0.0)
        f4 = fma(abs(p), swing if whole else fade, fma(abs(r), swing1 if whole else fade1, smooth4))
        ringing = fma(abs(p), fma(period, abs(y1), abs(y)), abs(r) * fma(period, abs(y2), abs(y1)))
        clear = smooth - ringing
        # where F surely falls through zero at once, Householder's step, else one that cannot miss a zero
        inverse = 1.0 / f1
        newton, bend, twist = -f0 * inverse, 0.5 * f2 * inverse, f3 * inverse * (1.0 / 6.0)
        move = newton * fma(bend, newton, 1.0) / fma(fma(twist, newton, 2.0 * bend), newton, 1.0)
        square = newton * newton
        astray = fma(5.0 * abs(bend), fma(bend, bend, abs(twist)), -f4 * inverse * (1.0 / 24.0))
        left = square * square * abs(astray)
        near = square * fma(drag, drag, stiffness + 1.0) < NEAR * NEAR
        width = 2.0 * newton
        steepest = fma(width, fma(width, fma(width, f4 * (1.0 / 6.0), 0.5 * max(f3, 0.0)), max(f2, 0.0)), f1)
        falls = (f1 < 0.0) & (f0 > 0.0) & (fma(steepest, width, f0) < 0.0)
        closing = 1.0 if falls else table[CLOSING * LANES + k]
        positive, guess = max(f0, 0.0), table[GUESS * LANES + k]
        step = _parabola(positive, f1, f2, f3, f4, guess)
        over = _parabola(max(clear, 0.0), smooth1, smooth2, smooth3, smooth4, guess)
        step = max(step, over if clear > 0.0 else 0.0)
        # how this evaluation ends
        horizon = table[HORIZON * LANES + k]
        noise = fma(2.0 * EPS * tau, fma(k2, tau, abs(k1)), table[NOISE * LANES + k])
        exact = (abs(f0) <= noise) | (near & (left <= EPS * tau))
        there = exact if closing > 0.0 else f0 <= noise
        found = (f1 < 0.0) & (tau + move <= horizon) & there
        status = AT_ROOT if found else SEARCHING
        status = AT_HORIZON if (tau >= horizon) & (f0 > 0.0) & (not found) else status
        count = table[COUNT * LANES + k] + 1.0
        lost_way = (count > PATIENCE) | (not (abs(f0) + f4 < math.inf))
        status = FALLBACK if lost_way else status
        onward = min(tau + (move if closing > 0.0 else step), horizon)
        table[TAU * LANES + k] = onward if status == SEARCHING else tau
        table[GUESS * LANES + k] = (2.0 if step >= guess else 1.5) * step
        table[CLOSING * LANES + k] = closing
        table[COUNT * LANES + k] = count
        table[STATUS * LANES + k] = status
        table[MOVE * LANES + k] = move if found else 0.0
        table[Y * LANES + k] = y
        table[Y1 * LANES + k] = y1
        table[SIN * LANES + k] = sin
        table[COS * LANES + k] = cos
