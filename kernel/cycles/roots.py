"""All roots of several smooth functions on a grid, by Newton's method inside brackets.

The grid must resolve the functions, as `events.flight_times` does: between neighbours each is a cubic to
about 1e-5 of its size. A pair of roots between neighbours then shows as an extremum of that cubic near zero.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]

#: x (m,) -> values (f, m), slopes (f, m) of f functions.
Functions = Callable[[Floats], tuple[Floats, Floats]]

#: Limit on Newton steps. Halving alone shrinks an interval of the grid below rounding in 50.
_STEPS: Final = 80

#: Steps below this part of x are rounding.
_ROUNDING: Final = 4e-16

#: An extremum may hide a pair of roots if its cubic is below this part of the values beside it. This is far
#: above the error of the cubic, so that no pair is missed.
_NEAR: Final = 0.05

#: Steps of the search for an extremum. The slope is nearly linear there, and six steps reach rounding.
_EXTREMUM_STEPS: Final = 8

#: A sign change is a root if the function falls below this part of its values beside it,
_SMALL: Final = 1e-6

#: and a pole if it grows above this multiple of them.
_LARGE: Final = 1e3


class Roots(NamedTuple):
    """m roots, sorted by function and then by x: the function's index, and where it is zero."""

    which: Ints  # (m,)
    x: Floats  # (m,)


def roots(functions: Functions, x: Floats, value: Floats, slope: Floats) -> Roots:
    """The roots of f functions between the ends of x.

    x (n,) increasing; value, slope (f, n) on it; `functions` evaluates them anywhere.
    """
    change = np.sign(value[:, :-1]) * np.sign(value[:, 1:]) < 0.0
    which, index = np.nonzero(change)
    others, pairs = _pairs(functions, x, value, slope, change)
    ends = [x[index], x[index + 1], value[which, index], value[which, index + 1]]
    which, brackets = np.concatenate([which, others]), np.hstack([ends, pairs])
    if not len(which):
        return Roots(np.empty(0, np.intp), np.empty(0))
    root, error = _solve(functions, which, *brackets)
    with np.errstate(invalid="ignore"):
        keep = np.abs(error) <= _SMALL * np.abs(brackets[2:]).max(axis=0)
    which, root = which[keep], root[keep]
    order = np.lexsort((root, which))
    return Roots(which[order], root[order])


def _pairs(
    functions: Functions, x: Floats, value: Floats, slope: Floats, change: NDArray[np.bool_]
) -> tuple[Ints, Floats]:
    """Brackets of pairs of roots: indices of functions (m,), and both ends and values (4, m).

    change (f, n - 1): intervals with a sign change, which are left out.
    """
    left, right = value[:, :-1] * slope[:, :-1] < 0.0, value[:, 1:] * slope[:, 1:] > 0.0
    which, index = np.nonzero(~change & left & right)
    a, b = x[index], x[index + 1]
    y, z = value[which, index], value[which, index + 1]
    dy, dz = slope[which, index] * (b - a), slope[which, index + 1] * (b - a)
    _, extremum = cubic_extremum(y, z, dy, dz, np.sign(y))
    near = extremum * np.sign(y) < _NEAR * np.minimum(np.abs(y), np.abs(z))
    which = which[near]
    a, b, y, z, dy, dz = (v[near] for v in (a, b, y, z, dy, dz))
    if not len(which):
        return which, np.array([a, b, y, z])
    low, high, s_low, s_high = a.copy(), b.copy(), dy, dz
    with np.errstate(invalid="ignore", divide="ignore"):
        middle = a + (b - a) * cubic_extremum(y, z, dy, dz, np.sign(y))[0]
        for _ in range(_EXTREMUM_STEPS):
            f, s = _selected(functions, which, middle)
            left_side = np.sign(s) == np.sign(s_low)
            low, s_low = np.where(left_side, middle, low), np.where(left_side, s, s_low)
            high, s_high = np.where(left_side, high, middle), np.where(left_side, s_high, s)
            guess = low - s_low * (high - low) / (s_high - s_low)
            middle = np.where((guess > low) & (guess < high), guess, 0.5 * (low + high))
        f, _ = _selected(functions, which, middle)
    beyond = f * y < 0.0
    which = which[beyond]
    a, b, y, z, middle, f = (v[beyond] for v in (a, b, y, z, middle, f))
    return np.tile(which, 2), np.hstack([[a, middle, y, f], [middle, b, f, z]])


def _selected(functions: Functions, which: Ints, x: Floats) -> tuple[Floats, Floats]:
    """Value (m,) and slope (m,) of function which[i] at x[i]."""
    value, slope = functions(x)
    columns = np.arange(len(x))
    return value[which, columns], slope[which, columns]


def _solve(
    functions: Functions, which: Ints, low: Floats, high: Floats, f_low: Floats, f_high: Floats
) -> tuple[Floats, Floats]:
    """The root in each bracket, and the value of the function there; all arrays (m,)."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        x = low - f_low * (high - low) / (f_high - f_low)
        x = np.where((x > low) & (x < high), x, 0.5 * (low + high))
        f = np.full_like(x, np.inf)
        before = np.full_like(x, np.inf)
        pole = _LARGE * np.maximum(np.abs(f_low), np.abs(f_high))
        active = np.ones(len(x), np.bool_)
        for _ in range(_STEPS):
            i = np.flatnonzero(active)
            value, slope = _selected(functions, which[i], x[i])
            f[i] = value
            below = np.sign(value) == np.sign(f_low[i])
            low[i] = np.where(below, x[i], low[i])
            high[i] = np.where(below, high[i], x[i])
            guess = x[i] - value / slope
            # halve where Newton leaves the bracket by more than rounding, or the function falls too slowly
            least = _ROUNDING * np.abs(x[i])
            inside = (guess >= low[i] - least) & (guess <= high[i] + least)
            inside &= np.abs(value) < 0.5 * before[i]
            guess = np.where(inside, np.clip(guess, low[i], high[i]), 0.5 * (low[i] + high[i]))
            before[i] = np.abs(value)
            done = (value == 0.0) | (np.abs(guess - x[i]) <= least) | (np.abs(value) > pole[i])
            x[i] = np.where(value == 0.0, x[i], guess)
            active[i] = ~done
            if done.all():
                break
    return x, f


def cubic_extremum(
    y: Floats, z: Floats, dy: Floats, dz: Floats, sign: Floats | float
) -> tuple[Floats, Floats]:
    """Place in [0, 1] and value of a cubic's minimum (sign 1) or maximum (sign -1); arrays (m,).

    The cubic p has p(0) = y, p(1) = z, p'(0) = dy, p'(1) = dz, with sign * dy < 0 < sign * dz.
    """
    d = z - y
    a, b, c = 3.0 * (dy + dz - 2.0 * d), 2.0 * (3.0 * d - 2.0 * dy - dz), dy  # p' = a x**2 + b x + c
    root = np.sqrt(np.maximum(b * b - 4.0 * a * c, 0.0))
    # the root where sign * p' rises, in the form that does not cancel
    with np.errstate(invalid="ignore", divide="ignore"):
        up = np.sign(sign)
        x = np.where(b * up > 0.0, -2.0 * c / (b + up * root), (-b + up * root) / (2.0 * a))
    x = np.clip(np.where(np.isfinite(x), x, 0.5), 0.0, 1.0)
    return x, y + x * (dy + x * (0.5 * b + x * a / 3.0))


def stretches(inside: NDArray[np.bool_]) -> list[list[int]]:
    """The first index, and the one past the last, of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]])))
    return edges.reshape(-1, 2).tolist()
