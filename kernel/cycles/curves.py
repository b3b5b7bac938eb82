"""Curves of events in two parameters, and the points at which they meet.

The parameters are the flight time T and one of Omega and xi, the other being fixed. A fold, flip or
Neimark-Sacker point of a (1,k) branch is a zero of one function of both. So is an orbit with n = 0 at
landing, and one that grazes: its least gap in flight, or least n in contact, may be differentiated at a fixed
time. Curves are followed by pseudo-arclength, around cusps, in both directions from the events at a few
values of the parameter.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from enum import StrEnum
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.cycles.admissibility import check, combination, force_at_landing, force_slope
from kernel.cycles.closed_form import TWO_PI, floquet, orbit
from kernel.cycles.events import (
    EDGES,
    GRAZES,
    KINDS,
    Events,
    Kind,
    branch,
    branch_and_events,
    events_of,
    join_events,
    sampled,
)
from kernel.cycles.roots import Floats, stretches
from kernel.cycles.spring import STEP, Spring, spring
from kernel.params import KernelInputError

#: Values of the parameter at which events are sought.
LINES: Final = 25

#: The first, the largest and the smallest step along a curve, in sides of the plane.
_FIRST, _LARGEST, _SMALLEST = 2e-3, 1e-2, 1e-6

#: The largest turn of the tangent between points, rad.
_TURN: Final = 0.15

#: Limit on the points of one curve.
_POINTS: Final = 4000

#: Limit on the points of all curves of a branch, of up to 1.4 ms each.
_ALL_POINTS: Final = 60_000

#: Newton steps of a corrector, and of a search for a codimension-2 point.
_CORRECTOR: Final = 8
_NEWTON: Final = 40

#: Curves end this close to T = 0 and T = 2 pi k, in sides: within the grid on which events are sought.
_ENDS: Final = 1e-4

#: The last move of a corrector that has converged, in sides of the plane.
_CONVERGED: Final = 1e-13

#: Kinds at which the gap or n touches zero.
_GRAZE: Final = (Kind.GRAZE_FLIGHT, Kind.GRAZE_CONTACT)

#: An orbit grazes inside its flight or contact if its least gap or n is below this, in plate amplitudes or
#: m A omega**2; else it grazes at an end.
_TOUCHES: Final = 1e-7

#: Codimension-2 points this close in T and in the parameter are the same, found twice.
_SAME: Final = 1e-8


class Parameter(StrEnum):
    """The parameter of a spring that varies along curves."""

    OMEGA = "omega"
    XI = "xi"


class Curves(NamedTuple):
    """Curves, each its points in order, and codimension-2 points on them, or where branches are cut off."""

    curves: tuple[Events, ...]
    points: Events


class _Plane(NamedTuple):
    """The plane (T, parameter) of a (1, periods) branch."""

    parameter: Parameter
    fixed: float
    low: float
    high: float
    periods: int

    def omega_and_xi(self, p: Any) -> tuple[Any, Any]:
        """Omega and xi at a value of the parameter, which may be complex."""
        return (p, self.fixed) if self.parameter is Parameter.OMEGA else (self.fixed, p)

    def spring(self, p: float | complex) -> Spring:
        return spring(*self.omega_and_xi(p))

    def sides(self) -> Floats:
        """The sides of the plane, in T and in the parameter; the units of steps."""
        return np.array([TWO_PI * self.periods, self.high - self.low])

    def floquet(self, t: complex, p: complex) -> tuple[complex, complex, complex, complex]:
        """Trace and determinant of the tangent map, and their derivatives by T."""
        f = floquet(self.spring(p), self.periods, np.array([t]))
        return f.trace[0], f.det[0], f.trace1[0], f.det1[0]

    def event(self, kind: Kind, t: float, p: float) -> Events:
        tolerance = GRAZES if kind in EDGES else 0.0
        return events_of([kind], branch(*self.omega_and_xi(p), self.periods, np.array([t]), tolerance))


#: The functions of trace and determinant that are zero on curves.
_TESTS: Final[Mapping[str, Callable[[complex, complex], complex]]] = {
    Kind.FOLD: lambda trace, det: 1.0 - trace + det,
    Kind.FLIP: lambda trace, det: 1.0 + trace + det,
    Kind.NEIMARK_SACKER: lambda trace, det: det - 1.0,
}


class _Zero:
    """The function of (T, parameter) that is zero on a curve, with its gradient."""

    def __init__(self, plane: _Plane, kind: Kind, t: float, p: float) -> None:
        self.plane, self.kind = plane, kind
        self.time = self.begins = _grazes_at(plane, kind, t, p) if kind in _GRAZE else math.nan

    def __call__(self, t: float, p: float) -> tuple[float, Floats]:
        if math.isfinite(self.time):
            self.time = _minimum(self.plane, self.kind, t, p, self.time)
        by_t, by_p = (self._value(*x) for x in ((t + 1j * STEP, p), (t, p + 1j * STEP)))
        return by_t.real, np.array([by_t.imag, by_p.imag]) / STEP

    def _value(self, t: complex, p: complex) -> complex:
        """The function of the kind: a test of the multipliers, or n, gap', n' or the gap at the event."""
        if self.kind in _TESTS:
            trace, det, _, _ = self.plane.floquet(t, p)
            return _TESTS[self.kind](trace, det)
        k, times = self.plane.spring(p), np.array([t])
        x = orbit(k, self.plane.periods, times)
        if self.kind is Kind.IMMEDIATE_TAKEOFF:
            value = force_at_landing(k, x, times)
        elif math.isnan(self.time):
            value = x.impact if self.kind is Kind.GRAZE_FLIGHT else force_slope(k, x)
        else:
            terms, weights, offset = combination(k, x, times, self.kind is Kind.GRAZE_CONTACT)
            value = (weights * terms(k, np.array([complex(self.time)]))[0]).sum(axis=0) + offset
        return complex(value[0] / math.hypot(x.c[0].real, x.s[0].real))


def _grazes_at(plane: _Plane, kind: Kind, t: float, p: float) -> float:
    """Time of the least gap or n inside the flight or contact, rad; NaN if the orbit grazes at an end."""
    k, times = plane.spring(p), np.array([t])
    x = orbit(k, plane.periods, times)
    checked = check(k, plane.periods, times, x, sampled(k, plane.periods), GRAZES)
    least = checked.gap if kind is Kind.GRAZE_FLIGHT else checked.force
    return float(least.time[0]) if abs(least.depth[0]) < _TOUCHES else math.nan


def _minimum(plane: _Plane, kind: Kind, t: float, p: float, time: float) -> float:
    """Time of the minimum near `time`, rad; NaN if it has left the flight or contact."""
    k, times = plane.spring(p), np.array([t])
    contact = kind is Kind.GRAZE_CONTACT
    terms, weights, _ = combination(k, orbit(k, plane.periods, times), times, contact)
    end = TWO_PI * plane.periods - t if contact else t
    for _ in range(_CORRECTOR):
        _, slope, bend = (float((weights * y).sum()) for y in terms(k, np.array([time])))
        if not bend > 0.0:
            return math.nan
        time -= slope / bend
        if not 0.0 < time < end:
            return math.nan
        if abs(slope / bend) < _CONVERGED:
            break
    return time


def curves(
    parameter: Parameter, fixed: float, low: float, high: float, periods: int,
    kinds: tuple[Kind, ...] = KINDS, lines: int = LINES,
) -> Curves:  # fmt: skip
    """Curves of events of the (1, periods) branch over `parameter` in [low, high], the other at `fixed`.

    Finds every curve that crosses one of `lines` evenly spaced values of the parameter. Neimark-Sacker curves
    end where their multipliers become real. Poles of Gamma are left out. Raises KernelInputError, also for
    more than _ALL_POINTS points together.
    """
    plane = _Plane(parameter, fixed, low, high, periods)
    traced: list[tuple[Kind, Floats]] = []
    points_left = _ALL_POINTS
    for p in np.linspace(low, high, lines):
        _, events = branch_and_events(*plane.omega_and_xi(float(p)), periods)
        for kind, t in zip(events.kind, events.flight_time, strict=True):
            if kind not in kinds or _is_traced(plane, traced, Kind(kind), float(t), float(p)):
                continue
            traced.append((Kind(kind), _whole(plane, Kind(kind), float(t), float(p))))
            points_left -= len(traced[-1][1])
            if points_left < 0:
                rule = f"the curves up to {high:g} have more than {_ALL_POINTS:,} points"
                raise KernelInputError(f"{parameter}_stop", f"{rule}: take a shorter range")
    points = [point for kind, line in traced for point in _codimension_2(plane, kind, line)]
    pieces = tuple(piece for kind, line in traced for piece in _pieces(plane, kind, line))
    return Curves(pieces, _unique(plane, points))


def _is_traced(plane: _Plane, traced: list[tuple[Kind, Floats]], kind: Kind, t: float, p: float) -> bool:
    sides = plane.sides()
    for other, line in traced:
        if other is not kind:
            continue
        a, b = line[:-1] / sides, line[1:] / sides
        chord, away = b - a, np.array([t, p]) / sides - a
        part = np.clip((away * chord).sum(axis=1) / np.maximum((chord * chord).sum(axis=1), 1e-300), 0.0, 1.0)
        # an arc that turns by _TURN lies within _TURN/8 chords of its chord
        distance = np.hypot(*(away - part[:, None] * chord).T)
        if (distance < 0.2 * _TURN * np.hypot(*chord.T) + 1e-9).any():
            return True
    return False


def _whole(plane: _Plane, kind: Kind, t: float, p: float) -> Floats:
    """The points (m, 2) of the whole curve through (t, p)."""
    zero = _Zero(plane, kind, t, p)
    forward, closed = _walk(zero, t, p, 1.0)
    backward = [] if closed else _walk(zero, t, p, -1.0)[0]
    return np.array([*backward[::-1], [t, p], *forward])


def _walk(zero: _Zero, t: float, p: float, direction: float) -> tuple[list[Floats], bool]:
    """Points of the curve from (t, p) on in one direction, and whether it is closed."""
    plane, zero.time = zero.plane, zero.begins
    sides = plane.sides()
    start = np.array([t, p]) / sides
    line: list[Floats] = []
    u, step = start, _FIRST
    tangent = direction * _tangent(zero(t, p)[1] * sides)
    low, high = plane.low / sides[1], plane.high / sides[1]
    while len(line) < _POINTS and step > _SMALLEST:
        v, gradient = _corrected(zero, u + step * tangent)
        turned = _tangent(gradient)
        turned = turned if turned @ tangent > 0.0 else -turned
        angle = float(np.arccos(min(1.0, float(turned @ tangent)))) if np.isfinite(v).all() else np.inf
        if not angle < _TURN:
            step *= 0.5
            continue
        if not low <= v[1] <= high:
            line.append(_on_edge(zero, u, v) * sides)
            return line, False
        if len(line) > 5 and np.hypot(*(v - start)) < step:
            return [*line, v * sides, start * sides], True
        u, tangent = v, turned
        line.append(u * sides)
        step = min(step * (1.5 if angle < 0.5 * _TURN else 1.0), _LARGEST)
    return line, False


def _corrected(zero: _Zero, v: Floats) -> tuple[Floats, Floats]:
    """The point of the curve near v, and its gradient, in sides of the plane; NaN if there is none."""
    sides, time = zero.plane.sides(), zero.time
    gradient = np.full(2, np.nan)
    for _ in range(_CORRECTOR):
        if not (_ENDS < v[0] < 1.0 - _ENDS and v[1] > 0.0):
            break
        f, gradient = zero(float(v[0] * sides[0]), float(v[1] * sides[1]))
        if math.isnan(zero.time) and not math.isnan(time):
            break  # the minimum has left its flight or contact
        gradient = gradient * sides
        move = f / float(gradient @ gradient) * gradient
        v = v - move
        if float(np.hypot(*move)) < _CONVERGED:
            return v, gradient
    zero.time = time
    return np.full(2, np.nan), gradient


def _on_edge(zero: _Zero, u: Floats, v: Floats) -> Floats:
    """The point of the curve at an end of the parameter's range, between u inside and v outside, in sides."""
    plane = zero.plane
    sides = plane.sides()
    p = plane.low if v[1] * sides[1] < plane.low else plane.high
    t = (u[0] + (v[0] - u[0]) * (p / sides[1] - u[1]) / (v[1] - u[1])) * sides[0]
    for _ in range(_CORRECTOR):
        f, gradient = zero(t, p)
        t -= f / gradient[0]
    return np.array([t, p]) / sides


