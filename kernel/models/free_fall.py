"""A point mass falling towards the plate: gap'' = cos(phi) - 1/Gamma (paper Eq. 3).

The gap bends upward only while cos(phi) > 1/Gamma. So a flight is a walk from one inflection
to the next, where the gap and its slope need no sine: between two of them the gap is convex or
concave, and a first zero is bracketed or excluded for certain, however short a graze is.
"""

import math
from typing import Final, NamedTuple

from kernel.modes import TWO_PI
from kernel.numerics.elementary import turned
from kernel.numerics.first_root import BUDGET_EXHAUSTED, EPS, HORIZON, ROOT, householder
from kernel.numerics.jit import jit

#: Below this many rad the gap is summed as a power series, which keeps the digits of small hops.
SHORT: Final = 0.5

#: A take-off from rest nearer than this (rad) to its closed form is it.
SNAP: Final = 4e-15

#: A search goes on from a point nearer than this part of tau by a power series about it.
NEARBY: Final = 0.25

#: How often the tangents of a dip may cross; each time leaves about the square of the gap before.
CROSSINGS: Final = 100


class Drop(NamedTuple):
    """A flight from what held at tau = 0."""

    gravity: float  # 1/Gamma
    lift: float  # the gap is convex for |phi| < lift = arccos(1/Gamma); 0 where never
    slope: float  # sin(lift)
    convex: bool  # at tau = 0
    bend: float  # tau of the first inflection
    sin: float  # of phi at tau = 0
    cos: float
    pull: float  # gap'' = cos - gravity, to more digits than these have
    gap: float
    gap1: float


class Bracket(NamedTuple):
    """Where the only zero of the gap on an interval lies: gap >= 0 at `low`, < 0 at `high`."""

    low: float
    high: float
    guess: float


class Landing(NamedTuple):
    """The end of a flight."""

    tau: float  # rad
    ending: int  # ROOT, HORIZON or BUDGET_EXHAUSTED
    gap1: float  # the rest is 0 unless the ending is ROOT
    gap2: float
    gap3: float
    used: int  # evaluations


@jit
def lifted(lift: float, phi: float) -> bool:
    """Whether the plate falls away from a mass resting on it: cos(phi) > 1/Gamma."""
    return phi < lift or phi >= TWO_PI - lift > math.pi


@jit
def takes_off(lift: float, phi: float, gap: float, gap1: float) -> bool:
    """Whether this is the take-off from rest, as near as rounding tells."""
    return gap == 0.0 and gap1 == 0.0 and lift > 0.0 and abs(phi - (TWO_PI - lift)) <= SNAP


@jit
def drop(gravity: float, lift: float, slope: float, phi: float, gap: float, gap1: float) -> Drop:
    """A flight from gap >= 0 at phi in [0, 2 pi)."""
    if takes_off(lift, phi, gap, gap1):
        return Drop(gravity, lift, slope, True, 2.0 * lift, -slope, gravity, 0.0, 0.0, 0.0)
    convex = lifted(lift, phi)
    bend = TWO_PI - lift - phi
    if convex:
        bend = lift - phi if phi < lift else TWO_PI + lift - phi
    sin, cos = turned(phi)
    return Drop(gravity, lift, slope, convex, bend, sin, cos, cos - gravity, gap, gap1)


@jit
def _lost(tau: float) -> tuple[float, float]:
    """tau - sin(tau) and tau^2/2 - 1 + cos(tau) for |tau| < SHORT."""
    t = tau * tau
    odd = 1.0 / 6.0 - t * (1.0 / 120.0 - t * (1.0 / 5040.0 - t * (1.0 / 362880.0 - t / 39916800.0)))
    even = 1.0 / 24.0 - t * (1.0 / 720.0 - t * (1.0 / 40320.0 - t * (1.0 / 3628800.0 - t / 479001600.0)))
    return tau * t * odd, t * t * even


@jit
def state_after(p: Drop, tau: float) -> tuple[float, float, float, float]:
    """Gap, gap', gap'', gap''' after tau rad."""
    if abs(tau) < SHORT:
        odd, even = _lost(tau)
        half = 0.5 * tau * tau
        sin, less = tau - odd, half - even  # 1 - cos
        gap = p.gap + tau * p.gap1 + half * p.pull - p.sin * odd - p.cos * even
        gap1 = p.gap1 + tau * p.pull - p.sin * less - p.cos * odd
        return gap, gap1, p.pull - p.sin * sin - p.cos * less, p.sin * less - p.cos * sin - p.sin
    sin, cos = turned(tau)
    drift = p.gap1 - p.sin
    gap = p.gap + tau * (drift - 0.5 * p.gravity * tau) + p.sin * sin + p.cos * (1.0 - cos)
    gap1 = drift - p.gravity * tau + p.sin * cos + p.cos * sin
    return gap, gap1, p.cos * cos - p.sin * sin - p.gravity, -(p.sin * cos + p.cos * sin)


@jit
def _noise(p: Drop, tau: float) -> float:
    """What rounding may have done to the gap after tau rad."""
    if tau < SHORT:
        return 2.0 * EPS * (p.gap + tau * (abs(p.gap1) + tau * (abs(p.pull) + tau)))
    return 2.0 * EPS * (p.gap + 2.0 + tau * (abs(p.gap1 - p.sin) + 0.5 * p.gravity * tau))


@jit
def _inflection(p: Drop, tau: float, sine: float) -> tuple[float, float]:
    """Gap and gap' where cos(phi) = 1/Gamma and sin(phi) = sine."""
    if tau < SHORT:
        gap, gap1, _, _ = state_after(p, tau)
        return gap, gap1
    drift = p.gap1 - p.sin
    gap = p.gap + p.pull + tau * (drift - 0.5 * p.gravity * tau)
    return gap, drift + sine - p.gravity * tau


