"""The search for first roots in lanes: phase functions of many cells advanced in lockstep, one lane each.

The search is that of `first_root.first_root`, for phase functions of one form,

    F(tau) = k0 + k1 tau - k2 tau^2 + a cos(phi + tau) + b sin(phi + tau) + y,

with y a free mode of the motion, a damped oscillator: a rigid plate's normal force and the gap of a flight;
or x + y with two of them: the lift-off function of a soft contact. A mode is carried by two coordinates, in
which the underdamped and the overdamped motion have one form,

    u = e^(g tau) (u0 cos(r tau) + v0 sin(r tau))      u' = g u + r v
    v = e^(h tau) (v0 cos(r tau) - u0 sin(r tau))      v' = h v - r u

Underdamped, g = h = -damping, r is the frequency and the mode is u; overdamped, g and h are the slow and the
fast root, r = 0 and the mode is u + v, whose two amplitudes never cancel (`kernel.numerics.oscillator`). Any
derivative of it is bounded from now on by |u| + |v| of that derivative.

One call of `advance` evaluates every lane's F once and moves every lane on, without a branch, so that the
compiler turns it into vector instructions. A lane never depends on other lanes.

A lane differs from the scalar search where vector code requires it: one round of `safe_step` for each
evaluation, with the width carried on; Householder's steps without a bracket, and a cap on the evaluations.
"""

import math
from typing import Any, Final

import numpy as np

from kernel.interface import PlatePhase, State
from kernel.numerics import first_root
from kernel.numerics.elementary import LOWEST_EXPONENT, exp, fma, sincos_small
from kernel.numerics.first_root import EPS, NEAR, householder_step
from kernel.numerics.jit import inlined, jit
from kernel.numerics.oscillator import (
    NEAR_CRITICAL,
    Oscillator,
    apart,
    coordinates,
    position,
    propagate,
    propagator,
)
from kernel.params import LANES

#: Evaluations of one phase after which a lane falls back to the scalar functions. Almost
#: every search ends long before; the cap keeps one that does not from holding up its lane.
MAX_EVALUATIONS: Final = 60

#: The lowest natural frequency (1/rad) in lanes. The elongation of slower oscillators, of the order
#: 1/(Gamma w), is so large that the gap cancels; the scalar functions have power series.
SLOWEST: Final = 0.03

FIRST_WIDTH: Final = 1.5  # the first guess of a step's width: this many rad, ...
FIRST_TURN: Final = 3.0  # ... or this many over the oscillator's rate, if less; guesses affect the cost only
GROW: Final = 2.0  # after an evaluation the next width is the step times this if it filled the width, ...
KEEP: Final = 1.5  # ... and times this if not, as in `first_root.safe_step`
SHORT_FLIGHT: Final = 0.05  # rad; the scalar functions compute shorter flights: here the gap cancels to 1e-4
SHORT_START: Final = 1e-4  # rad; and those with a shorter first safe step, where the gap is near rounding
LONGEST_CONTACT: Final = 4.0 * math.pi  # rad; the scalar functions know when a longer one never ends
#: Times a mode's fastest rate: a last step for which the first terms of its power series leave only rounding.
SHORT_MOVE: Final = 1e-3
LARGEST_ANGLE: Final = 1e5  # rad up to which `sincos_small` is exact; a mode must have decayed before

#: A lane's status after `advance`.
SEARCHING: Final = 0.0
AT_ROOT: Final = 1.0  # the zero is MOVE away from TAU
AT_HORIZON: Final = 2.0
FALLBACK: Final = 3.0  # MAX_EVALUATIONS were made, or a number is not finite