def _tangent(gradient: Floats) -> Floats:
    """The unit vector along a curve whose function has this gradient."""
    return np.array([-gradient[1], gradient[0]]) / float(np.hypot(gradient[0], gradient[1]))


#: The two functions of trace, determinant and their derivatives by T that vanish at a codimension-2 point.
_POINTS_WHERE: Final[Mapping[Kind, Callable[..., tuple[complex, complex]]]] = {
    Kind.CUSP: lambda trace, det, trace1, det1: (1.0 - trace + det, det1 - trace1),
    Kind.BOGDANOV_TAKENS: lambda trace, det, trace1, det1: (trace - 2.0, det - 1.0),
    Kind.FOLD_FLIP: lambda trace, det, trace1, det1: (trace, det + 1.0),
}

#: The functions that vanish where both multipliers are 1, and where both are -1, the 1:2 resonance.
_MEET: Final[tuple[Callable[..., tuple[complex, complex]], ...]] = (
    _POINTS_WHERE[Kind.BOGDANOV_TAKENS],
    lambda trace, det, *_: (trace + 2.0, det - 1.0),
)

#: Codimension-2 points that lie on each kind of curve, and the index of the function that changes sign there.
_POINTS_ON: Final[Mapping[Kind, tuple[tuple[Kind, int], ...]]] = {
    Kind.FOLD: ((Kind.CUSP, 1), (Kind.BOGDANOV_TAKENS, 1), (Kind.FOLD_FLIP, 1)),
    Kind.FLIP: ((Kind.FOLD_FLIP, 1),),
    Kind.NEIMARK_SACKER: ((Kind.BOGDANOV_TAKENS, 0),),
}