@jit
def _latest(p: Drop) -> float:
    """A time by which the mass has surely landed: the plate rises by at most 2."""
    drift = p.gap1 - p.sin
    return (drift + math.sqrt(drift * drift + 2.0 * p.gravity * (p.gap + 2.5))) / p.gravity


@jit
def _dip(p: Drop, a: float, fa: float, da: float, b: float, fb: float, db: float) -> tuple[float, int]:
    """Where the gap, convex from a to b, positive at both and turning between, is below zero; else -1.

    Its tangents at a and b cross below it; the crossing replaces one of the two until it is
    above zero, or as near to it as rounding tells.
    """
    for used in range(1, CROSSINGS):
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
    return -1.0, CROSSINGS


@jit
def _guess(p: Drop, a: float, fa: float, da: float, b: float, fb: float, db: float, convex: bool) -> float:
    """Near the zero between a and b."""
    if convex and da < 0.0:
        return a - fa / da  # from above, never beyond it
    press = -p.pull
    if a == 0.0 and fa == 0.0 and press > 0.0:
        hop = 2.0 * da / press
        bent = 1.0 + p.sin * hop / (3.0 * press)
        if hop < 0.5 * b and bent > 0.5:
            return hop / bent
    if a == p.bend and p.gap == 0.0 and p.gap1 == 0.0 and p.pull == 0.0 and p.lift < 0.5:
        return 4.0 * p.slope / p.gravity  # a barely lifting plate
    width = b - a
    curve = (fa - fb + db * width) / (width * width)
    root = math.sqrt(max(db * db - 4.0 * curve * fb, 0.0))
    return b + 2.0 * fb / (root - db) if db < 0.0 else a + 0.5 * width  # a parabola's zero


@jit
def _bracket(p: Drop, horizon: float, budget: int) -> tuple[Bracket, int, int]:
    """The interval of the first landing, ROOT | HORIZON | BUDGET_EXHAUSTED, and evaluations used."""
    a, fa, da = 0.0, p.gap, p.gap1
    b, convex = p.bend, p.convex
    sine = p.slope if convex else -p.slope
    for used in range(1, budget + 1):
        if a >= horizon:
            return Bracket(a, a, a), HORIZON, used
        if p.lift == 0.0:
            b = _latest(p)
            fb, db, _, _ = state_after(p, b)
        else:
            fb, db = _inflection(p, b, sine)
        if fb < 0.0:
            return Bracket(a, b, _guess(p, a, fa, da, b, fb, db, convex)), ROOT, used
        if convex and da < 0.0 < db:
            t, more = _dip(p, a, fa, da, b, fb, db)
            if t >= 0.0:
                return Bracket(a, t, a - fa / da), ROOT, used + more
        a, fa, da = b, fb, db
        b += TWO_PI - 2.0 * p.lift if convex else 2.0 * p.lift
        convex, sine = not convex, -sine
    return Bracket(a, a, a), BUDGET_EXHAUSTED, budget


@jit
def _polish(p: Drop, bracket: Bracket, budget: int) -> Landing:
    """The zero in a bracket to rounding, by Householder's method; by halving where that leads astray."""
    low, high, tau = bracket
    if not low < tau < high:
        tau = 0.5 * (low + high)
    start, here = 0.0, p
    for used in range(1, budget + 1):
        f0, f1, f2, f3 = state_after(here, tau - start)
        step, left = householder(f0, f1, f2, f3, 1.0)
        done = f1 < 0.0 and (left <= EPS * tau or abs(f0) <= _noise(p, tau))
        if f0 > 0.0:
            low = tau
        else:
            high = tau
        if not done and not (f1 < 0.0 and low <= tau + step <= high):
            step = 0.5 * (low + high) - tau
            done = not low < tau + step < high
        if done:
            cos, half, sixth = f2 + p.gravity, 0.5 * step, step * step / 6.0
            f1 += step * (f2 + half * f3 - sixth * cos)
            f2 += step * (f3 - half * cos - sixth * f3)
            f3 -= step * (cos + half * f3 - sixth * cos)
            return Landing(min(max(tau + step, low), high), ROOT, f1, f2, f3, used)
        if abs(step) < NEARBY * tau and start == 0.0:  # no more sines
            here = Drop(p.gravity, p.lift, p.slope, p.convex, p.bend, -f3, f2 + p.gravity, f2, f0, f1)
            start = tau
        tau += step
        if abs(tau - start) > NEARBY * tau:
            start, here = 0.0, p
    return Landing(tau, BUDGET_EXHAUSTED, 0.0, 0.0, 0.0, budget)


@jit
def landing(p: Drop, horizon: float, budget: int) -> Landing:
    """The first landing before `horizon`, using at most `budget` evaluations."""
    if p.gap <= 0.0 and (p.gap1 < 0.0 or (p.gap1 == 0.0 and not p.convex)):
        return Landing(0.0, ROOT, p.gap1, p.pull, -p.sin, 1)
    bracket, ending, used = _bracket(p, horizon, budget)
    if ending != ROOT:
        return Landing(horizon, ending, 0.0, 0.0, 0.0, used)
    end = _polish(p, bracket, budget - used)
    if end.ending == ROOT and end.tau >= horizon:
        return Landing(horizon, HORIZON, 0.0, 0.0, 0.0, used + end.used)
    return Landing(end.tau, end.ending, end.gap1, end.gap2, end.gap3, used + end.used)