# Rows of the table of lanes, each LANES wide. The phase: the plate's phase at tau = 0, the coefficients of F,
# the horizon, a bound on F's rounding error at tau = 0. The search: where it is, the width of the next step,
# 1.0 once Householder's steps are taken, evaluations, status, the last step to the zero; and sin(phi + tau),
# cos(phi + tau) of the last evaluation.
(PHI, K0, K1, K2, A, B, HORIZON, NOISE) = range(8)
(TAU, GUESS, CLOSING, COUNT, STATUS, MOVE, SIN, COS) = range(8, 16)
# Two modes, or the second alone: g, h and r of each, its coordinates at tau = 0, the part of v in it, 1 or 0,
# and of the last evaluation e^(g tau) cos(r tau) and e^(g tau) sin(r tau), or e^(h tau) where overdamped; the
# width of the next step over the smooth part; four numbers of the caller's.
(X_G, X_H, X_R, X_U, X_V, X_SUM, X_COS, X_SIN) = range(16, 24)
(Y_G, Y_H, Y_R, Y_U, Y_V, Y_SUM, Y_COS, Y_SIN) = range(24, 32)
WIDE: Final = 32
OWN: Final = 33
ROWS: Final = 37


@inlined
def index_of(k: int) -> int:
    """k >= 0, so that the compiler sees its sign: numba checks that of an index at each access."""
    return np.int64(np.uint32(k))  # type: ignore[return-value]


@inlined
def supports(osc: Oscillator) -> bool:
    """Whether lanes can compute this oscillator: all but very slow ones."""
    return osc.stiffness > SLOWEST * SLOWEST


@inlined
def serves(osc: Oscillator, end: float) -> bool:
    """Whether lanes can compute this mode up to `end` rad: not near critical damping, nor over many turns."""
    if not osc.root > NEAR_CRITICAL * osc.damping:
        return False
    decays = osc.root * -LOWEST_EXPONENT < LARGEST_ANGLE * osc.damping
    return osc.discriminant > 0.0 or osc.root * end < LARGEST_ANGLE or decays


@inlined
def load_search(table: Any, k: int, phi: float, start: float, horizon: float, guess: float) -> None:
    """Begin a search in lane k from `start` to `horizon` (rad), with a first width to try."""
    table[PHI * LANES + k] = phi
    table[HORIZON * LANES + k] = horizon
    table[TAU * LANES + k] = min(start, horizon)
    table[GUESS * LANES + k] = guess
    table[WIDE * LANES + k] = FIRST_WIDTH
    table[CLOSING * LANES + k] = 0.0
    table[COUNT * LANES + k] = 0.0


@inlined
def load_mode(table: Any, k: int, first: int, osc: Oscillator, a: float, b: float) -> None:
    """Put a mode with these coordinates (`oscillator.coordinates`) into the rows from `first`."""
    under = osc.discriminant < 0.0
    table[first * LANES + k] = -osc.damping if under else osc.slow
    table[(first + 1) * LANES + k] = -osc.damping if under else osc.fast
    table[(first + 2) * LANES + k] = osc.root if under else 0.0
    table[(first + 3) * LANES + k] = a
    table[(first + 4) * LANES + k] = (b + osc.damping * a) * osc.inverse if under else b
    table[(first + 5) * LANES + k] = 0.0 if under else 1.0


@inlined
def load_flight(
    table: Any, k: int, osc: Oscillator, gravity: float, phi: PlatePhase, state: State, start: float,
    horizon: float,
) -> None:  # fmt: skip
    """Begin the search for the landing of a flight in lane k from `start` (rad), the gap being its F."""
    gap, gap1, q, q1 = state
    load_mode(table, k, Y_G, osc, *coordinates(osc, -0.5 * q, -0.5 * q1))
    k0, k1 = gap + (phi.cos + 0.5 * q), gap1 + (0.5 * q1 - phi.sin)
    load_smooth(table, k, k0, k1, 0.5 * gravity, -1.0, 0.0, 0.5 * abs(q))
    load_search(table, k, phi.rad, start, horizon, min(FIRST_WIDTH, FIRST_TURN / osc.rate))


