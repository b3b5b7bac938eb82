"""A point mass falling towards the plate: gap'' = cos(phi) - 1/Gamma (paper Eq. 3).

The gap is convex only while cos(phi) > 1/Gamma, that is for |phi| < phi_lift = arccos(1/Gamma). So a flight
is searched from one inflection to the next, where the gap and its slope need no sine: between two of them
the gap is convex or concave, and its first zero is bracketed or excluded for certain, however short a graze
is. Lengths in plate amplitudes, phases and times in rad.
"""

import math
from typing import Final, NamedTuple

from kernel.numerics.elementary import TWO_PI, sincos
from kernel.numerics.first_root import BUDGET_EXHAUSTED, EPS, HORIZON, ROOT, householder, polish_step
from kernel.numerics.jit import jit

SHORT: Final = 0.5  # rad below which the gap is summed as a power series; the rest is at most 2.4e-17
TAKEOFF_TOLERANCE: Final = 4e-15  # rad from 2 pi - phi_lift of a take-off from rest: nine rounding errors
EXPANSION_REACH: Final = 0.25  # of tau, within which the gap is expanded about an iterate; exact up to 1/2
TANGENT_ROUNDS: Final = 100  # cap on the rounds of `_negative_point`, which converges quadratically
BARELY_RECEDING: Final = 0.5  # phi_lift (rad) below which the power series of a first flight gives a guess
_HIGHEST_PLATE: Final = 2.5  # the plate varies by 2; half an amplitude more is safe against rounding


class Drop(NamedTuple):
    """A flight, from its state at tau = 0."""

    gravity: float  # 1/Gamma
    phi_lift: float  # the gap is convex for |phi| < phi_lift = arccos(1/Gamma); 0 where it never is
    sin_lift: float  # sin(phi_lift)
    convex: bool  # at tau = 0
    inflection: float  # tau of the first inflection
    sin: float  # of phi at tau = 0
    cos: float
    gap2: float  # gap'' = cos - gravity, to more digits than these have
    gap: float
    gap1: float


class Landing(NamedTuple):
    """The end of a flight."""

    tau: float  # rad
    ending: int  # ROOT, HORIZON or BUDGET_EXHAUSTED
    gap1: float  # this and the next two are 0 unless the ending is ROOT
    gap2: float
    gap3: float
    used: int  # evaluations


@jit
def plate_recedes(phi_lift: float, phi: float) -> bool:
    """Whether cos(phi) > 1/Gamma, phi in [0, 2 pi): the plate accelerates away from a mass at rest on it."""
    return phi < phi_lift or phi >= TWO_PI - phi_lift > math.pi


@jit
def takes_off(phi_lift: float, phi: float, gap: float, gap1: float) -> bool:
    """Whether this state is the take-off from rest, within TAKEOFF_TOLERANCE."""
    return (
        gap == 0.0 and gap1 == 0.0 and phi_lift > 0.0 and abs(phi - (TWO_PI - phi_lift)) <= TAKEOFF_TOLERANCE
    )


@jit
def drop(gravity: float, phi_lift: float, sin_lift: float, phi: float, gap: float, gap1: float) -> Drop:
    """A flight from gap >= 0 and gap' at phi in [0, 2 pi)."""
    if takes_off(phi_lift, phi, gap, gap1):
        return Drop(gravity, phi_lift, sin_lift, True, 2.0 * phi_lift, -sin_lift, gravity, 0.0, 0.0, 0.0)
    convex = plate_recedes(phi_lift, phi)
    inflection = TWO_PI - phi_lift - phi
    if convex:
        inflection = phi_lift - phi if phi < phi_lift else TWO_PI + phi_lift - phi
    sin, cos = sincos(phi)
    return Drop(gravity, phi_lift, sin_lift, convex, inflection, sin, cos, cos - gravity, gap, gap1)


@jit
def remainders(tau: float) -> tuple[float, float]:
    """tau - sin(tau) and tau^2/2 - 1 + cos(tau) for |tau| < SHORT, by their power series."""
    t = tau * tau
    odd = 1.0 / 39916800.0 - t / 6227020800.0
    odd = 1.0 / 6.0 - t * (1.0 / 120.0 - t * (1.0 / 5040.0 - t * (1.0 / 362880.0 - t * odd)))
    even = 1.0 / 479001600.0 - t / 87178291200.0
    even = 1.0 / 24.0 - t * (1.0 / 720.0 - t * (1.0 / 40320.0 - t * (1.0 / 3628800.0 - t * even)))
    return tau * t * odd, t * t * even