def _codimension_2(plane: _Plane, kind: Kind, line: Floats) -> Iterator[tuple[Kind, float, float]]:
    """The codimension-2 points on a curve: kind, T, parameter."""
    values = [plane.floquet(t, p) for t, p in line] if kind in _POINTS_ON else []
    for point, which in _POINTS_ON.get(kind, ()):
        test = np.real([_POINTS_WHERE[point](*x)[which] for x in values])
        for i in np.flatnonzero(test[:-1] * test[1:] < 0.0):
            part = test[i] / (test[i] - test[i + 1])
            t, p = line[i] + part * (line[i + 1] - line[i])
            solution = _codimension_2_at(plane, _POINTS_WHERE[point], float(t), float(p))
            if solution is not None and plane.low <= solution[1] <= plane.high:
                yield point, *solution


def _codimension_2_at(
    plane: _Plane, functions: Callable[..., tuple[complex, complex]], t: float, p: float
) -> tuple[float, float] | None:
    """The point (T, parameter) near a guess at which both functions vanish, by Newton's method, or None."""
    aside = 1j * STEP
    for _ in range(_NEWTON):
        by_t, by_p = (np.array(functions(*plane.floquet(*x))) for x in ((t + aside, p), (t, p + aside)))
        try:
            move = np.linalg.solve(np.array([by_t.imag, by_p.imag]).T / STEP, by_t.real)
        except np.linalg.LinAlgError:
            return None
        t, p = t - move[0], p - move[1]
        if not (0.0 < t < TWO_PI * plane.periods and p > 0.0):
            return None
        if abs(move[0]) < 1e-12 * t and abs(move[1]) < 1e-12 * p:
            return t, p
    return None


