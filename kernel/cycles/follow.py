"""Branches of cycles of any contact, followed by pseudo-arclength, and their events.

Newton's method with exact derivatives finds the cycle on a plane across the tangent. Every event is a zero of
one function on such planes, so that a fold is as well-conditioned as any other point. Where the segments of
the cycle change, the branch goes on with the new ones (`kernel.cycles.changes`).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from enum import StrEnum
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from kernel.cycles.changes import Margin, next_cycle, over_small_segment
from kernel.cycles.cycles import LANDINGS, Broken, Point, admissible, confirmed
from kernel.cycles.events import CROSSINGS, Kind
from kernel.cycles.roots import Floats
from kernel.cycles.segments import START

#: Steps along a branch: the first, the largest and the smallest. The largest turn of the tangent, rad.
_FIRST, LARGEST, _SMALLEST = 1e-3, 0.1, 1e-10
_TURN: Final = 0.25
#: The smallest step of a soft contact. Smaller ones step over a segment that appears or vanishes.
_SMALLEST_SOFT: Final = 1e-8
#: A step to a broken solution is shortened to this. Then the change before it is located.
_NEAR: Final = 1e-6

#: A cycle on a limit of the parameter may lie beyond by this, relative.
ROUNDING: Final = 1e-13
#: Relative size of the last Newton step along a branch. The remaining error is its square.
_NEARLY: Final = 1e-11

#: Steps of the search for an event. Its range is stretched up to this often, by this factor.
_STEPS: Final = 80
_STRETCHES, _STRETCH = 8, 1.3
#: A value below this part of those at the ends of the range is zero. Within this part of the range, a search
#: ends after this many values without a smaller one: the rest is rounding.
_ZERO, _NARROW, _STALLED = 1e-13, 1e-2, 4

#: A multiplier this close to -1 or the unit circle makes an event, or a parameter that changes this little on
#: its branch, and two near -1 with a product of both distances below the second: where they meet, each moves
#: with the square root. So does a test of flips below the third part of those around it: beside a graze
#: rounding moves multipliers.
_AT, _BOTH, _PART = 1e-4, 1e-6, 1e-2
#: Indices of each two of the multipliers.
_PAIRS: Final = np.triu_indices(4, 1)

#: A chattering mass has ceased to stick if it sticks for less than the first, rad; where the branch cannot be
#: followed on, for less than the second.
_LAST_STICK, _LITTLE_STICK = 1e-6, 1e-4

#: A segment shorter than this, rad, vanishes. Multipliers of neighbours that differ by more, relative, jump.
_MINUTE, _JUMP = 1e-4, 1e-2
#: A cycle leads back along the branch if the product of both tangents is below the first, and the unknowns
#: differ by less than the second.
_BACK, _SAME = -0.99, 1e-9
#: Hops accumulate where the flight that ends a chatter touches within this time, rad.
_NEXT_HOP: Final = 2e-3
#: A branch ends at rest if its longest flight is shorter than the first, rad. It is followed down to the
#: second: below, rounding hides the multipliers. The error of Gamma is then less than its square.
_REST, _NOTHING = 1e-2, 1e-4

#: Defaults: points of a branch each way, signatures on it, and range of the parameter.
POINTS: Final = 360
SIGNATURES: Final = 40
RANGE: Final = (1e-6, 8.0)


class End(StrEnum):
    """The kinds of ends of a followed branch. Other events have a `Kind`."""

    STICK_VANISHES = "stick-vanishes"  # the mass ceases to stick; beyond, numbers of hops accumulate
    REST = "rest"  # its flights vanish
    BELOW_SURFACE = "below-surface"  # its only flight stays below the surface: it no longer bounces
    UNKNOWN_CHANGE = "unknown-change"  # its segments change, and no cycle is found beyond
    CUT_OFF = "cut-off"  # it goes on beyond the limit of points or signatures


class Event(NamedTuple):
    """An event at a cycle of a branch."""

    kind: Kind | End
    point: Point
    turns: bool = False  # whether the parameter turns back here
    after: int = 0  # index of the last point before it, among those of `follow`


class Followed(NamedTuple):
    """A branch: its cycles and its events, both in order along it."""

    points: list[Point]
    events: list[Event]


class _Stretch(NamedTuple):
    """Cycles with one signature, apart from their number of hops, and why they end."""

    points: list[Point]
    broken: Broken | None = None
    beyond: Point | None = None  # the first broken solution, `step` beyond the last cycle
    step: float = 0.0


def follow(
    point: Point, way: float, *, points: int = POINTS, span: tuple[float, float] = RANGE,
    until: Callable[[Point], bool] = lambda _: False, crossings: Sequence[Kind] = CROSSINGS,
) -> Followed:  # fmt: skip
    """Follow the branch from a cycle on.

    way: the parameter first rises (> 0) or falls (< 0); 0 keeps the direction of the cycle's tangent. Stops
    at the limits of the parameter, `span`, at the first cycle for which `until` holds, and where a closed
    branch returns to `point`. Any other end is an event whose kind is an `End`. crossings: those of CROSSINGS
    that are located.
    """
    origin = point = point if point.rising * way >= 0.0 else point.back()
    line: list[Point] = []
    events: list[Event] = []

    def leaves(cycle: Point) -> bool:
        return not within(cycle, span) or until(cycle)

    for _ in range(SIGNATURES):
        stretch = _walk(point, points - len(line), leaves, origin)
        events += _events_along(stretch.points, len(line), crossings)
        line += stretch.points
        last, after = line[-1], None
        end = _end(last)
        if end is None and stretch.broken is not None:
            after, change = _change(stretch, partial(_goes_back, line))
            if change is not None and after is not None:
                to, back = (_located_before(x, change.point, crossings) for x in (last, after.back()))
                events += [event._replace(after=len(line) - 1) for event in (*to, change, *back[::-1])]
            end = _end_at(last, stretch.broken) if after is None else None
        closed = last is origin and len(line) > 1
        if end is None and len(line) >= points and not (leaves(last) or closed):
            end = End.CUT_OFF
        if end is not None:
            events.append(Event(end, last, after=len(line) - 1))
        if end is not None or after is None:
            return _up_to_limit(line, events, span)
        point = after
    return Followed(line, [*events, Event(End.CUT_OFF, line[-1], after=len(line) - 1)])


def _up_to_limit(line: list[Point], events: list[Event], span: tuple[float, float]) -> Followed:
    """A branch up to the limit of its parameter, with the cycle there, instead of a last point beyond."""
    *inside, last = line
    if not inside or within(last, span):
        return Followed(line, events)
    limit = float(np.clip(last.parameter, span[0] * (1.0 + ROUNDING), span[1] * (1.0 - ROUNDING)))
    near = root(inside[-1], _reach(inside[-1], last), lambda x: x.parameter - limit)
    edge = near and near.cycles.at(near.x, limit)
    edge = near and edge and admissible(edge.towards(near.tangent))
    inside += [] if edge is None else [edge]
    return Followed(inside, [event for event in events if within(event.point, span)])


def within(cycle: Point, span: tuple[float, float]) -> bool:
    """Whether the parameter of a cycle has not left `span`."""
    return span[0] * (1.0 - ROUNDING) <= cycle.parameter <= span[1] * (1.0 + ROUNDING)


def _end(last: Point) -> End | None:
    """The end next to the last cycle, if it is at rest or ceases to stick."""
    if max(last.flights) < _REST:
        return End.REST
    return End.STICK_VANISHES if _shortest_stick(last) < _LITTLE_STICK else None


def _end_at(last: Point, broken: Broken) -> End:
    """The end at a change of segments beyond which no cycle is found."""
    ending = last.letters[broken.segment]
    if broken.reason == "touches" and ending == "h" and broken.time < _NEXT_HOP:
        return End.STICK_VANISHES
    alone = sum(letter in LANDINGS for letter in last.letters) == 1
    return End.BELOW_SURFACE if broken.reason == "lands softly" and alone else End.UNKNOWN_CHANGE


def _walk(first: Point, points: int, leaves: Callable[[Point], bool], origin: Point) -> _Stretch:
    """Cycles from `first` on along its tangent, as long as the spring has their signature.

    leaves: whether a cycle is the last one wanted. origin: first cycle of the branch, where a closed branch
    ends.
    """
    line, step, bend = [first], _FIRST, np.zeros(len(first.x))
    smallest = _SMALLEST_SOFT if "C" in first.letters else _SMALLEST
    while len(line) < points and not leaves(line[-1]):
        last = line[-1]
        if _shortest_stick(last) < _LAST_STICK or max(last.flights) < _NOTHING:
            break
        if step < smallest:
            return _Stretch(line, Broken("too small", 0))
        solution, angle = _stepped(last, step, bend)
        if solution is None or angle > _TURN:
            step *= 0.5
            continue
        point, broken = confirmed(solution)
        if broken is not None:
            if step <= _NEAR:
                return _Stretch(line, broken, solution if len(solution.x) == len(point.x) else point, step)
            step *= 0.25
            continue
        if last is not origin and _passes(last, step, origin):
            return _Stretch([*line, origin])
        line.append(point)
        bend = np.zeros(len(point.x))
        if len(point.x) == len(last.x):
            bend = (point.tangent - last.tangent) / step
            bend -= (bend @ point.tangent) * point.tangent
        step = min(step * (1.5 if angle < 0.5 * _TURN else 1.0), LARGEST)
    return _Stretch(line)


def _stepped(last: Point, step: float, bend: Floats) -> tuple[Point | None, float]:
    """The solution one step further, and the angle by which the tangent turns, rad."""
    guess = last.x + step * (last.tangent + 0.5 * step * bend)
    point = last.cycles.newton(guess, last.tangent, float(last.tangent @ last.x) + step, _NEARLY)
    if point is None:
        return None, math.inf
    return point, math.acos(min(1.0, max(-1.0, float(point.tangent @ last.tangent))))


def _passes(last: Point, step: float, origin: Point) -> bool:
    """Whether the first cycle of the branch lies within the next step."""
    if last.letters != origin.letters or origin.tangent @ last.tangent < 0.0:
        return False
    away = origin.x - last.x
    ahead = float(last.tangent @ away)
    return 0.0 < ahead <= step and bool(np.linalg.norm(away - ahead * last.tangent) < step * _TURN)


# --- events on a stretch ------------------------------------------------------------------------------------


def _events_along(line: list[Point], before: int, kinds: Sequence[Kind]) -> Iterator[Event]:
    """The crossings of these kinds between neighbours. before: number of points before `line`."""
    tests = np.array([[crossing(kind, point) for kind in kinds] for point in line])
    with np.errstate(over="ignore", invalid="ignore"):
        turned = (tests[:-1] * tests[1:] < 0.0) | (tests[:-1] == 0.0)
    turned &= np.isfinite(tests[:-1]) & np.isfinite(tests[1:])
    for i in np.flatnonzero(turned.any(axis=1)).tolist():
        which = [kind for kind, turns in zip(kinds, turned[i], strict=True) if turns]
        yield from (event._replace(after=before + i) for event in _located(which, line[i], line[i + 1]))


def _located(kinds: Sequence[Kind], a: Point, b: Point) -> list[Event]:
    """The events between two cycles between which the tests of these kinds change sign, in order from a."""
    events = []
    for kind in kinds:
        test = partial(crossing, kind)
        around = min(abs(test(a)), abs(test(b)))
        # Newton's method may fail before it comes to the event; `any_contact` ends branches at folds
        once = kind is Kind.FOLD or not test(a) * test(b) < 0.0
        for first, last in ((a, b),) if once else ((a, b), (b.back(), a)):
            point = root(first, _reach(first, last), test) if test(first) != 0.0 else first
            if point is not None and happens(kind, point, around):
                point = point if first is a else point.back()
                events.append(Event(kind, point, turns=kind is Kind.FOLD))
                break
    return sorted(events, key=lambda event: _reach(a, event.point))


def _located_before(point: Point, change: Point, kinds: Sequence[Kind]) -> list[Event]:
    """The flips and Neimark-Sacker points between a cycle and a change of segments ahead, in order.

    Beside a graze multipliers move with the square root of the distance.
    """
    others = (kind for kind in kinds if kind is not Kind.FOLD)
    which = [kind for kind in others if crossing(kind, point) * crossing(kind, change) < 0.0]
    return _located(which, point, change)


@np.errstate(over="ignore", invalid="ignore")  # multipliers of cycles of many hops
def crossing(kind: Kind, point: Point) -> float:
    """A function that changes sign at crossings of a kind, and at its poles."""
    if kind is Kind.FOLD:
        return point.rising
    mu = point.multipliers
    if kind is Kind.FLIP:
        return float(np.prod(1.0 + mu).real)
    return float(np.prod(1.0 - mu[_PAIRS[0]] * mu[_PAIRS[1]]).real)


def happens(kind: Kind | End, point: Point, around: float = 0.0) -> bool:
    """Whether a multiplier lies at the value of this kind. Its test also changes sign at a pole.

    That of a fold has none. Rounding hides its multiplier beside a graze. around: the least value of the test
    of cycles on both sides.
    """
    mu = point.multipliers
    if kind is Kind.FOLD:
        return abs(point.rising) < _AT
    if kind is Kind.FLIP:
        return bool(np.abs(mu + 1.0).min() < _AT or abs(crossing(kind, point)) < max(_BOTH, _PART * around))
    return bool(((np.abs(mu.imag) > 1e-9) & (np.abs(np.abs(mu) - 1.0) < _AT)).any())


def _reach(a: Point, b: Point) -> float:
    """Distance of b along the tangent at a; a rough one if their numbers of hops differ."""
    if len(a.x) == len(b.x):
        return float(a.tangent @ (b.x - a.x))
    start = 1.2 * float(np.linalg.norm(a.x[:START] - b.x[:START])) + 1e-6
    rise, step = abs(a.rising), abs(b.parameter - a.parameter)
    return max(start, min(step / rise, LARGEST) if rise > 0.0 else LARGEST)


def ahead(node: Point, reach: float) -> Point | None:
    """The solution at this distance along the tangent, or None."""
    goal = float(node.tangent @ node.x) + reach
    return node.cycles.newton(node.x + reach * node.tangent, node.tangent, goal)


def root(node: Point, reach: float, function: Callable[[Point], float]) -> Point | None:
    """The solution within about `reach` of `node` at which `function` changes sign, by the Illinois rule.

    Where there is no solution, or the function is not finite, it counts as having changed sign.
    """
    low, low_value = 0.0, function(node)
    if not math.isfinite(low_value) or low_value == 0.0:
        return None

    def value_at(x: float) -> tuple[Point | None, float]:
        point = ahead(node, x)
        value = math.nan if point is None else function(point)
        return (point, value) if math.isfinite(value) else (None, -low_value)

    high = reach
    for _ in range(_STRETCHES):
        best, high_value = value_at(high)
        if high_value * low_value < 0.0:
            break
        high *= _STRETCH
    else:
        return None
    best_value, side, first, since = abs(high_value), 0, low_value, 0
    near_zero = max(1e-15, _ZERO * min(abs(low_value), abs(high_value)))
    for k in range(_STEPS):
        x = low - low_value * (high - low) / (high_value - low_value)
        if k % 4 == 3 or not low < x < high:
            x = 0.5 * (low + high)
        point, value = value_at(x)
        since += 1
        if point is not None and abs(value) < best_value:
            best, best_value, since = point, abs(value), 0
        stalled = since > _STALLED and high - low < _NARROW * reach
        if best_value < near_zero or stalled or high - low < 1e-16 + 1e-13 * reach:
            break
        if value * first > 0.0:
            low, low_value, high_value = x, value, high_value * (0.5 if side < 0 else 1.0)
            side = -1
        else:
            high, high_value, low_value = x, value, low_value * (0.5 if side > 0 else 1.0)
            side = 1
    return best


# --- from one signature to the next -------------------------------------------------------------------------


def _change(stretch: _Stretch, goes_back: Callable[[Point], bool]) -> tuple[Point | None, Event | None]:
    """The first cycle beyond a change of the signature, and the change, if it was located; else None.

    goes_back: whether a cycle would lead back along the branch.
    """
    last, broken, beyond = stretch.points[-1], stretch.broken, stretch.beyond
    if broken is not None and beyond is not None and len(beyond.x) == len(last.x):
        margin = Margin(broken, beyond)
        point = root(last, stretch.step, margin)
        after = None if point is None else next_cycle(margin, point, goes_back)
        if point is not None and after is not None:
            kind, changed, first = after
            # not of `point`: the parameter stands still where a duration vanishes with its square root
            return first, Event(kind, changed, turns=last.rising * first.rising < 0.0)
    shortest = int(np.argmin(last.times))
    if last.times[shortest] < _MINUTE:
        after = next_cycle(Margin(Broken("vanishes", shortest), last), last, goes_back)
        if after is not None:
            kind, _, first = after
            turns = last.rising * first.rising < 0.0
            return first, Event(kind, last, turns) if _multipliers_jump(last, first) else None
    if "C" not in last.letters:
        return None, None
    before = stretch.points[-2] if len(stretch.points) > 1 else None
    over = over_small_segment(last, before)
    return (None if over is None or goes_back(over) else over), None


def _goes_back(line: list[Point], first: Point) -> bool:
    """Whether the first cycle beyond a change lies on the branch behind, and leads back along it."""
    alike = [point for point in line if point.letters == first.letters]
    near = min(alike, key=lambda point: float(np.linalg.norm(point.x - first.x)), default=None)
    if near is None or near.tangent @ first.tangent > _BACK:
        return False
    behind = ahead(near, float(near.tangent @ (first.x - near.x)))
    return behind is not None and bool(np.abs(behind.x - first.x).max() < _SAME)


def _multipliers_jump(a: Point, b: Point) -> bool:
    x, y = a.multipliers[0], b.multipliers[0]
    return bool(min(abs(x - y), abs(x - y.conjugate())) > _JUMP * (1.0 + abs(x)))


def _shortest_stick(point: Point) -> float:
    """Duration, rad, for which a chattering mass sticks; infinite without chatter."""
    if "c" not in point.letters:
        return math.inf
    return min(float(t) for t, letter in zip(point.times, point.letters, strict=True) if letter == "S")