@jit
def state_after(p: Drop, tau: float) -> tuple[float, float, float, float]:
    """gap, gap', gap'', gap''' at tau (rad), which may be negative if |tau| < SHORT."""
    if abs(tau) < SHORT:
        odd, even = remainders(tau)
        half = 0.5 * tau * tau
        sin, versine = tau - odd, half - even  # sin(tau) and 1 - cos(tau)
        gap = p.gap + tau * p.gap1 + half * p.gap2 - p.sin * odd - p.cos * even
        gap1 = p.gap1 + tau * p.gap2 - p.sin * versine - p.cos * odd
        return gap, gap1, p.gap2 - p.sin * sin - p.cos * versine, p.sin * versine - p.cos * sin - p.sin
    sin, cos = sincos(tau)
    drift = p.gap1 - p.sin
    gap = p.gap + tau * (drift - 0.5 * p.gravity * tau) + p.sin * sin + p.cos * (1.0 - cos)
    gap1 = drift - p.gravity * tau + p.sin * cos + p.cos * sin
    return gap, gap1, p.cos * cos - p.sin * sin - p.gravity, -(p.sin * cos + p.cos * sin)


@jit
def _noise(p: Drop, tau: float) -> float:
    """A bound on the rounding error of the gap at tau."""
    if tau < SHORT:
        return 2.0 * EPS * (p.gap + tau * (abs(p.gap1) + tau * (abs(p.gap2) + tau)))
    return 2.0 * EPS * (p.gap + 2.0 + tau * (abs(p.gap1 - p.sin) + 0.5 * p.gravity * tau))


@jit
def _at_inflection(p: Drop, tau: float, sine: float) -> tuple[float, float]:
    """gap and gap' at tau, where cos(phi) = 1/Gamma and sin(phi) = sine."""
    if tau < SHORT:
        gap, gap1, _, _ = state_after(p, tau)
        return gap, gap1
    drift = p.gap1 - p.sin
    gap = p.gap + p.gap2 + tau * (drift - 0.5 * p.gravity * tau)
    return gap, drift + sine - p.gravity * tau


@jit
def _landing_bound(p: Drop) -> float:
    """A time by which the mass has surely landed: it falls to the plate's highest position and below."""
    drift = p.gap1 - p.sin
    return (drift + math.sqrt(drift * drift + 2.0 * p.gravity * (p.gap + _HIGHEST_PLATE))) / p.gravity


@jit
def _negative_point(
    p: Drop, a: float, fa: float, da: float, b: float, fb: float, db: float
) -> tuple[float, int]:
    """A time at which the gap is negative between a and b, or -1 if there is none; and evaluations used.

    The gap is convex from a to b, positive at both (fa, fb), falling at a (da) and rising at b (db). Its
    tangents at a and b cross below it. The crossing replaces one of the two points until it lies above
    zero, so that the gap does, or until rounding leaves no point between.
    """
    for used in range(1, TANGENT_ROUNDS):
        step = (fb - fa - db * (b - a)) / (da - db)
        t = a + step
        if fa + da * step > 0.0 or not a < t < b:
            return -1.0, used
        f, d, _, _ = state_after(p, t)
        if f < 0.0:
            return t, used
        if d < 0.0:
            a, fa, da = t, f, d
        else:
            b, fb, db = t, f, d
    return -1.0, TANGENT_ROUNDS


@jit
def _guess(p: Drop, a: float, fa: float, da: float, b: float, fb: float, db: float, convex: bool) -> float:
    """A first guess of the zero between a and b, which affects the number of evaluations only.

    Newton's step from a on a convex gap, a hop from the plate to second order in its length, the first flight
    of a plate that barely recedes, or the zero of a parabola.
    """
    if convex and da < 0.0:
        return a - fa / da
    press = -p.gap2
    if a == 0.0 and fa == 0.0 and press > 0.0:
        hop = 2.0 * da / press
        correction = 1.0 + p.sin * hop / (3.0 * press)
        # the expansion in the length of the hop serves while the hop is well inside the interval
        if hop < 0.5 * b and correction > 0.5:
            return hop / correction
    from_rest = p.gap == 0.0 and p.gap1 == 0.0 and p.gap2 == 0.0
    if from_rest and a == p.inflection and p.phi_lift < BARELY_RECEDING:
        # from rest with gap = sin_lift tau^3/6 - gravity tau^4/24 to leading order
        return 4.0 * p.sin_lift / p.gravity
    width = b - a
    curve = (fa - fb + db * width) / (width * width)
    root = math.sqrt(max(db * db - 4.0 * curve * fb, 0.0))
    return b + 2.0 * fb / (root - db) if db < 0.0 else a + 0.5 * width