@inlined
def keep(table: Any, k: int, a: float, b: float, c: float, d: float) -> None:
    """Keep four numbers of the caller's beside a search with two modes, for `kept`."""
    table[OWN * LANES + k], table[(OWN + 1) * LANES + k] = a, b
    table[(OWN + 2) * LANES + k], table[(OWN + 3) * LANES + k] = c, d


@inlined
def kept(table: Any, k: int) -> tuple[float, float, float, float]:
    """The numbers of `keep`."""
    a, b = table[OWN * LANES + k], table[(OWN + 1) * LANES + k]
    return a, b, table[(OWN + 2) * LANES + k], table[(OWN + 3) * LANES + k]


@inlined
def load_smooth(table: Any, k: int, k0: float, k1: float, k2: float, a: float, b: float, size: float) -> None:
    """Set the coefficients of F without its modes; `size` bounds what else was added up for F at tau = 0."""
    table[K0 * LANES + k] = k0
    table[K1 * LANES + k] = k1
    table[K2 * LANES + k] = k2
    table[A * LANES + k] = a
    table[B * LANES + k] = b
    table[NOISE * LANES + k] = 4.0 * EPS * (abs(k0) + abs(a) + abs(b) + size)


@inlined
def search_end(table: Any, k: int) -> tuple[float, int, int]:
    """tau (rad), `first_root.ROOT` or `HORIZON`, and the evaluations of the search that ended in lane k."""
    ending = first_root.ROOT if table[STATUS * LANES + k] == AT_ROOT else first_root.HORIZON
    return table[TAU * LANES + k] + table[MOVE * LANES + k], ending, int(table[COUNT * LANES + k])


@inlined
def plate_at_end(table: Any, k: int) -> PlatePhase:
    """The plate's phase where the search in lane k ended."""
    move = table[MOVE * LANES + k]
    sin, cos = _turned(table[SIN * LANES + k], table[COS * LANES + k], move)
    return PlatePhase(table[PHI * LANES + k] + table[TAU * LANES + k] + move, sin, cos)


@inlined
def _turned(sin: float, cos: float, by: float) -> tuple[float, float]:
    """sin and cos of an angle larger by so little that the power series leaves only rounding."""
    square = by * by
    sine, versine = by * (1.0 - square * (1.0 / 6.0)), square * (0.5 - square * (1.0 / 24.0))
    return sin + cos * sine - sin * versine, cos - sin * sine - cos * versine


@inlined
def _grown(value: float, by: float) -> float:
    """value e^by, as `_turned`."""
    return value + value * by * (1.0 + by * (0.5 + by * ((1.0 / 6.0) + by * (1.0 / 24.0))))


@inlined
def propagator_at_end(table: Any, k: int, first: int, osc: Oscillator) -> tuple[float, float, float]:
    """`oscillator.propagator` of the mode in the rows from `first`, where the search in lane k ended."""
    move = table[MOVE * LANES + k]
    if osc.rate * abs(move) > SHORT_MOVE:
        return propagator(osc, table[TAU * LANES + k] + move)
    cos, sin = table[(first + 6) * LANES + k], table[(first + 7) * LANES + k]
    if apart(osc):
        return _grown(cos, osc.slow * move), _grown(sin, osc.fast * move), 0.0
    sin, cos = _turned(sin, cos, osc.root * move)
    cosine, sine = _grown(cos, -osc.damping * move), _grown(sin, -osc.damping * move) * osc.inverse
    return cosine + osc.damping * sine, sine, cosine - osc.damping * sine


@inlined
def moved(table: Any, k: int, osc: Oscillator, x: float, v: float) -> tuple[float, float]:
    """x and x' of the second mode's oscillator where the search in lane k ended, from those at its start."""
    over = propagator_at_end(table, k, Y_G, osc)
    return position(osc, *propagate(osc, *coordinates(osc, x, v), over))


