"""Branches of words, followed by pseudo-arclength, and their events.

Newton's method with exact derivatives finds the orbit on each plane across the tangent. Every event is the
zero of one function on such a plane, so a fold is as well-conditioned as any other point. Times pass through
zero smoothly: a branch ends where a flight or a contact has shrunk to nothing, and goes on as another word.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from kernel.branches.events import Events, Kind, join_events
from kernel.branches.roots import Floats
from kernel.branches.spring import Spring, spring
from kernel.branches.words import (
    STATE,
    Conditions,
    Word,
    WordBranch,
    conditions,
    go_round,
    pieces,
    record,
    samples,
    trace_and_det,
)
from kernel.params import KernelInputError

#: Newton steps at most, and the last step's size, relative, of an event. Along a branch the last step may be
#: larger: what it leaves is its square.
_NEWTON: Final = 15
_CONVERGED: Final = 1e-12
_NEARLY: Final = 1e-7

#: Steps along a branch: the first, the largest, the smallest; the tangent turns by at most this, rad.
_FIRST, _LARGEST, _SMALLEST = 1e-3, 0.1, 1e-9
_TURN: Final = 0.2

#: First step away from a branch, in the units of the unknowns.
_ASIDE: Final = 1e-3

#: Newton's method keeps c + i s on a line; so often turned to the new phase, that keeps Gamma.
_SAME_GAMMA: Final = 4

#: Steps of the search for an event along a branch: enough to halve a step to rounding.
_HALVINGS: Final = 60

#: Points of a branch each way, unless more are asked for.
POINTS: Final = 400

#: Where branches end unless asked otherwise.
GAMMA: Final = (0.0, 8.0)

#: What changes sign along a branch, in the order of `Point.tests`.
_TESTS: Final = (Kind.FOLD, Kind.FLIP, Kind.NEIMARK_SACKER)


class Turn(NamedTuple):
    """What happens at an orbit of a branch, and how the branch may go on."""

    kind: Kind
    word: Word  # the orbit: its unknowns solve the equations
    piece: int  # the contact or flight it belongs to; -1: the whole orbit
    time: float  # rad after the piece's beginning; NaN: not inside it


class Point(NamedTuple):
    """An orbit, the derivatives of its equations, and the unit vector along the branch."""

    u: Floats  # (m,)
    slope: Floats  # (m - 1, m)
    tangent: Floats  # (m,)

    @property
    def gamma(self) -> float:
        return float(np.hypot(self.u[2], self.u[3]))

    @property
    def tests(self) -> Floats:
        """1 - tr + det, 1 + tr + det, det - 1, tr: the first three change sign at _TESTS."""
        (trace,), (det,) = trace_and_det(self.slope[..., None])
        return np.array([1.0 - trace + det, 1.0 + trace + det, det - 1.0, trace])

    @property
    def is_stable(self) -> bool:
        """Whether both multipliers lie inside the unit circle."""
        fold, flip, torus, _ = self.tests
        return bool(fold > 0.0 and flip > 0.0 and torus < 0.0)


def follow(
    word: Word, *, points: int = POINTS, gamma: tuple[float, float] = GAMMA
) -> tuple[WordBranch, list[Turn]]:
    """The branch of a word through a guess of an orbit, with its events, from which other branches begin.

    Both ways, or the way of `word.direction` only. Ends where Gamma leaves its range, where a flight or a
    contact shrinks to nothing, or after `points` points each way. Raises KernelInputError if no orbit is
    found.
    """
    first = start(word)
    ways = [first.tangent] if word.direction is not None else [first.tangent, -first.tangent]
    lines: list[list[Floats]] = []
    turns: list[Turn] = []
    for way in ways:
        line, end = walk(word, first._replace(tangent=way), points, gamma)
        turns += turns_along(word, line)
        lines.append([point.u for point in line])
        if end is not None:
            turns.append(end)
            lines[-1].append(end.word.unknowns)
    return record(word, np.array([*(lines[1][:0:-1] if len(lines) > 1 else ()), *lines[0]])), turns


def start(word: Word) -> Point:
    """The orbit that a word guesses, at the guess's Gamma, or the first beside the branch that it leaves.

    Raises KernelInputError if no orbit is found.
    """
    if not word.letters or set(word.letters) - {"s", "z"} or word.letters[-1] != "s":
        raise KernelInputError("word", f"must be of letters s and z and end with s, got {word.letters!r}")
    k, u = spring(word.omega, word.xi), word.unknowns
    if len(u) != STATE + len(pieces(word.letters)):
        raise KernelInputError("unknowns", f"must be {STATE + len(pieces(word.letters))}, got {len(u)}")
    if word.direction is not None:
        aside = u + _ASIDE * word.direction
        point = newton(k, word, aside, word.direction)
        if point is not None:
            return _along(point, word.direction)
    else:
        size = float(np.hypot(u[2], u[3]))
        for _ in range(_SAME_GAMMA):
            same = np.zeros(len(u))
            same[2:4] = u[2:4] / np.hypot(u[2], u[3])
            point = newton(k, word, u, same, size)
            if point is None or (point.u[STATE:] <= 0.0).any():
                point = None
                break
            u = point.u
        if point is not None:
            return _along(point, point.tangent)
    raise KernelInputError("unknowns", f"no orbit of the word {word.letters} near them")


def _along(point: Point, way: Floats) -> Point:
    """With the tangent of the branch, towards `way`."""
    tangent = np.linalg.svd(point.slope)[2][-1]
    return point._replace(tangent=tangent if tangent @ way > 0.0 else -tangent)


def newton(
    k: Spring, word: Word, u: Floats, direction: Floats, goal: float | None = None,
    converged: float = _CONVERGED,
) -> Point | None:  # fmt: skip
    """The orbit at which direction . u is `goal`, or None. goal: None: what it is at the guess u.

    The tangent leans towards `direction`. converged: the last step's size, relative.
    """
    goal = float(direction @ u) if goal is None else goal
    for _ in range(_NEWTON):
        with np.errstate(all="ignore"):
            cycle = go_round(k, word.letters, word.periods, u[:, None])
        value, slope = cycle.value[:, 0], cycle.slope[..., 0]
        if not (np.isfinite(value).all() and np.isfinite(slope).all()):
            return None
        matrix = np.vstack([slope, direction])
        right = np.zeros((len(u), 2))
        right[:-1, 0], right[-1] = value, (direction @ u - goal, 1.0)
        try:
            step, tangent = np.linalg.solve(matrix, right).T
        except np.linalg.LinAlgError:
            return None
        u = u - step
        if np.abs(step).max() < converged * np.abs(u).max():
            return Point(u, slope, tangent / np.sqrt(tangent @ tangent))
    return None


def walk(
    word: Word, first: Point, points: int, gamma: tuple[float, float], stable_only: bool = False
) -> tuple[list[Point], Turn | None]:
    """Orbits of a branch from `first` on, towards its tangent, and how it ends if as another word.

    stable_only: no further than the first orbit that is not stable.
    """
    k = spring(word.omega, word.xi)
    line, step, bend = [first], _FIRST, np.zeros(len(first.u))
    while len(line) <= points and step > _SMALLEST:
        last = line[-1]
        guess = last.u + step * (last.tangent + 0.5 * step * bend)
        point = newton(k, word, guess, last.tangent, float(last.tangent @ last.u) + step, _NEARLY)
        angle = np.inf if point is None else float(np.arccos(min(1.0, float(point.tangent @ last.tangent))))
        if point is None or angle > _TURN:
            step *= 0.5
            continue
        if (point.u[STATE:] <= 0.0).any():
            end = _end(k, word, last, step)
            if end is None:
                step *= 0.5
                continue
            return line, end
        line.append(point)
        bend = (point.tangent - last.tangent) / step
        bend -= (bend @ point.tangent) * point.tangent
        if not gamma[0] <= point.gamma <= gamma[1]:
            break
        if stable_only and not point.is_stable:
            break
        step = min(step * (1.5 if angle < 0.5 * _TURN else 1.0), _LARGEST)
    return line, None


def _end(k: Spring, word: Word, node: Point, step: float) -> Turn | None:
    """Where within a step the first of the times is zero."""
    point = _root(k, word, node, step, lambda orbit: float(orbit.u[STATE:].min()))
    if point is None:
        return None
    piece = int(np.argmin(point.u[STATE:]))
    part = pieces(word.letters)[piece]
    kind = Kind.GRAZE_CONTACT if part.power == 3 else Kind.IMMEDIATE_TAKEOFF
    return Turn(kind, word.at(point.u), piece, 0.0)


def _root(
    k: Spring, word: Word, node: Point, step: float, function: Callable[[Point], float]
) -> Point | None:
    """The orbit within a step of `node` at which a function that changes sign is zero (Illinois rule)."""
    low, high = 0.0, step
    ends = [node, newton(k, word, node.u + step * node.tangent, node.tangent)]
    if ends[1] is None:
        return None
    low_value, high_value = function(node), function(ends[1])
    best, best_value = (node, low_value) if abs(low_value) < abs(high_value) else (ends[1], high_value)
    last, side = np.inf, 0
    for _ in range(_HALVINGS):
        if np.isfinite(low_value) and np.isfinite(high_value):
            middle = low - low_value * (high - low) / (high_value - low_value)
        else:
            middle = 0.5 * (low + high)
        point = newton(k, word, node.u + middle * node.tangent, node.tangent)
        if point is None:
            return None
        value = function(point)
        if abs(value) < abs(best_value):
            best, best_value = point, value
        if abs(value) < 1e-14 or abs(middle - last) < 1e-15 + _CONVERGED * step:
            break
        last = middle
        if (value > 0.0) == (low_value > 0.0):
            low, low_value, high_value = middle, value, high_value * (0.5 if side < 0 else 1.0)
            side = -1
        else:
            high, high_value, low_value = middle, value, low_value * (0.5 if side > 0 else 1.0)
            side = 1
    return best


def turns_along(word: Word, line: list[Point]) -> Iterator[Turn]:
    """The events between the orbits of a line, in order; each is searched for when it is asked for."""
    k = spring(word.omega, word.xi)
    tests = np.array([point.tests[: len(_TESTS)] for point in line])
    at_nodes = samples(k, word.periods)

    def held(points: list[Point]) -> Conditions:
        u = np.array([point.u for point in points]).T
        return conditions(k, word.letters, u, go_round(k, word.letters, word.periods, u), at_nodes)

    def margin(row: int, point: Point) -> float:
        return float(held([point]).value[row, 0])

    whole = held(line)
    turned = tests[:-1] * tests[1:] < 0.0
    broken = ((whole.value[:, :-1] > 0.0) != (whole.value[:, 1:] > 0.0)).T
    for i in np.flatnonzero(turned.any(axis=1) | broken.any(axis=1)):
        node, step = line[i], _step(line[i], line[i + 1])
        turns: list[tuple[float, Turn]] = []
        for which in np.flatnonzero(turned[i]):
            orbit = _root(k, word, node, step, partial(_test, int(which)))
            kind = _TESTS[which]
            if orbit is None or (kind is Kind.NEIMARK_SACKER and abs(orbit.tests[-1]) >= 2.0):
                continue
            turns.append((_step(node, orbit), Turn(kind, word.at(orbit.u), -1, np.nan)))
        for row in np.flatnonzero(broken[i]):
            orbit = _root(k, word, node, step, partial(margin, int(row)))
            if orbit is not None:
                time = float(held([orbit]).time[row, 0])
                turn = Turn(whole.kind[row], word.at(orbit.u), whole.piece[row], time)
                turns.append((_step(node, orbit), turn))
        yield from (turn for _, turn in sorted(turns, key=lambda x: x[0]))


def folds_along(word: Word, line: list[Point], below: float) -> Iterator[Turn]:
    """The folds between the orbits of a line, those next to orbits below a Gamma."""
    k = spring(word.omega, word.xi)
    tests = np.array([point.tests[0] for point in line])
    for i in np.flatnonzero(tests[:-1] * tests[1:] < 0.0):
        if line[i].gamma < below:
            orbit = _root(k, word, line[i], _step(line[i], line[i + 1]), partial(_test, 0))
            if orbit is not None:
                yield Turn(Kind.FOLD, word.at(orbit.u), -1, np.nan)


def _test(which: int, point: Point) -> float:
    return float(point.tests[which])


def _step(a: Point, b: Point) -> float:
    """How far b lies along the tangent at a."""
    return float(a.tangent @ (b.u - a.u))


def events(turns: list[Turn]) -> Events:
    """Their record; flight_time is that of the first flight."""
    rows = []
    for turn in turns:
        b = record(turn.word, turn.word.unknowns[None])
        rows.append(
            Events(
                np.array([turn.kind], np.str_), np.array([b.omega]), np.array([b.xi]),
                np.array([len(b.word)], np.int32), np.array([b.periods], np.int32), b.flight_time[:, 0],
                b.gamma, b.multiplier, b.admissible,
            )
        )  # fmt: skip
    return join_events(rows)
