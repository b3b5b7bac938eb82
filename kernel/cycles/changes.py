"""Changes of a cycle's segments along its branch: where they happen, and the first cycle beyond."""

import math
import re
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import numpy as np

from kernel.cycles.cycles import LANDINGS, Broken, Cycles, Point, admissible, end_of_round, kernels_round
from kernel.cycles.events import Kind
from kernel.cycles.roots import Floats
from kernel.cycles.segments import START, lowest, simulated
from kernel.numerics.elementary import TWO_PI

#: Samples in a search for a segment's minimum: over the whole segment, and near its last place.
_SAMPLES, _FEW = 4000, 400
#: Part of the segment on either side of the last place that counts as near.
_NEAR: Final = 0.1
#: Part of a segment at each end, where its event function is zero, in which minima do not count.
_ENDS: Final = 1e-9

#: Distances of the first cycle from the change, in the units of the unknowns, tried in turn. The last are for
#: new contacts of small penetration.
_STEPS: Final = (1e-4, 1e-3, 1e-5, 1e-6, 1e-7, 1e-8)
#: The same for a cycle of twice the period, which begins where a multiplier is this close to -1.
_DOUBLED_STEPS: Final = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
_FLIPS: Final = 0.1
#: Largest difference of an unknown between the change and the first cycle. Above the second it must shrink by
#: the third factor with a tenth of the step: else the cycle lies elsewhere.
_BESIDE, _NEXT, _SHRINKS = 0.2, 1e-3, 0.5
#: Times before n touches zero at which a mass that sticks lets go, rad, tried in turn.
_EARLIER: Final = (2.5e-3, 7.5e-4, 7.5e-3, 2.5e-4)
#: Limit on the kernel's phases after it lets go.
_HOPS: Final = 400
#: Distances from a minute segment at which the signature is read anew, tried in turn.
_ASIDE: Final = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-5)


class _Edit(NamedTuple):
    """The cycle at a change, written with the segments beyond it."""

    kind: Kind
    cycles: Cycles
    x: Floats
    way: Floats | None = None  # the first step, or against it; None: along the branch
    steps: tuple[float, ...] = _STEPS


class Margin:
    """A function of the cycle that falls through zero where a solution breaks."""

    def __init__(self, broken: Broken, beyond: Point) -> None:
        """`beyond`: a broken solution."""
        self.broken = broken
        self.time = math.nan  # rad from the segment's beginning to where it touches
        if broken.reason == "touches":
            since = broken.time if broken.time > 0.0 else 0.0
            self.time, _ = _lowest(beyond, broken.segment, since, math.inf, _SAMPLES)

    def __call__(self, point: Point) -> float:
        """Positive on the side of the cycles, negative beyond; NaN if unknown."""
        i, cycle = self.broken.segment, point.round
        match self.broken.reason:
            case "vanishes":
                return float(point.times[i])
            case "lands softly":
                return -float(cycle.rates[i])
            case "emerges":
                return -float(cycle.starts[i + 1, 0])
            case "sticks":
                return -float(cycle.forces[i])
            case "takes off":
                return float(cycle.forces[i])
            case "touches":
                near = _NEAR * point.times[i]
                time, value = _lowest(point, i, self.time - near, self.time + near, _FEW)
                self.time = self.time if math.isnan(time) else time
                return value
        return math.nan


def _lowest(point: Point, i: int, since: float, until: float, samples: int) -> tuple[float, float]:
    """Time, rad, and value of the first minimum of segment i's event function between two times, or NaN."""
    _, omega, xi = point.cell
    code, whole = point.cycles.code, point.times[i]
    since, until = max(since, _ENDS * whole), min(until, (1.0 - _ENDS) * whole)
    start = point.round.starts[i]
    time, value = lowest(point.cycles.plate, omega, xi, code[i], code[i - 1], start, since, until, samples)
    return float(time), float(value)


def next_cycle(
    margin: Margin, point: Point, goes_back: Callable[[Point], bool]
) -> tuple[Kind, Point, Point] | None:
    """Kind of the change at `point`, the cycle there, and the first cycle beyond; None if that is not found.

    The margin is zero at `point`. The tangent of the first cycle leads away from the change. The cycle there
    is written with the fewer segments: with more, a vanishing duration divides the multipliers by zero.
    goes_back: whether a cycle would lead back along the branch.
    """
    margin(point)  # updates the time at which it touches
    for edit in _edits(margin.broken, margin.time, point):
        first = _first(edit, goes_back)
        if first is not None:
            fewer = len(edit.cycles.letters) < len(point.letters)
            return edit.kind, edit.cycles.on_branch(edit.x) if fewer else point, first
    return None