@inlined
def gap_after(
    table: Any, k: int, gravity: float, tau: float, phi: PlatePhase, q: float, q1: float
) -> tuple[float, float]:
    """gap and gap' at the end of the flight in lane k, from the elongation there."""
    drift = table[K1 * LANES + k]
    gap = table[K0 * LANES + k] - phi.cos + (drift - 0.5 * gravity * tau) * tau - 0.5 * q
    return gap, phi.sin + drift - gravity * tau - 0.5 * q1


@jit
def safe_step_once(f0: float, f1: float, f2: float, f3: float, f4: float, h: float) -> float:
    """A step of at most h on which F surely stays positive: one round of `first_root.safe_step`."""
    curve = max(max(fma(f4 * (1.0 / 12.0), h, f3 * (-1.0 / 3.0)) * h, 0.0) - f2, 1e-300)
    root = math.sqrt(fma(f1, f1, 2.0 * curve * f0))
    rising = f1 > 0.0
    return min((f1 + root if rising else 2.0 * f0) / (curve if rising else root - f1), h)


@inlined
def move_on(
    table: Any, k: int, tau: float, guess: float, f0: float, f1: float, f2: float, f3: float, f4: float,
    over: float, noise: float, near: bool,
) -> float:  # fmt: skip
    """Move lane k on from tau, where F, three derivatives and the bound f4 are known.

    `over`: a step that surely passes no zero, beside that of F itself. `near`: whether Newton's step is so
    short that Householder's error estimate counts. Returns the longer safe step.
    """
    # Householder's step, and whether F surely falls through zero (first_root.monotone_width). From there on
    # the lane is `closing`: only Householder's steps are taken
    inverse = 1.0 / f1
    newton, c2, c3 = -f0 * inverse, 0.5 * f2 * inverse, f3 * inverse * (1.0 / 6.0)
    move, error = householder_step(newton, c2, c3, f4 * abs(inverse) * (1.0 / 24.0), True)
    width = 2.0 * newton
    steepest = fma(width, fma(width, fma(width, f4 * (1.0 / 6.0), 0.5 * max(f3, 0.0)), max(f2, 0.0)), f1)
    falls = (f1 < 0.0) & (f0 > 0.0) & (fma(steepest, width, f0) < 0.0)
    closing = 1.0 if falls else table[CLOSING * LANES + k]
    # a step that cannot pass a zero
    step = max(safe_step_once(max(f0, 0.0), f1, f2, f3, f4, guess), over)
    # the status
    horizon = table[HORIZON * LANES + k]
    exact = (abs(f0) <= noise) | (near & (error <= EPS * tau))
    zero = exact if closing > 0.0 else f0 <= noise
    at_root = (f1 < 0.0) & (tau + move <= horizon) & zero
    status = AT_ROOT if at_root else SEARCHING
    status = AT_HORIZON if (tau >= horizon) & (f0 > 0.0) & (not at_root) else status
    count = table[COUNT * LANES + k] + 1.0
    failed = (count > MAX_EVALUATIONS) | (not (abs(f0) + f4 < math.inf))
    status = FALLBACK if failed else status
    # the search's new state
    onward = min(tau + (move if closing > 0.0 else step), horizon)
    table[TAU * LANES + k] = onward if status == SEARCHING else tau
    table[CLOSING * LANES + k] = closing
    table[COUNT * LANES + k] = count
    table[STATUS * LANES + k] = status
    table[MOVE * LANES + k] = move if at_root else 0.0
    return step


