"""Branches of the cycles of any contact, found and followed, in the form of those in closed form.

They begin at cycles of the closed form, for an ideal plate with restitution 0, which the contact in question
goes through once from the same state: Newton's method finds its own cycle beside. With rebound the cycles of
one mode lie on more than one branch: beside those that stick, families of a few hops that never do.
"""

from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np

from kernel.cycles.cycles import Point, confirmed, cycle_from, state_after
from kernel.cycles.events import Branch, Events, branch, events_of, join_events
from kernel.cycles.follow import POINTS, RANGE, End, Event, ahead, follow
from kernel.cycles.starts import CycleStart, stable_ranges, start_on_cycle, start_on_stable_cycle
from kernel.numerics.elementary import TWO_PI
from kernel.params import Cell

#: Flight times of the closed form, rad, near rest: where many contacts still have a cycle that sticks.
_SHORT_FLIGHTS: Final = (0.5, 0.25, 1.0, 0.1, 1.5)
#: Parts of each range of Gamma with a stable cycle in closed form, and the narrowest range that counts.
_SHARES: Final = (0.5, 0.3, 0.7, 0.15, 0.85)
_NARROWEST: Final = 1e-3
#: Rounds after which a contact has come close to a cycle that attracts.
_ROUNDS: Final = 100
#: Cycles with shorter flights only, rad, are too close to rest.
_REST: Final = 0.05
#: A cycle whose durations repeat this closely, rad, is one of fewer periods.
_SAME: Final = 1e-6
#: Where a doubled branch begins, the flights of both halves are this close, rad, of those longer than a hop.
_EVEN: Final = 1e-3
_HOP: Final = 1e-2
#: Between two points a fold lies no further beyond both of them.
_FOLDED: Final = 0.025
#: Two cycles at one parameter are one if their flights are this close, rad; numbers of hops differ by less.
_ALIKE: Final = 1e-5


class Followed(NamedTuple):
    """A branch, its cycles and its events, all in order along it."""

    points: list[Point]
    events: list[Event]


def branches(
    plate: Any, omega: float, xi: float, periods: int, *, span: tuple[float, float] = RANGE,
    points: int = POINTS,
) -> list[Followed]:  # fmt: skip
    """The branches along Gamma of the cycles that those of the closed form (1, periods) lead to.

    plate: of one cell, with restitution < 1. span: of Gamma. points: of each, each way. Raises
    KernelInputError for another spring.
    """
    return all_through(seeds(plate, omega, xi, periods), span, points)


def branches_at(
    plate: Any, cell: Cell, periods: int, along: str, span: tuple[float, float], *, points: int = POINTS
) -> list[Followed]:
    """The branches along Omega or xi through the cycles that a cell has on those along Gamma.

    along: "omega" or "xi", which varies within `span`. Raises KernelInputError.
    """
    gamma, omega, xi = map(float, cell)
    lines = branches(plate, omega, xi, periods, span=(RANGE[0], max(gamma, RANGE[1])), points=points)
    here = omega if along == "omega" else xi
    cycles = (
        point.cycles._replace(along=along, gamma=gamma).on_branch(np.append(point.x, here))
        for line in lines
        for point in passing(line, gamma)
    )
    return all_through(cycles, span, points)


def all_through(cycles: Iterable[Point], span: tuple[float, float], points: int = POINTS) -> list[Followed]:
    """The branches through those of the cycles whose parameter lies in `span`, each once."""
    followed: list[Followed] = []
    outside: list[Point] = []

    def joins(point: Point) -> bool:
        """Whether a branch that was cut off goes through a cycle."""
        cut = (line for line in followed if any(event.kind is End.CUT_OFF for event in line.events))
        return any(lies_on(point, line) for line in cut)

    for seed in cycles:
        if not span[0] <= seed.parameter <= span[1]:
            outside.append(seed)
        elif not any(lies_on(seed, line) for line in followed):
            followed.append(both_ways(seed, span, points, joins))
    for seed in outside if not followed else ():
        inside = _from_outside(seed, span, points)
        if inside is not None:
            return [both_ways(inside, span, points)]
    return followed


def _from_outside(seed: Point, span: tuple[float, float], points: int) -> Point | None:
    """The first cycle within the span on the branch through a cycle outside of it."""
    edge = span[0] if seed.parameter < span[0] else span[1]
    low, high = sorted((seed.parameter, edge))
    line, _ = follow(seed, edge - seed.parameter, points=points, span=(low, high))
    return line[-1] if span[0] <= line[-1].parameter <= span[1] else None


def passing(line: Followed, parameter: float) -> Iterator[Point]:
    """The cycles of a branch at a value of its parameter."""
    for a, b in pairwise(line.points):
        if (a.parameter - parameter) * (b.parameter - parameter) <= 0.0:
            near = a if abs(a.parameter - parameter) < abs(b.parameter - parameter) else b
            point = near.cycles.at(near.x, parameter)
            if point is not None and confirmed(point)[1] is None:
                yield point


def both_ways(
    seed: Point, span: tuple[float, float] = RANGE, points: int = POINTS,
    until: Callable[[Point], bool] = lambda _: False,
) -> Followed:  # fmt: skip
    """The whole branch through a cycle, as far as it is followed.

    Each way `until` a cycle, and up to where it becomes a shorter one gone through twice.
    """
    up, after = up_to_shorter(*follow(seed, 1.0, points=points, span=span, until=until))
    if len(up) > 1 and up[-1] is up[0]:
        return Followed(up, after)
    down, before = up_to_shorter(*follow(seed, -1.0, points=points, span=span, until=until))
    if len(down) > 1 and down[-1] is down[0]:  # the way up ended where the way down went on
        return Followed(down, before)
    return Followed([*down[:0:-1], *up], [*before[::-1], *after])


