"""Whether an orbit of the closed form is one of the spring, throughout its flight and its contact.

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

#: Minima between samples are refined to rounding if their cubic lies within this of zero, in plate amplitudes
#: or m A omega**2. The error of the cubics is a hundredth of it.
_NEAR: Final = 1e-2

#: Samples this close to the end, rad, are left out: the function is zero there, apart from rounding.
_END: Final = 1e-7

#: Samples above minus this count as zero.
_ROUNDING: Final = 1e-12

#: A function that ends as softly as a cube may dip and rise again between the last samples. It is sampled
#: anew at these parts of the time left, in steps of half an octave.
_APPROACH: Final = 2.0 ** (-0.5 * np.arange(20))

#: Threshold of `_soft`, in units of the sum of the slopes at both ends: a cube has 0, a square or line -0.5.
_SOFT: Final = -0.25

#: Newton steps for a minimum near zero.
_STEPS: Final = 3


class Reason(IntFlag):
    """Why an orbit is not admissible; 0: it is."""

    GAP = 1  # the lower mass would pass below the plate in flight
    CONTACT = 2  # n would be negative in contact
    TAKEOFF = 4  # n does not fall at take-off


class Condition(NamedTuple):
    """For n orbits, whether a function is positive throughout a flight or contact; arrays (n,)."""

    broken: NDArray[np.bool_]  # negative inside or next to an end
    time: Floats  # rad, of the deepest minimum inside; NaN: none
    depth: Floats  # value at that minimum; inf: none


class Check(NamedTuple):
    """The conditions of n orbits, in plate amplitudes and m A omega**2."""

    reason: NDArray[np.uint8]  # (n,) a Reason
    gap: Condition  # in flight
    force: Condition  # in contact


class Samples(NamedTuple):
    """Times at which gap and n of a spring are sampled, and their terms there."""

    time: Floats  # (m,) rad from 0; both are nearly cubics between neighbours
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
    k: Spring, periods: int, t: Floats, x: Orbit, samples: Samples, tolerance: Floats | float = 0.0
) -> Check:
    """Check the orbits `x`, whose flights take t rad (n,).

    samples: of this spring and these periods. tolerance: allowance for orbits that graze, in plate amplitudes
    or m A omega**2.
    """
    scale = 1.0 / np.hypot(x.c, x.s)
    impact, slope, landing = x.impact * scale, force_slope(k, x) * scale, force_at_landing(k, x, t) * scale
    zero, rest = np.zeros_like(t), TWO_PI * periods - t
    gap = deepest(k, gap_terms, gap_weights(x) * scale, zero, t, impact, samples.time, samples.gap, tolerance)
    force = deepest(
        k, force_terms, force_weights(k, x, t) * scale, 2.0 * scale, rest, slope, samples.time, samples.force,
        tolerance,
    )  # fmt: skip
    # comparisons with NaN are false: an orbit that is not finite fulfils no condition
    above = (gap.depth > -tolerance) & (impact < tolerance) & ~gap.broken
    presses = (force.depth > -tolerance) & (landing > -tolerance) & ~force.broken
    falls = slope < tolerance
    reason = Reason.GAP * ~above + Reason.CONTACT * ~presses + Reason.TAKEOFF * ~falls
    gap, force = gap._replace(broken=~(above & falls)), force._replace(broken=~(presses & falls))
    return Check(reason.astype(np.uint8), gap, force)


def _combined(weights: Floats, terms: Floats) -> Floats:
    """weights (4, n) times terms (4, m), as (n, m); too small a product to wake threads of BLAS."""
    return np.asarray(np.einsum("in,im->nm", weights, terms))


def deepest(
    k: Spring, terms: Terms, weights: Floats, offset: Floats, end: Floats, end_slope: Floats, nodes: Floats,
    at_nodes: tuple[Floats, Floats], tolerance: Floats | float,
) -> Condition:  # fmt: skip
    """The deepest minimum of n functions before their `end` (n,), where they are zero.

    weights (4, n), offset (n,): the functions in `terms`. end_slope (n,): slopes at the end. nodes (m,), rad,
    and at_nodes: sample times, and the terms and their derivatives there. `broken` if a sample is below
    -tolerance.
    """
    m = int(np.searchsorted(nodes, end.max(initial=0.0))) + 1
    nodes = nodes[:m]
    inside = nodes < end[:, None] - _END
    value = np.where(inside, _combined(weights, at_nodes[0][:, :m]) + offset[:, None], 0.0)
    slope = np.where(inside, _combined(weights, at_nodes[1][:, :m]), end_slope[:, None])
    negative = value.min(axis=1) < -tolerance - _ROUNDING
    down = slope < 0.0
    row, i = np.nonzero(down[:, :-1] & (slope[:, 1:] > 0.0) & inside[:, :-1])
    right = np.where(inside[row, i + 1], nodes[np.minimum(i + 1, m - 1)], end[row])
    values, slopes = (value[row, i], value[row, i + 1]), (slope[row, i], slope[row, i + 1])
    turns = np.array([nodes[i], right, *values, *slopes])
    before = np.maximum(inside.sum(axis=1) - 2, 0)
    every = np.arange(len(end))
    soft = _soft(value[every, before], slope[every, before], end_slope, end - nodes[before])
    if len(soft):
        rows, others = _near_end(k, terms, weights, offset, end, end_slope, nodes[before], soft)
        row, turns = np.concatenate([row, rows]), np.hstack([turns, others])
    time, depth = np.full(len(end), np.nan), np.full(len(end), np.inf)
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
    order = np.argsort(-low, kind="stable")  # the deepest minimum of a row is written last
    time[row[order]], depth[row[order]] = where[order], low[order]
    return Condition(negative, time, depth)


def _soft(value: Floats, slope: Floats, end_slope: Floats, left: Floats) -> Ints:
    """Indices of the functions that may dip and rise again before they reach zero at their end.

    value, slope (n,): `left` rad before the end. Decided by the middle coefficient of the slope's quadratic
    in Bernstein form.
    """
    fall = (slope + end_slope) * left
    return np.flatnonzero((slope < 0.0) & (end_slope < 0.0) & (-3.0 * value - fall > -_SOFT * fall))


def _near_end(
    k: Spring, terms: Terms, weights: Floats, offset: Floats, end: Floats, end_slope: Floats, first: Floats,
    rows: Ints,
) -> tuple[Ints, Floats]:  # fmt: skip
    """Brackets of minima between `first` (n,) and the end, by more samples, for the functions in `rows`.

    Returns the rows (p,) of the brackets, and their two times, rad, values and slopes (6, p).
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