@inlined
def _mode_terms(
    table: Any, k: int, first: int, tau: float
) -> tuple[float, float, float, float, float, float]:
    """A mode at tau, three derivatives, and bounds on the fourth and on itself from then on.

    Keeps what `propagator_at_end` needs.
    """
    sin, cos = sincos_small(table[(first + 2) * LANES + k] * tau)
    grown, other = exp(table[first * LANES + k] * tau), exp(table[(first + 1) * LANES + k] * tau)
    u, v, part = (
        table[(first + 3) * LANES + k],
        table[(first + 4) * LANES + k],
        table[(first + 5) * LANES + k],
    )
    table[(first + 6) * LANES + k] = grown * cos
    table[(first + 7) * LANES + k] = other if part > 0.0 else grown * sin
    u, v = grown * fma(u, cos, v * sin), other * fma(v, cos, -u * sin)
    u1, v1 = _mode_derivative(table, k, first, u, v)
    u2, v2 = _mode_derivative(table, k, first, u1, v1)
    u3, v3 = _mode_derivative(table, k, first, u2, v2)
    u4, v4 = _mode_derivative(table, k, first, u3, v3)
    return (
        fma(part, v, u), fma(part, v1, u1), fma(part, v2, u2), fma(part, v3, u3), abs(u4) + abs(v4),
        abs(u) + abs(v),
    )  # fmt: skip


@inlined
def _mode_derivative(table: Any, k: int, first: int, u: float, v: float) -> tuple[float, float]:
    """The coordinates of the derivative of the mode with coordinates u and v."""
    g, h, r = table[first * LANES + k], table[(first + 1) * LANES + k], table[(first + 2) * LANES + k]
    return fma(g, u, r * v), fma(h, v, -r * u)


@inlined
def advance(table: Any, used: int, both: bool) -> None:
    """Evaluate F once in the first `used` lanes and move them on; one whose phase has ended stays.

    The body is straight-line code: conditions choose between values that are both computed. `both`, a
    constant where this is called: whether F has both modes, or the second alone.
    """
    for k in range(used):
        tau = table[TAU * LANES + k]
        sin, cos = sincos_small(table[PHI * LANES + k] + tau)
        table[SIN * LANES + k] = sin
        table[COS * LANES + k] = cos
        a, b = table[A * LANES + k], table[B * LANES + k]
        k0, k1, k2 = table[K0 * LANES + k], table[K1 * LANES + k], table[K2 * LANES + k]
        wave, wave1 = fma(a, cos, b * sin), fma(b, cos, -a * sin)
        smooth, smooth1 = fma(fma(-k2, tau, k1), tau, k0) + wave, fma(-2.0 * k2, tau, k1) + wave1
        smooth2, smooth3, smooth4 = fma(-2.0, k2, -wave), -wave1, abs(a) + abs(b)
        size = 0.0
        if both:
            x, x1, x2, x3, x4, size = _mode_terms(table, k, X_G, tau)
            smooth, smooth1, smooth2, smooth3, smooth4 = (
                smooth + x, smooth1 + x1, smooth2 + x2, smooth3 + x3, smooth4 + x4
            )  # fmt: skip
        y, y1, y2, y3, y4, amplitude = _mode_terms(table, k, Y_G, tau)
        f0, f1, f2, f3, f4 = smooth + y, smooth1 + y1, smooth2 + y2, smooth3 + y3, smooth4 + y4
        clear = smooth - amplitude
        drift = fma(2.0 * EPS * tau, fma(k2, tau, abs(k1)), table[NOISE * LANES + k])
        noise = fma(4.0 * EPS, size + amplitude, drift)
        guess, wide = table[GUESS * LANES + k], table[WIDE * LANES + k]
        over = safe_step_once(max(clear, 0.0), smooth1, smooth2, smooth3, smooth4, wide)
        inverse = 1.0 / f1
        newton = abs(-f0 * inverse)
        near = (newton < NEAR) & (newton * newton * newton * f4 * abs(inverse) < NEAR * NEAR * NEAR)
        step = move_on(table, k, tau, guess, f0, f1, f2, f3, f4, over if clear > 0.0 else 0.0, noise, near)
        table[GUESS * LANES + k] = (GROW if step >= guess else KEEP) * step
        table[WIDE * LANES + k] = (GROW if over >= wide else KEEP) * over if clear > 0.0 else wide