@jit
def _bracket(p: Drop, horizon: float, budget: int) -> tuple[tuple[float, float, float], int, int]:
    """A bracket of the first landing, ROOT | HORIZON | BUDGET_EXHAUSTED, and evaluations used.

    A bracket: low, where gap >= 0, high, where gap < 0, with one zero between, and a guess of it (rad).
    """
    a, fa, da = 0.0, p.gap, p.gap1
    b, convex = p.inflection, p.convex
    sine = p.sin_lift if convex else -p.sin_lift
    for used in range(1, budget + 1):
        if a >= horizon:
            return (a, a, a), HORIZON, used
        if p.phi_lift == 0.0:  # no inflections: concave throughout
            b = _landing_bound(p)
            fb, db, _, _ = state_after(p, b)
        else:
            fb, db = _at_inflection(p, b, sine)
        if fb < 0.0:
            return (a, b, _guess(p, a, fa, da, b, fb, db, convex)), ROOT, used
        if convex and da < 0.0 < db:
            t, more = _negative_point(p, a, fa, da, b, fb, db)
            if t >= 0.0:
                return (a, t, a - fa / da), ROOT, used + more
        a, fa, da = b, fb, db
        b += TWO_PI - 2.0 * p.phi_lift if convex else 2.0 * p.phi_lift
        convex, sine = not convex, -sine
    return (a, a, a), BUDGET_EXHAUSTED, budget


@jit
def _polish(p: Drop, bracket: tuple[float, float, float], budget: int) -> Landing:
    """The zero in a bracket to rounding: `first_root.polish_step` on the gap.

    After the first evaluation the gap is expanded about an iterate (`here`, at `origin`), without a sine.
    """
    low, high, tau = bracket
    if not low < tau < high:
        tau = 0.5 * (low + high)
    origin, here = 0.0, p
    for used in range(1, budget + 1):
        f0, f1, f2, f3 = state_after(here, tau - origin)
        step, error = householder(f0, f1, f2, f3, 1.0)
        low, high, step, done = polish_step(low, high, tau, f0, f1, step, error, _noise(p, tau))
        if done:
            cos, half, sixth = f2 + p.gravity, 0.5 * step, step * step / 6.0
            f1 += step * (f2 + half * f3 - sixth * cos)
            f2 += step * (f3 - half * cos - sixth * f3)
            f3 -= step * (cos + half * f3 - sixth * cos)
            return Landing(min(max(tau + step, low), high), ROOT, f1, f2, f3, used)
        if abs(step) < EXPANSION_REACH * tau and origin == 0.0:
            here = Drop(
                p.gravity, p.phi_lift, p.sin_lift, p.convex, p.inflection, -f3, f2 + p.gravity, f2, f0, f1
            )
            origin = tau
        tau += step
        if abs(tau - origin) > EXPANSION_REACH * tau:
            origin, here = 0.0, p
    return Landing(tau, BUDGET_EXHAUSTED, 0.0, 0.0, 0.0, budget)


@jit
def landing(p: Drop, horizon: float, budget: int) -> Landing:
    """The first landing before `horizon` (rad), using at most `budget` evaluations."""
    if p.gap <= 0.0 and (p.gap1 < 0.0 or (p.gap1 == 0.0 and not p.convex)):
        return Landing(0.0, ROOT, p.gap1, p.gap2, -p.sin, 1)
    bracket, ending, used = _bracket(p, horizon, budget)
    if ending != ROOT:
        return Landing(horizon, ending, 0.0, 0.0, 0.0, used)
    end = _polish(p, bracket, budget - used)
    if end.ending == ROOT and end.tau >= horizon:
        return Landing(horizon, HORIZON, 0.0, 0.0, 0.0, used + end.used)
    return Landing(end.tau, end.ending, end.gap1, end.gap2, end.gap3, used + end.used)