def up_to_shorter(points: list[Point], events: list[Event]) -> tuple[list[Point], list[Event]]:
    """What comes before the flip at which a doubled branch began: beyond, its halves change places."""
    for k, event in enumerate(events):
        if event.turns and is_doubled(event.point):
            return [*points[: event.after + 1], event.point], events[:k]
    return points, events


def is_doubled(point: Point) -> bool:
    """Whether a cycle is one of half its plate periods, gone through twice."""
    flights = [time for time in point.flights if time > _HOP]
    half, odd = divmod(len(flights), 2)
    halves = zip(flights[:half], flights[half:], strict=False)
    return not odd and point.cycles.periods % 2 == 0 and all(abs(a - b) < _EVEN for a, b in halves)


def seeds(plate: Any, omega: float, xi: float, periods: int) -> Iterator[Point]:
    """Cycles of a contact beside those of the closed form (1, periods). Raises KernelInputError."""
    near_rest = branch(omega, xi, periods, np.array(_SHORT_FLIGHTS))
    for gamma, t in zip(near_rest.gamma, near_rest.flight_time, strict=True):
        if RANGE[0] < gamma < RANGE[1]:
            point = beside(plate, start_on_cycle(Cell(float(gamma), omega, xi), periods, float(t)), periods)
            if point is not None:
                yield point
                break
    for low, high in stable_ranges(omega, xi, periods):
        cells = [Cell(low + x * (high - low), omega, xi) for x in _SHARES if high - low > _NARROWEST]
        starts = [start_on_stable_cycle(cell, periods) for cell in cells]
        points = [point for start in starts if (point := beside(plate, start, periods)) is not None]
        # its own cycles may be far away, and yet attract
        yield from points or filter(None, (beside(plate, start, periods, _ROUNDS) for start in starts))


def beside(plate: Any, start: CycleStart | None, periods: int, rounds: int = 0) -> Point | None:
    """The contact's own cycle, if it has one there and not one of fewer periods gone through again.

    rounds: that the contact goes on from the start first.
    """
    if start is None:
        return None
    cell, state = start.start.cell, start.start.state
    if rounds > 0:
        state = state_after(plate, cell, state, rounds * periods)
    point = cycle_from(plate, cell, periods, state)
    if point is None or max(point.flights) < _REST or repeats(point):
        return None
    return point


def repeats(point: Point) -> bool:
    """Whether the cycle is one of fewer plate periods, gone through more than once."""
    n, periods = len(point.letters), point.cycles.periods
    return any(
        n % m == 0
        and point.letters == point.letters[: n // m] * m
        and np.abs(point.times - np.roll(point.times, n // m)).max() < _SAME
        for m in range(2, periods + 1)
    )


def lies_on(point: Point, line: Followed) -> bool:
    """Whether a branch passes through a cycle, wherever that begins."""
    if line.points[0].cycles.periods != point.cycles.periods:
        return False
    away = np.array([other.parameter for other in line.points]) - point.parameter
    close = np.abs(away) < _FOLDED
    between = away[:-1] * away[1:] <= 0.0
    for i in np.flatnonzero(between | close[:-1] & close[1:]):
        a, b = line.points[i : i + 2]
        others: list[Point | None] = []
        if between[i]:
            part = away[i] / (away[i] - away[i + 1]) if away[i] else 0.0
            near = [(a, a.x + part * (b.x - a.x))] if len(a.x) == len(b.x) else [(a, a.x), (b, b.x)]
            others = [guess.cycles.at(x, point.parameter) for guess, x in near]
        # Beside a fold the parameter tells little.
        if a.rising * b.rising < 0.0 and a.letters == point.letters:
            others.append(ahead(a, float(a.tangent @ (point.x - a.x))))
        if any(other is not None and _alike(other, point) for other in others):
            return True
    return False


def _alike(a: Point, b: Point) -> bool:
    """Whether the flights of two cycles are the same, but for the shortest of more hops."""
    pairs = zip(*(sorted(point.flights, reverse=True) for point in (a, b)), strict=False)
    return all(abs(x - y) < _ALIKE for x, y in pairs)


def record(points: list[Point], micro_flight: float) -> Branch:
    """The record of cycles; flights count that take longer than `micro_flight`, rad."""
    gamma, omega, xi = np.array([point.cell for point in points]).reshape(-1, 3).T
    flights = [point.flights for point in points]
    longest = np.array([max(times) for times in flights])
    i = [int(np.flatnonzero(p.times == time)[-1]) for p, time in zip(points, longest, strict=True)]
    begin = np.array([p.round.starts[j] for p, j in zip(points, i, strict=True)]).reshape(-1, 7)
    multiplier = np.array([point.multipliers() for point in points]).reshape(-1, 4)
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
        impact_velocity=np.array([p.round.rates[j] for p, j in zip(points, i, strict=True)]) / gamma,
        multiplier=multiplier[:, :2],
        stable=np.abs(multiplier[:, 0]) < 1.0,
        violations=np.zeros(len(points), np.uint8),
    )


def event_record(events: list[Event], micro_flight: float) -> Events:
    """Their record, as that of the closed form."""
    if not events:
        return join_events([])
    return events_of(
        [event.kind for event in events], record([event.point for event in events], micro_flight)
    )
