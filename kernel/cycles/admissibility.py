"""Whether an orbit of the closed form is one of the spring, over all its flight and all its contact.

The closed form asks only for n = 0 at take-off and gap = 0 at landing. The orbit exists if the gap is
positive throughout the flight, n is positive throughout the contact, and n falls at take-off.
"""

from collections.abc import Callable
from enum import IntFlag
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.cycles.closed_form import TWO_PI, Orbit
from kernel.cycles.roots import Floats, Ints, cubic_extremum
from kernel.cycles.spring import Array, Spring, flight, stuck

#: (spring, times) -> a function and its two derivatives, as combinations (4, ...).
Terms = Callable[[Spring, Array], tuple[Array, Array, Array]]

#: Minima of the cubics between samples below this part of a plate amplitude (of m A omega**2 for n) are
#: followed to rounding: a hundred times what the cubics leave.
_NEAR: Final = 1e-2

#: Samples nearer than this to the end, rad, are left out: the function is zero there but for rounding.
_END: Final = 1e-7

#: Values of samples above minus this are rounding.
_ROUNDING: Final = 1e-12

#: Where the function comes to its end as softly as a cube, it may dip and rise between the last samples.
#: There it is sampled anew, at these parts of what is left: half an octave from each to the next.
_APPROACH: Final = 2.0 ** (-0.5 * np.arange(20))

#: What `_soft` compares with the slopes at both ends is 0 of them for a cube, -0.5 for a square or a line.
_SOFT: Final = -0.25

#: Steps of Newton's method for such a minimum.
_STEPS: Final = 3


class Reason(IntFlag):
    """Why an orbit is not admissible; 0: it is."""

    GAP = 1  # the lower mass would pass below the plate in flight
    CONTACT = 2  # n would be negative in contact
    TAKEOFF = 4  # n does not fall at take-off


class Condition(NamedTuple):
    """A condition of n orbits, that a function is positive inside a flight or contact; arrays (n,)."""

    broken: NDArray[np.bool_]  # negative inside or next to an end
    time: Floats  # rad, of the deepest minimum inside; NaN: none
    depth: Floats  # of that minimum; inf: none


class Check(NamedTuple):
    """What the conditions of n orbits are, in plate amplitudes and m A omega**2."""

    reason: NDArray[np.uint8]  # (n,) a Reason
    gap: Condition  # in flight
    force: Condition  # in contact


class Samples(NamedTuple):
    """Times at which gap and n of a spring are sampled, and what they are combinations of."""

    time: Floats  # (m,) rad from 0, between which they are cubics but for rounding
    gap: tuple[Floats, Floats]  # (4, m) each: `gap_terms` without the second derivatives
    force: tuple[Floats, Floats]  # (4, m) each: `force_terms`


def gap_terms(k: Spring, t: Array) -> tuple[Array, Array, Array]:
    """The gap and its two derivatives as combinations (4, ...) of (c, s, 1 - c, v0)."""
    f = flight(k, t)
    w = k.stiffness
    return (
        np.array([f.cos_rest, -f.sin_rest, f.s_int_rest, w * f.s_int2]),
        np.array([-f.sin_rest, -f.versine, f.s_rest, w * f.s_int]),
        np.array([-f.versine, -f.sin, f.free.s1 - 1.0, w * f.free.s]),
    )


def gap_weights(x: Orbit) -> Array:
    """(4, n) for `gap_terms`, in units of g/omega**2."""
    return np.array([x.c, x.s, 1.0 - x.c, x.v0])


def force_terms(k: Spring, t: Array) -> tuple[Array, Array, Array]:
    """n - 2/Gamma t rad after landing and its two derivatives as combinations (4, ...) of `force_weights`."""
    f = stuck(k, t)
    sin, cos = np.sin(t), np.cos(t)
    b, w = k.dashpot, k.stiffness
    return (
        np.array([-cos, sin, f.c, f.s]),
        np.array([sin, cos, f.c1, f.s1]),
        np.array([cos, -sin, -b * f.c1 - w * f.c, -b * f.s1 - w * f.s]),
    )