def _pieces(plane: _Plane, kind: Kind, line: Floats) -> Iterator[Events]:
    """The records of a curve's parts; of a Neimark-Sacker curve those with complex multipliers."""
    keep = np.ones(len(line), np.bool_)
    if kind is Kind.NEIMARK_SACKER:
        line, keep = _with_ends(plane, line)
    for first, last in stretches(keep):
        if last - first > 1:
            yield join_events([plane.event(kind, t, p) for t, p in line[first:last]])


def _with_ends(plane: _Plane, line: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """A Neimark-Sacker curve with the points at which its multipliers meet, at 1 or -1.

    Also whether the multipliers of each point are complex or meet.
    """
    trace = np.real([plane.floquet(t, p)[0] for t, p in line])
    keep = np.abs(trace) < 2.0
    for i in np.flatnonzero(keep[:-1] != keep[1:])[::-1]:
        end = math.copysign(2.0, trace[i] + trace[i + 1])
        part = (end - trace[i]) / (trace[i + 1] - trace[i])
        t, p = line[i] + part * (line[i + 1] - line[i])
        solution = _codimension_2_at(plane, _MEET[end < 0.0], float(t), float(p))
        if solution is not None and plane.low <= solution[1] <= plane.high:
            line, keep = np.insert(line, i + 1, solution, axis=0), np.insert(keep, i + 1, values=True)
    return line, keep


def _unique(plane: _Plane, points: list[tuple[Kind, float, float]]) -> Events:
    """The record of the points, each once, by kind and parameter."""
    order = list(_POINTS_WHERE)
    once: list[tuple[Kind, float, float]] = []
    for kind, t, p in sorted(points, key=lambda x: (order.index(x[0]), x[2], x[1])):
        if not any(k is kind and abs(t - a) < _SAME and abs(p - b) < _SAME for k, a, b in once):
            once.append((kind, t, p))
    return join_events([plane.event(kind, t, p) for kind, t, p in once])
