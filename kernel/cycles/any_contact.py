"""Branches of the cycles of any contact: finds their first cycles, follows them, and records them.

The search begins at cycles of the closed form, which holds for an ideal plate with restitution 0. The contact
goes through one round from the same state, and Newton's method finds the contact's own cycle nearby. With
rebound the cycles of one mode lie on several branches: besides cycles that stick there are families of a few
hops that never do, whose cycle of one flight has a closed form too.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import islice, pairwise, takewhile
from typing import Any, Final

import numpy as np

from kernel.cycles.cycles import Point, admissible, cycle_from, state_after
from kernel.cycles.events import CROSSINGS, Branch, Events, Kind, branch, events_of, join_events
from kernel.cycles.follow import (
    POINTS,
    RANGE,
    ROUNDING,
    End,
    Event,
    Followed,
    ahead,
    crossing,
    follow,
    happens,
    root,
    within,
)
from kernel.cycles.roots import Floats
from kernel.cycles.segments import START
from kernel.cycles.starts import (
    CycleStart,
    stable_ranges,
    start_on_cycle,
    start_on_stable_cycle,
    starts_between_landings,
    starts_on_admissible_cycles,
)
from kernel.numerics.elementary import TWO_PI
from kernel.params import Cell

#: Flight times of the closed form near rest, rad, where many contacts still have a cycle that sticks.
_SHORT_FLIGHTS: Final = (0.5, 0.25, 1.0, 0.1, 1.5)
#: Places within a range of Gamma with a stable closed-form cycle, and the narrowest range that counts.
_SHARES: Final = (0.5, 0.3, 0.7, 0.15, 0.85)
_NARROWEST: Final = 1e-3
#: Limit on the points from a cycle outside the range of a parameter to the range.
_WAY: Final = 4 * POINTS
#: Rounds after which a contact is close to an attracting cycle.
_ROUNDS: Final = 100
#: A cycle without a longer flight, rad, is too close to rest.
_REST: Final = 0.05
#: A cycle whose durations repeat within this, rad, is one of fewer periods.
_SAME: Final = 1e-6
#: Where a doubled branch begins, the flights of both halves agree within this, rad; hops do not count.
_EVEN: Final = 1e-3
_HOP: Final = 1e-2
#: A fold between two points of a branch lies at most this far beyond both, in the parameter.
_FOLDED: Final = 0.025
#: Two cycles at one parameter are one if their flights agree within this, rad; shorter hops do not count.
_SAME_FLIGHTS: Final = 1e-5


def branches(
    plate: Any, omega: float, xi: float, periods: int, *, span: tuple[float, float] = RANGE,
    points: int = POINTS,
) -> list[Followed]:  # fmt: skip
    """The branches along Gamma that the closed-form cycles (1, periods) lead to.

    plate: of one cell, restitution < 1. span: range of Gamma. points: limit for each branch, each way. Raises
    KernelInputError for a spring without branches.
    """
    return all_through(seeds(plate, omega, xi, periods), span, points)


def branches_at(
    plate: Any, cell: Cell, periods: int, along: str, span: tuple[float, float], *, points: int = POINTS
) -> list[Followed]:
    """The branches along "omega" or "xi" within `span` through the cycles of a cell, as `cycles_at_cell`."""
    cycles = (turned(point, along, cell.gamma) for point in cycles_at_cell(plate, cell, periods, points))
    return all_through(cycles, span, points)


def cycles_at_cell(plate: Any, cell: Cell, periods: int, points: int = POINTS) -> Iterator[Point]:
    """The cycles that `branches` along Gamma have at a cell. Raises KernelInputError."""
    gamma, omega, xi = map(float, cell)
    lines = branches(plate, omega, xi, periods, span=(RANGE[0], max(gamma, RANGE[1])), points=points)
    return (point for line in lines for point in passing(line, gamma))


def turned(point: Point, along: str, gamma: float) -> Point:
    """The cycle of a branch along Gamma at `gamma`, on its branch along "omega" or "xi"."""
    cycles = point.cycles._replace(along=along, gamma=gamma)
    return cycles.on_branch(np.append(point.x, getattr(cycles, along)))


def all_through(cycles: Iterable[Point], span: tuple[float, float], points: int = POINTS) -> list[Followed]:
    """The branches through the cycles whose parameter lies in `span`, each branch once.

    Then those that reach `span` from a cycle outside, and the last points of ways there that are cut off.
    """
    followed: list[Followed] = []
    outside: list[Point] = []
    ways: list[Followed] = []
    cut: list[Followed] = []

    def arrives(point: Point) -> bool:
        return within(point, span) or any(lies_on(point, way) for way in ways)

    for seed in cycles:
        if not within(seed, span):
            outside.append(seed)
        elif not any(lies_on(seed, line) for line in followed):
            followed.append(both_ways(seed, span, points, partial(joins, followed)))
    for seed in outside:
        if arrives(seed):
            continue
        reach = min(span[0], seed.parameter), max(span[1], seed.parameter)
        line = follow(seed, span[0] - seed.parameter, points=_WAY, span=reach, until=arrives)
        first = line.points[-1]
        if within(first, span) and not any(lies_on(first, other) for other in followed):
            followed.append(both_ways(first, span, points, partial(joins, followed)))
        cut += [Followed([first], [end]) for end in cut_off([line])]
        if not math.isclose(first.parameter, seed.parameter):  # else it goes on beyond its seed
            ways.append(line)
    return joined(followed + cut)


def joins(lines: list[Followed], point: Point) -> bool:
    """Whether a branch that was cut off passes through a cycle."""
    return any(lies_on(point, line) for line in lines if cut_off([line]))


def joined(lines: list[Followed]) -> list[Followed]:
    """The same branches, cut off only where no other one goes on."""

    def ends(event: Event, own: Followed) -> bool:
        others = (line for line in lines if line is not own)
        return event.kind is not End.CUT_OFF or not any(lies_on(event.point, line) for line in others)

    return [own._replace(events=[event for event in own.events if ends(event, own)]) for own in lines]


def cut_off(lines: list[Followed]) -> list[Event]:
    """Where branches are cut off."""
    return [event for line in lines for event in line.events if event.kind is End.CUT_OFF]


def passing(line: Followed, parameter: float) -> Iterator[Point]:
    """The cycles of a branch at a value of its parameter."""
    for a, b in pairwise(_with_folds(line.points, parameter)):
        if _away([a, b], parameter).prod() > 0.0:
            continue
        near = min((a, b), key=lambda x: abs(x.parameter - parameter) / max(abs(x.rising), 1e-300))
        point = near.cycles.at(near.x, parameter)
        if point is None and a.letters == b.letters:
            point = _between(a, b, lambda x: x.parameter - parameter)
        if point is not None and admissible(point) is not None:
            yield point


def _away(points: list[Point], parameter: float) -> Floats:
    """Distances of cycles from a value of their parameter; zero for a cycle on a limit at this value."""
    away = np.array([point.parameter for point in points]) - parameter
    return np.where(np.abs(away) > 2.0 * ROUNDING * parameter, away, 0.0)


def _with_folds(points: list[Point], parameter: float) -> Iterator[Point]:
    """The cycles of a branch, with the folds near a value of its parameter."""
    for a, b in pairwise(points):
        yield a
        if max(abs(x.parameter - parameter) for x in (a, b)) < _FOLDED and a.letters == b.letters:
            fold = _between(a, b, lambda x: x.rising)
            yield from () if fold is None else (fold,)
    yield from points[-1:]


def _between(a: Point, b: Point, function: Callable[[Point], float]) -> Point | None:
    """The solution between two of the same segments at which a function changes sign, or None."""
    way = b.x - a.x
    a, b = a.towards(way), b.towards(way)
    return root(a, float(a.tangent @ way), function) if function(a) * function(b) < 0.0 else None


def both_ways(
    seed: Point, span: tuple[float, float], points: int, until: Callable[[Point], bool] = lambda _: False
) -> Followed:
    """The whole branch through a cycle, followed both ways.

    Each way ends as in `follow`, or where the cycle becomes a shorter one gone through more than once.
    """
    first = seed if seed.rising >= 0.0 else seed.back()
    up, after = up_to_shorter(follow(first, 0.0, points=points, span=span, until=until))
    if len(up) > 1 and up[-1] is up[0]:
        return Followed(up, after)
    down, before = up_to_shorter(follow(first.back(), 0.0, points=points, span=span, until=until))
    before = [event for event in before if event.point is not down[0] or event.kind not in CROSSINGS]
    if len(down) > 1 and down[-1] is down[0]:  # the way up ended where the way down went on
        return Followed(down, before)
    return Followed([*down[:0:-1], *up], [*before[::-1], *after])


def up_to_shorter(line: Followed) -> Followed:
    """The part of a branch before a shorter cycle, gone through more than once.

    It ends with the flip of that cycle, beyond which its halves change places, or where one of them grazes.
    """
    own = list(takewhile(lambda point: not repeats(point), line.points)) or line.points
    swaps = ((k, _flip_between(a, b)) for k, (a, b) in enumerate(pairwise(own)) if _halves_swap(a, b))
    k, flip = next((swap for swap in swaps if swap[1] is not None), (len(own) - 1, None))
    points, events = own[: k + 1], [event for event in line.events if event.after <= k]
    for i, event in enumerate(events):
        if event.turns and event.point is not line.points[0] and is_doubled(event.point):
            kind = Kind.FLIP if event.kind is Kind.FOLD else event.kind  # seen from the shorter cycle
            last = Event(kind, event.point, after=event.after)
            return Followed([*points[: event.after + 1], event.point], [*events[:i], last])
    if flip is not None:
        return Followed([*points, flip], [*events, Event(Kind.FLIP, flip, after=k)])
    return Followed(points, events)


def _halves_swap(a: Point, b: Point) -> bool:
    """Whether the halves of a cycle of twice the period change places between neighbours on its branch."""
    n = len(a.letters) // 2
    if a.cycles.periods % 2 or a.letters != b.letters or a.letters != 2 * a.letters[:n]:
        return False
    return float((a.times[:n] - a.times[n:]) @ (b.times[:n] - b.times[n:])) < 0.0


def _flip_between(a: Point, b: Point) -> Point | None:
    """The flip of the shorter cycle at which the halves of a and b change places, gone through twice.

    Newton's method may end on the shorter cycle there, so that the turn of the branch is not located.
    """
    n = len(a.letters) // 2
    cycles, x = a.cycles.with_segments(a.letters[:n], a.x, 0.5 * (a.times[:n] + a.times[n:]))
    node = cycles._replace(periods=cycles.periods // 2).at(x, a.parameter)
    if node is None:
        return None
    reach, test = float(np.linalg.norm(b.x - a.x)), partial(crossing, Kind.FLIP)
    flips = filter(None, (root(way, reach, test) for way in (node, node.back())))
    flip = min(flips, key=lambda flip: float(np.linalg.norm(flip.x - node.x)), default=None)
    if flip is None or np.linalg.norm(flip.x - node.x) > reach or not happens(Kind.FLIP, flip):
        return None
    cycles, x = flip.cycles.with_segments(a.letters, flip.x, np.tile(flip.times, 2))
    return cycles._replace(periods=a.cycles.periods).on_branch(x)


def is_doubled(point: Point) -> bool:
    """Whether a cycle is a shorter one of half its plate periods, gone through twice."""
    flights = [time for time in point.flights if time > _HOP]
    half, odd = divmod(len(flights), 2)
    halves = zip(flights[:half], flights[half:], strict=False)
    return not odd and point.cycles.periods % 2 == 0 and all(abs(a - b) < _EVEN for a, b in halves)


def seeds(plate: Any, omega: float, xi: float, periods: int) -> Iterator[Point]:
    """Cycles of a contact near the closed-form cycles (1, periods). Raises KernelInputError."""
    near_rest = branch(omega, xi, periods, np.array(_SHORT_FLIGHTS))
    cycles = zip(near_rest.gamma.tolist(), near_rest.flight_time.tolist(), strict=True)
    inside = ((Cell(gamma, omega, xi), t) for gamma, t in cycles if RANGE[0] < gamma < RANGE[1])
    short = (beside(plate, start_on_cycle(cell, periods, t), periods) for cell, t in inside)
    yield from islice(filter(None, short), 1)
    ranges = stable_ranges(omega, xi, periods)
    for low, high in ranges:
        cells = [Cell(low + x * (high - low), omega, xi) for x in _SHARES if high - low > _NARROWEST]
        starts = [start_on_stable_cycle(cell, periods) for cell in cells]
        points = [beside(plate, start, periods) for start in starts]
        yield from filter(None, points)
        # far away from these, its own cycles may still attract
        far = [start for start, point in zip(starts, points, strict=True) if point is None]
        far = far if len(far) == len(starts) else far[::-1]  # those near rest are on the branch of the others
        yield from filter(None, (beside(plate, start, periods, _ROUNDS) for start in far))
    if not ranges:
        unstable = starts_on_admissible_cycles(omega, xi, periods)
        yield from filter(None, (beside(plate, start, periods) for start in unstable))
    hops = starts_between_landings(omega, xi, periods, float(plate.restitution[0]))
    never_stuck = (cycle_from(plate, start.cell, periods, start.state, seed=True) for start in hops)
    yield from islice((point for point in never_stuck if point is not None and not repeats(point)), 1)


def beside(plate: Any, start: CycleStart | None, periods: int, rounds: int = 0) -> Point | None:
    """The contact's own cycle near a start; None if there is none, or if it repeats a shorter one.

    rounds: number of rounds that the contact settles for first.
    """
    if start is None:
        return None
    cell, state = start.start.cell, start.start.state
    if rounds > 0:
        state = state_after(plate, cell, state, rounds * periods)
    point = cycle_from(plate, cell, periods, state, seed=True)
    if point is None or max(point.flights) < _REST or repeats(point):
        return None
    return point


def repeats(point: Point) -> bool:
    """Whether the cycle is a shorter one, gone through more than once."""
    n, periods = len(point.letters), point.cycles.periods
    return any(
        n % m == 0
        and point.letters == point.letters[: n // m] * m
        and np.abs(point.times - np.roll(point.times, n // m)).max() < _SAME
        for m in range(2, periods + 1)
    )


def lies_on(point: Point, line: Followed) -> bool:
    """Whether a branch passes through a cycle, whichever segment either begins with."""
    if line.points[0].cycles.periods != point.cycles.periods:
        return False
    away = _away(line.points, point.parameter)
    close = np.abs(away) < _FOLDED
    between = away[:-1] * away[1:] <= 0.0
    for i in np.flatnonzero(between | close[:-1] & close[1:]):
        a, b = line.points[i : i + 2]
        others: list[Point | None] = []
        if between[i]:
            part = away[i] / (away[i] - away[i + 1]) if away[i] else 0.0
            near = [(a, a.x + part * (b.x - a.x))] if len(a.x) == len(b.x) else [(a, a.x), (b, b.x)]
            others = [guess.cycles.at(x, point.parameter) for guess, x in near]
        # near a fold the parameter hardly changes along the branch
        if a.rising * b.rising < 0.0 and a.letters == point.letters and _apart(a, point) < 2.0 * _apart(a, b):
            others.append(ahead(a, float(a.tangent @ (point.x - a.x))))
        if any(other is not None and _same_flights(other, point) for other in others):
            return True
    return False


def _apart(a: Point, b: Point) -> float:
    """Distance of the states at which two cycles start."""
    return float(np.linalg.norm(a.x[:START] - b.x[:START]))


def _same_flights(a: Point, b: Point) -> bool:
    """Whether the flights of two cycles agree, the longest first, up to the shorter list."""
    pairs = zip(*(sorted(point.flights, reverse=True) for point in (a, b)), strict=False)
    return all(abs(x - y) < _SAME_FLIGHTS for x, y in pairs)


def record(points: list[Point], micro_flight: float) -> Branch:
    """The record of cycles along a branch. Flights longer than `micro_flight`, rad, count as bounces."""
    gamma, omega, xi = np.array([point.cell for point in points]).reshape(-1, 3).T
    flights = [point.flights for point in points]
    longest = np.array([max(times) for times in flights])
    segments = [int(np.flatnonzero(p.times == t)[-1]) for p, t in zip(points, longest, strict=True)]
    begin = np.array([p.round.starts[i] for p, i in zip(points, segments, strict=True)]).reshape(-1, 7)
    multiplier = np.array([point.multipliers for point in points]).reshape(-1, 4)
    return Branch(
        periods=points[0].cycles.periods,
        omega=omega,
        xi=xi,
        gamma=gamma,
        flights=np.array([len(times) for times in flights], np.int32),
        bounces=np.array([sum(t > micro_flight for t in times) for times in flights], np.int32),
        flight_time=longest,
        takeoff_phase=np.mod(np.arctan2(begin[:, 5], begin[:, 4]), TWO_PI),
        elongation=begin[:, 2] / gamma,
        elongation_velocity=begin[:, 3] / gamma,
        impact_velocity=np.array([p.round.rates[i] for p, i in zip(points, segments, strict=True)]) / gamma,
        multiplier=multiplier[:, :2],
        stable=np.abs(multiplier[:, 0]) < 1.0,
        violations=np.zeros(len(points), np.uint8),
        cycle_state=np.array([point.state for point in points]).reshape(-1, 6),
    )


def event_record(events: list[Event], micro_flight: float) -> Events:
    """The record of events; `micro_flight` as in `record`."""
    if not events:
        return join_events([])
    kinds = [event.kind for event in events]
    return events_of(kinds, record([event.point for event in events], micro_flight))