def force_weights(k: Spring, x: Orbit, t: Array) -> Array:
    """(4, n): the driven force N z e^{iT} and h'', h''' at landing, h the free elongation.

    n = 2/Gamma - Re(N z e^{i(T + t)}) + h'', with N = 1 + (w + i b) Q and z = c + i s; lengths in units of
    g/omega**2.
    """
    b, w, sin, cos = k.dashpot, k.stiffness, np.sin(t), np.cos(t)
    c, s = x.c * cos - x.s * sin, x.c * sin + x.s * cos
    h = x.q_land + 1.0 / w - (k.q_re * c - k.q_im * s)
    h1 = x.v_land + (k.q_re * s + k.q_im * c)
    h2 = -b * h1 - w * h
    n_re, n_im = 1.0 + w * k.q_re - b * k.q_im, w * k.q_im + b * k.q_re
    return np.array([n_re * c - n_im * s, n_re * s + n_im * c, h2, -b * h2 - w * h1])


def combination(k: Spring, x: Orbit, t: Array, contact: bool) -> tuple[Terms, Array, float]:
    """Terms, weights and offset of the gap in flight, or of n in contact, in units of g/omega**2."""
    return (force_terms, force_weights(k, x, t), 2.0) if contact else (gap_terms, gap_weights(x), 0.0)


def force_at_landing(k: Spring, x: Orbit, t: Array) -> Array:
    """n of a mass that has just landed, in units of g/omega**2."""
    driven = x.c * np.cos(t) - x.s * np.sin(t)
    return np.asarray(1.0 - driven - k.dashpot * x.v_land - k.stiffness * x.q_land)


def force_slope(k: Spring, x: Orbit) -> Array:
    """n' at take-off, in contact; gap''' there is -n'."""
    return np.asarray(x.s + 2.0 * k.dashpot * (1.0 - x.c) - k.stiffness * x.v0)


def check(
    k: Spring, periods: int, t: Floats, x: Orbit, at: Samples, tolerance: Floats | float = 0.0
) -> Check:
    """Follow the orbits `x` with flights of t rad (n,).

    tolerance: by how much a condition may be broken, in plate amplitudes or m A omega**2; for orbits that
    graze.
    """
    scale = 1.0 / np.hypot(x.c, x.s)
    impact, slope, landing = x.impact * scale, force_slope(k, x) * scale, force_at_landing(k, x, t) * scale
    zero, rest = np.zeros_like(t), TWO_PI * periods - t
    gap = deepest(k, gap_terms, gap_weights(x) * scale, zero, t, impact, at.time, at.gap, tolerance)
    force = deepest(
        k, force_terms, force_weights(k, x, t) * scale, 2.0 * scale, rest, slope, at.time, at.force, tolerance
    )
    # written so that an orbit that is not finite fulfils no condition
    above = (gap.depth > -tolerance) & (impact < tolerance) & ~gap.broken
    presses = (force.depth > -tolerance) & (landing > -tolerance) & ~force.broken
    falls = slope < tolerance
    reason = Reason.GAP * ~above + Reason.CONTACT * ~presses + Reason.TAKEOFF * ~falls
    gap, force = gap._replace(broken=~(above & falls)), force._replace(broken=~(presses & falls))
    return Check(reason.astype(np.uint8), gap, force)


def _combined(weights: Floats, terms: Floats) -> Floats:
    """(n, m), of (4, n) and (4, m): too small a product to wake the threads of a BLAS library for."""
    return np.asarray(np.einsum("in,im->nm", weights, terms))