def _first(edit: _Edit, goes_back: Callable[[Point], bool] = lambda _: False) -> Point | None:
    """The first admissible cycle beyond a change; None if there is none."""
    along = edit.cycles.on_branch(edit.x).tangent if edit.way is None else edit.way
    along = along / math.sqrt(along @ along)
    for step in edit.steps:
        for way in (along, -along):
            point = _aside(edit, way, step)
            if point is None or (away := _away(edit, point)) > _BESIDE:
                continue
            if away > _NEXT and step > 0.0:
                nearer = _aside(edit, way, 0.1 * step)
                if nearer is None or _away(edit, nearer) > _SHRINKS * away:
                    continue
            point = admissible(point)
            if point is not None and not goes_back(point):
                return point
    return None


def _aside(edit: _Edit, way: Floats, step: float) -> Point | None:
    """The solution beyond a change, a step of it on."""
    return edit.cycles.newton(edit.x + step * way, way, float(way @ edit.x) + step)


def _away(edit: _Edit, point: Point) -> float:
    """The largest difference of an unknown between a change and a solution."""
    return float(np.abs(point.x - edit.x).max())


def _edits(broken: Broken, time: float, point: Point) -> Iterator[_Edit]:
    """The changes with which the branch may go on, tried in turn."""
    i, rebounds = broken.segment, bool(point.cycles.plate.restitution[0] > 0.0)
    if broken.reason in ("vanishes", "lands softly"):
        point, i = _inside(point, i)
    letters, times = point.letters, point.times
    letter, before, after = letters[i], letters[i - 1], letters[(i + 1) % len(letters)]
    inside = 0 < i < len(letters) - 1
    if broken.reason == "vanishes" and letter in "hc":
        yield from _without_chatter(point, i)
    match broken.reason:
        case "touches" if letter in "hcsz":
            new = ("h" if rebounds else "z") + letter
            yield _replaced(Kind.GRAZE_FLIGHT, point, i, 1, new, (time, times[i] - time), (-1.0, 1.0))
        case "touches" if letter in "FC":
            between = "C" if letter == "F" else "F" if point.cycles.plate.adhesive else "b"
            kind = Kind.GRAZE_FLIGHT if letter == "F" else Kind.GRAZE_CONTACT
            parts = (time, 0.0, times[i] - time)
            yield _replaced(kind, point, i, 1, letter + between + letter, parts, (-0.5, 1.0, -0.5))
        case "touches" if letter == "S":
            yield from _letting_go(point, i, time)
        case "lands softly" if letter in "hz" and i + 1 < len(letters):
            yield _replaced(Kind.GRAZE_FLIGHT, point, i, 2, after, (times[i] + times[i + 1],))
        case "lands softly" if letter == "F" and not point.cycles.plate.adhesive:
            yield _replaced(Kind.GRAZE_FLIGHT, point, i, 1, "b", (times[i],))
        case "emerges":
            yield _replaced(Kind.GRAZE_FLIGHT, point, i, 1, "F", (times[i],))
        case "vanishes" if letter == "S" and before == "s":
            begun, i = (point, i) if i > 0 else (point.begun(len(letters) - 1), 1)
            yield _replaced(Kind.IMMEDIATE_TAKEOFF, begun, i - 1, 2, "z", (begun.times[i - 1],))
        case "vanishes" if letter in "scFbC" and inside and before != "z":
            kind = Kind.GRAZE_FLIGHT if letter == "C" else Kind.GRAZE_CONTACT
            whole = (times[i - 1 : i + 2].sum(),)
            yield _replaced(kind, point, i - 1, 3, after if before == "b" else before, whole)
        case "vanishes" if letter in "sz" and before == "z":
            begun, i = point.begun((i + 1) % len(letters)), len(letters) - 2
            yield _replaced(Kind.IMMEDIATE_TAKEOFF, begun, i, 2, letter, (begun.times[i],))
        case "sticks":
            yield _replaced(Kind.IMMEDIATE_TAKEOFF, point, i, 1, "sS", (times[i], 0.0), (0.0, 1.0))
        case "takes off":
            yield _replaced(Kind.IMMEDIATE_TAKEOFF, point, i, 1, "zs", (times[i], 0.0), (0.0, 1.0))


def _replaced(
    kind: Kind, point: Point, i: int, count: int, letters: str, times: tuple[float, ...],
    way: tuple[float, ...] | None = None,
) -> _Edit:  # fmt: skip
    """The change that puts other segments in place of `count` segments from the i-th on."""
    old, spans = point.letters, point.times
    new = [*spans[:i], *times, *spans[i + count :]]
    cycles, x = point.cycles.with_segments(old[:i] + letters + old[i + count :], point.x, new)
    if way is None:
        return _Edit(kind, cycles, x)
    direction = np.zeros(len(x))
    direction[START + i : START + i + len(way)] = way
    return _Edit(kind, cycles, x, direction)