def deepest(
    k: Spring, terms: Terms, weights: Floats, offset: Floats, end: Floats, end_slope: Floats, nodes: Floats,
    at_nodes: tuple[Floats, Floats], tolerance: Floats | float,
) -> Condition:  # fmt: skip
    """The deepest minimum before `end` (n,), where the function is zero; broken: a sample is negative."""
    m = int(np.searchsorted(nodes, end.max(initial=0.0))) + 1
    nodes = nodes[:m]
    inside = nodes < end[:, None] - _END
    value = np.where(inside, _combined(weights, at_nodes[0][:, :m]) + offset[:, None], 0.0)
    slope = np.where(inside, _combined(weights, at_nodes[1][:, :m]), end_slope[:, None])
    negative = value.min(axis=1) < -tolerance - _ROUNDING
    down = slope < 0.0
    row, at = np.nonzero(down[:, :-1] & (slope[:, 1:] > 0.0) & inside[:, :-1])
    right = np.where(inside[row, at + 1], nodes[np.minimum(at + 1, m - 1)], end[row])
    values, slopes = (value[row, at], value[row, at + 1]), (slope[row, at], slope[row, at + 1])
    turns = np.array([nodes[at], right, *values, *slopes])
    before = np.maximum(inside.sum(axis=1) - 2, 0)
    each = np.arange(len(end))
    soft = _soft(value[each, before], slope[each, before], end_slope, end - nodes[before])
    if len(soft):
        rows, others = _near_end(k, terms, weights, offset, end, end_slope, nodes[before], soft)
        row, turns = np.concatenate([row, rows]), np.hstack([turns, others])
    time, depth = np.full(len(end), np.nan), np.full(len(end), np.inf)
    if not len(row):
        return Condition(negative, time, depth)
    left, right, u, v, slope_left, slope_right = turns
    width = right - left
    part, low = cubic_extremum(u, v, slope_left * width, slope_right * width, 1.0)
    where = left + part * width
    near = np.flatnonzero(np.abs(low) < _NEAR)
    if len(near):
        r, tau = row[near], where[near]
        first, last = left[near], right[near]
        for step in range(_STEPS):
            f, f1, f2 = (np.einsum("in,in->n", weights[:, r], z) for z in terms(k, tau))
            if step < _STEPS - 1:
                with np.errstate(invalid="ignore", divide="ignore"):
                    tau = np.clip(np.where(f2 > 0.0, tau - f1 / f2, tau), first, last)
        where[near], low[near] = tau, f + offset[r]
    order = np.argsort(-low, kind="stable")  # the deepest of a row is written last
    time[row[order]], depth[row[order]] = where[order], low[order]
    return Condition(negative, time, depth)


def _soft(value: Floats, slope: Floats, end_slope: Floats, left: Floats) -> Ints:
    """Which functions (n,), `left` before the end, may dip and rise again on their way down to zero there.

    By the middle coefficient of the slope's quadratic in Bernstein form.
    """
    fall = (slope + end_slope) * left
    return np.flatnonzero((slope < 0.0) & (end_slope < 0.0) & (-3.0 * value - fall > -_SOFT * fall))


def _near_end(
    k: Spring, terms: Terms, weights: Floats, offset: Floats, end: Floats, end_slope: Floats, first: Floats,
    rows: Ints,
) -> tuple[Ints, Floats]:  # fmt: skip
    """Where the functions of some rows fall and rise between `first` (n,) and the end, by more samples.

    Returns their rows (p,), and the two times of each, rad, with the values and the slopes there (6, p).
    """
    t = end[rows, None] - (end - first)[rows, None] * _APPROACH
    many = np.repeat(weights[:, rows], len(_APPROACH), axis=1)
    f, f1, _ = (np.einsum("in,in->n", many, x).reshape(t.shape) for x in terms(k, t.ravel()))
    t = np.column_stack([t, end[rows]])
    f = np.column_stack([f + offset[rows, None], np.zeros(len(rows))])
    f1 = np.column_stack([f1, end_slope[rows]])
    i, j = np.nonzero((f1[:, :-1] < 0.0) & (f1[:, 1:] > 0.0))
    turns = [t[i, j], t[i, j + 1], f[i, j], f[i, j + 1], f1[i, j], f1[i, j + 1]]
    return rows[i], np.array(turns)