def _inside(point: Point, i: int) -> tuple[Point, int]:
    """The same cycle, begun so that segment i is neither first nor last, if possible; and its new index."""
    n = len(point.letters)
    for j in range(n):
        if point.letters[j - 1] in LANDINGS and 0 < (i - j) % n < n - 1:
            return point.begun(j), (i - j) % n
    return point, i


def _without_chatter(point: Point, i: int) -> Iterator[_Edit]:
    """The change at which all flights of the chatter with segment i vanish, if the mass sticks around it."""
    before = (point.letters + point.letters[:i]).rstrip("h")
    begun = point.begun((len(before) - 1) % len(point.letters))
    if chatter := re.match("Sh*cS", begun.letters):
        whole = begun.times[: chatter.end()].sum()
        yield _replaced(Kind.GRAZE_CONTACT, begun, 0, chatter.end(), "S", (whole,))


def _letting_go(point: Point, i: int, time: float) -> Iterator[_Edit]:
    """Changes at which a mass that sticks lets go where n touches zero, and sticks again after some hops.

    n = n2/2 (t**2 - a**2) makes a flight of 4 a that begins a before the lowest n. The kernel starts 2 a
    before it, with n lowered by n2/2 a**2.
    """
    whole = point.times[i]
    gamma, omega, xi = point.cell
    b, w = 2.0 * xi / omega, 1.0 / omega**2
    for early in _EARLIER:
        wait = time - 2.0 * early
        x = point.x.copy()
        x[START + i] = wait
        z = point.cycles.equations(x).starts[i + 1]
        n = z[6] - z[4] - b * z[3] - w * z[2]
        phase = math.atan2(z[5], z[4]) % TWO_PI
        state = [phase, 0.0, 0.0, 0.0, (z[2] + 0.25 * n / w) / gamma, z[3] / gamma]
        letters, times, _ = simulated(point.cycles.plate, point.cell, state, whole - wait, _HOPS)
        end = max(letters.find("c"), letters.find("s")) + 1
        left = whole - wait - times[:end].sum()
        if end < 2 or letters[0] != "S" or left <= 0.0:
            continue
        parts = (wait + times[0], *times[1:end], left)
        way = (parts[0] - time, *times[1:end], left - (whole - time))
        edit = _replaced(Kind.GRAZE_CONTACT, point, i, 1, letters[:end] + "S", parts, way)
        yield edit._replace(steps=(0.0,))


def doubled(point: Point) -> Point | None:
    """The first cycle of the branch of twice the period that begins at a flip; None if there is none.

    A cycle that repeats the one that flips has no multiplier at -1: its branch begins here.
    """
    if np.abs(point.multipliers + 1.0).min() > _FLIPS:
        return None
    cycles, x = point.cycles.with_segments(2 * point.letters, point.x, [*point.times, *point.times])
    cycles = cycles._replace(periods=2 * cycles.periods)
    along = np.concatenate([point.tangent[: START + len(point.letters)], point.tangent[START:]])
    # two branches cross here: the direction across the shorter cycle's own branch
    slope = cycles.equations(x).slope
    scale = 1.0 / np.abs(slope).max(axis=1, keepdims=True)
    way = np.linalg.svd(np.vstack([slope * scale, along]))[2][-1]
    longest = START + int(np.argmax(point.times))
    return _first(_Edit(Kind.FLIP, cycles, x, way if way[longest] > 0.0 else -way, _DOUBLED_STEPS))


def over_small_segment(last: Point, before: Point | None) -> Point | None:
    """The first cycle beyond a minute segment that appears or vanishes, read from the kernel; or None."""
    start = last.tangent[:START]
    if np.linalg.norm(start) < 1e-6 and before is not None:
        start = last.x[:START] - before.x[:START]
    size = np.linalg.norm(start)
    if not size > 0.0:
        return None
    whole = TWO_PI * last.cycles.periods
    around, flight = last.letters[-1] + last.letters[0], last.times[-1]
    for step in _ASIDE:
        x = last.x.copy()
        x[:START] += step * start / size
        letters, times, _ = kernels_round(last.cycles, x, 1.6 * whole + 1.0)
        end = end_of_round(letters, times, 0, whole, around, flight)
        if end == 0:
            continue
        cycles, x = last.cycles.with_segments(letters[:end], x, times[:end])
        way = np.zeros(len(x))
        way[:START] = start / size
        point = cycles.newton(x, way)
        point = point and admissible(point)
        if point is not None and np.linalg.norm(point.x[:START] - last.x[:START]) < 5.0 * step + 1e-6:
            return point
    return None
