"""Finds and distinguishes the attractors that many starts of one cell reach (docs/basins.md).

A search is a pure function of its starts. It requests runs and gets their records, so that the caller may
pause between runs and answer from stored records. Starts that end alike are a group, and only representatives
of it run on: so cycles not settled to 1e-4, and slow passages beside unstable cycles, make no attractors.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.params import STATE_FIELDS, Line, Outcome, counted_flights
from worker.basins.plan import REPRESENTATIVES
from worker.basins.specification import BasinSpec
from worker.spec.contact_models import Contact

_Floats = NDArray[np.float64]
_Ints = NDArray[np.intp]
_Flights = NDArray[np.float32]  # (n, START_FLIGHTS)

#: Sorted flights of two cycles of one mode are equal within this, rad.
SAME_CYCLE: Final = 1e-4

#: Starts per run, few enough to lose little and use little memory. A multiple of `kernel.params.LANES`.
BLOCK: Final = 2048

#: Flights of a window in which a cycle is sought: the kernel finds cycles of up to a third as many. With
#: rebound the hops after each landing take their place, and hide the flights that count.
CYCLE_FLIGHTS, CHATTER_FLIGHTS = 256, 4096

#: Flights of a start without a cycle that estimate its distribution.
START_FLIGHTS: Final = 64

#: Representatives of a group of starts on a cycle, and of the aperiodic drops of a cell.
CYCLE_REPRESENTATIVES: Final = 4

#: Plate periods, and maximum flights, for the distribution of an aperiodic representative.
LONG_WINDOW: Final = 2000
LONG_FLIGHTS: Final = 2048

#: Plate periods for measuring exponents.
EXPONENT_WINDOW: Final = 1000

#: Distributions agree within this distance (Kolmogorov and Smirnov), or within HALVES times the distance
#: between the two halves of one run, whichever is larger. The error of a distribution from n flights falls as
#: 1/n on a torus and as 1/sqrt(n) in chaos.
SAME_DISTRIBUTION: Final = 0.05
HALVES: Final = 1.5

#: A cycle of this many flights or more that is not certified belongs to an aperiodic attractor with the same
#: distribution: a torus that almost closes after that many flights looks like the cycle for longer than a
#: window.
LONG_CYCLE: Final = 20

#: Motion is not transient if this many starts are expected to leave it and none does.
EXPECTED: Final = 5.0

#: Transient motion is followed down to this share of all starts, if that takes at most this many times the
#: periods of all starts up to `until`.
LEFT: Final = 0.001
WORTH: Final = 4.0

#: Searches for further aperiodic attractors among the starts farthest from the known ones.
SEARCHES: Final = 4

#: A start still settling belongs to a cycle if each of its flights is this close, rad, to one of the cycle's.
NEAR_CYCLE: Final = 0.02


class Request(NamedTuple):
    """A run requested by a search: n states of one cell, followed for settle + observe plate periods."""

    states: _Floats  # (n, len(STATE_FIELDS))
    settle: int
    observe: int
    keep: int
    exponents: int = 0
    certify: bool = False
    every: bool = False  # whether of every start that is undecided, not of representatives

    def window(self) -> dict[str, Any]:
        """The arguments of `kernel.line.LineRun`."""
        window = self._asdict()
        del window["every"]
        return window


def sizes_of_runs(model: Contact) -> tuple[int, int]:
    """Starts of a run on this contact, and flights kept of each: a product that is the same for all."""
    keep = CYCLE_FLIGHTS if getattr(model, "restitution", 0.0) == 0.0 else CHATTER_FLIGHTS
    return BLOCK * CYCLE_FLIGHTS // keep, keep


#: Answers a request with the arrays that a function returns for its record.
Run = Callable[[Request, Callable[[Line], dict[str, NDArray[Any]]]], dict[str, NDArray[Any]]]


@dataclass
class Attractor:
    """An attractor of one cell. Lengths in plate amplitudes, times in rad."""

    outcome: int  # an Outcome: periodic, aperiodic or at rest
    bounces: int  # 0 without a cycle
    periods: int
    flights: _Floats  # (m,) sorted: of the cycle, or of its representatives
    state: _Floats  # (len(STATE_FIELDS),) on the attractor, at phase 0
    lifetime: float = np.inf  # plate periods; finite if representatives left it
    fraction: float = 0.0
    flight_time: _Floats = field(default_factory=lambda: np.empty(0))  # (keep,) of its window
    takeoff_phase: _Floats = field(default_factory=lambda: np.empty(0))
    lyapunov: _Floats = field(default_factory=lambda: np.empty(0))
    lyapunov_error: float = np.nan

    @property
    def longest_flight(self) -> float:
        """Rad; 0 at rest."""
        return float(self.flights[-1]) if len(self.flights) else 0.0

    @property
    def key(self) -> tuple[float, ...]:
        """The order of attractors with equal fractions."""
        return (self.outcome, self.bounces, self.periods, *self.flights[::-1][:16].tolist())


class Found(NamedTuple):
    """The attractors of a cell, and the one that each start reaches."""

    ids: NDArray[np.uint16]  # (n,) index into `attractors` from 1; 0: undecided
    attractors: tuple[Attractor, ...]  # by fraction, the largest first


class _Ends:
    """The ends of n runs."""

    def __init__(self, n: int) -> None:
        self.outcome = np.zeros(n, np.uint8)
        self.bounces, self.periods = np.zeros((2, n), np.int32)
        self.state = np.zeros((n, len(STATE_FIELDS)))
        self.cycle = np.zeros((n, 4))  # sum, sum of squares, shortest and longest flight
        #: Times and phases of the last flights that count, without a cycle; NaN beyond.
        self.time, self.phase = np.full((2, n, START_FLIGHTS), np.nan, np.float32)


def find(starts: _Floats, spec: BasinSpec, run: Run) -> Found:
    """The attractors that `starts` (n, len(STATE_FIELDS)) of one cell reach.

    `run` answers requests. The result depends only on the arguments.
    """
    return _Search(starts, spec, run).found()


class _Search:
    """The starts of one cell, their ends so far, and the attractors found."""

    def __init__(self, starts: _Floats, spec: BasinSpec, run: Run) -> None:
        self._spec, self._run = spec, run
        self._block, self._keep = sizes_of_runs(spec.model)
        self._until = spec.until
        self._extends = spec.settle_until is None  # transient motion may once continue beyond `until`
        self._owner = np.full(len(starts), -1)  # index into _attractors
        self._attractors: list[Attractor] = []
        self._ends = _Ends(len(starts))
        self._starts = starts

    def found(self) -> Found:
        spec = self._spec
        taken = spec.settle + spec.observe
        everything = np.arange(len(self._starts))
        self._advance(everything, self._starts, spec.settle, spec.observe)
        undecided = self._assign_cycles(everything, taken, spec.observe)
        rate = 0.0
        while len(undecided):
            aperiodic = self._ends.outcome[undecided] == Outcome.APERIODIC
            if self._until - taken < spec.observe and rate > 0.0 and self._extends:
                self._until = max(self._until, taken + self._periods_to_follow(len(undecided), rate))
                self._extends = False
            rate = self._rate_of_leaving(undecided[aperiodic], taken) or rate
            goes_on = undecided if rate > 0.0 else undecided[~aperiodic]
            added = min(taken, self._until - taken)
            if len(goes_on) == 0 or added < spec.observe:
                break
            # a longer window: it shows longer cycles
            observe = min(max(spec.observe, added // 2), LONG_WINDOW)
            self._advance(goes_on, self._ends.state[goes_on], added - observe, observe)
            taken += added
            still_undecided = self._assign_cycles(goes_on, taken, observe)
            if len(still_undecided) == len(goes_on) and rate * added * len(goes_on) > EXPECTED:
                rate = 0.0  # what left before had only been slow to settle
            undecided = np.union1d(np.setdiff1d(undecided, goes_on), still_undecided)
        self._assign_aperiodic(undecided, taken, rate)
        return self._numbered()

    def _advance(self, which: _Ints, states: _Floats, settle: int, observe: int) -> None:
        """Run starts on from `states` and record their ends."""
        for first in range(0, len(which), self._block):
            part = slice(first, first + self._block)
            request = Request(states[part], settle, observe, self._keep, every=True)
            answer = self._run(request, partial(_reduced, micro_flight=self._spec.micro_flight))
            ends, rows = self._ends, which[part]
            for name in ("outcome", "bounces", "periods", "state", "cycle"):
                getattr(ends, name)[rows] = answer[name]
            ends.time[rows] = ends.phase[rows] = np.nan
            without = rows[answer["outcome"] != Outcome.PERIODIC]
            ends.time[without], ends.phase[without] = answer["time"], answer["phase"]

    def _record(self, request: Request) -> Line:
        return Line(**self._run(request, lambda line: line._asdict()))

    def _run_on(self, which: _Ints, taken: int, observe: int, keep: int) -> Line:
        """Run representatives on until `until`, or for another window."""
        settle = max(self._until - taken - observe, self._spec.observe)
        return self._record(Request(self._ends.state[which], settle, observe, keep))

    def _assign_cycles(self, which: _Ints, taken: int, observe: int) -> _Ints:
        """Assign starts at rest or on cycles to attractors; returns the starts without one.

        observe: plate periods of the window that showed the cycles. A shorter one may miss them.
        """
        outcome = self._ends.outcome[which]
        undecided = [which[np.isin(outcome, (Outcome.APERIODIC, Outcome.SETTLING))]]
        groups = _groups_of_cycles(self._ends, which)
        chosen = [_spread(group, CYCLE_REPRESENTATIVES) for group in groups]
        if not groups:
            return undecided[0]
        line = self._run_on(np.concatenate(chosen), taken, observe, self._keep)
        first = 0
        for group, representatives in zip(groups, chosen, strict=True):
            reached = {self._cycle_of(line, i) for i in range(first, first + len(representatives))}
            first += len(representatives)
            if len(reached) == 1 and (owner := reached.pop()) is not None:
                self._owner[group] = owner
            else:
                undecided.append(group)
        return np.sort(np.concatenate(undecided))

    def _cycle_of(self, line: Line, i: int) -> int | None:
        """The attractor on which run i of a record ends, known or new; None without a cycle."""
        if line.outcome[i] not in (Outcome.PERIODIC, Outcome.AT_REST):
            return None
        if (number := self._known_attractor(line, i)) is not None:
            return number
        mode = int(line.outcome[i]), int(line.bounces[i]), int(line.periods[i])
        return self._new(Attractor(*mode, self._cycle(line, i), line.end_state[i].copy()))

    def _cycle(self, line: Line, i: int) -> _Floats:
        """The sorted flights of the cycle on which run i of a record ends."""
        time, _ = counted_flights(line, i, self._spec.micro_flight)
        return np.sort(time[len(time) - line.bounces[i] :])

    def _known_attractor(self, line: Line, i: int) -> int | None:
        """The known attractor on which run i of a record ends; None if there is none."""
        mode, flights = (line.outcome[i], line.bounces[i], line.periods[i]), self._cycle(line, i)
        for number, known in enumerate(self._attractors):
            same = (known.outcome, known.bounces, known.periods) == mode and mode[0] != Outcome.APERIODIC
            if same and np.all(np.abs(known.flights - flights) <= SAME_CYCLE):
                return number
        return None

    def _new(self, attractor: Attractor) -> int:
        self._attractors.append(attractor)
        return len(self._attractors) - 1

    def _rate_of_leaving(self, which: _Ints, taken: int) -> float:
        """Rate of aperiodic motion ending on a cycle or at rest, per plate period, from representatives."""
        if len(which) == 0:
            return 0.0
        representatives = _spread(which, REPRESENTATIVES)
        line = self._run_on(representatives, taken, self._spec.observe, self._keep)
        left = int(np.isin(line.outcome, (Outcome.PERIODIC, Outcome.AT_REST)).sum())
        followed = max(self._until - taken, 2 * self._spec.observe)
        return left / (followed * (len(representatives) - 0.5 * left))

    def _periods_to_follow(self, starts: int, rate: float) -> int:
        """Plate periods until only LEFT of all starts remain, if `starts` of them leave at this rate.

        0 if that costs more than WORTH times all starts up to `until`.
        """
        share = starts / len(self._owner)
        periods = math.log(max(share / LEFT, 1.0)) / rate
        return math.ceil(periods) if share * periods <= WORTH * self._spec.until else 0

    def _assign_aperiodic(self, which: _Ints, taken: int, rate: float) -> None:
        """Assign starts without a cycle to attractors, which differ in the distribution of flights."""
        settling = which[self._ends.outcome[which] == Outcome.SETTLING]
        for number, attractor in enumerate(self._attractors):
            self._owner[settling[_near(self._ends.time[settling], attractor.flights)]] = number
        unsettled = which[(self._owner[which] < 0) & (self._ends.outcome[which] != Outcome.APERIODIC)]
        which = which[self._ends.outcome[which] == Outcome.APERIODIC]
        samples: list[_Sample] = []
        groups: list[list[int]] = []
        chosen, flights = _spread(which, REPRESENTATIVES), (self._ends.time[which], self._ends.phase[which])
        for _ in range(SEARCHES if len(which) else 0):
            line = self._run_on(chosen, taken, LONG_WINDOW, LONG_FLIGHTS)
            samples += self._samples(line)
            before, groups = len(groups), _linked(samples)
            if len(groups) == before or len(chosen) == len(which):
                break
            _, distance = _nearest(flights, samples, groups)
            chosen = which[np.argsort(-distance, kind="stable")[:REPRESENTATIVES]]
        if not groups:
            return
        nearest, distance = _nearest(flights, samples, groups)
        numbers = np.array([self._new(_pooled([samples[i] for i in group], rate)) for group in groups])
        self._owner[which] = numbers[nearest]
        self._join_long_cycles(numbers.tolist())
        if len(unsettled):
            # On a torus beside a locked one flights seem to repeat, or to settle, for longer than a window.
            widest = np.array([distance[nearest == g].max(initial=0.0) for g in range(len(groups))])
            nearest, distance = _nearest(self._last_flights(unsettled), samples, groups)
            within = distance <= widest[nearest]
            self._owner[unsettled[within]] = numbers[nearest[within]]

    def _join_long_cycles(self, numbers: Sequence[int]) -> None:
        """Add the starts of long cycles to the aperiodic attractor with their distribution."""
        for number, known in enumerate(self._attractors[: numbers[0]]):
            if known.bounces < LONG_CYCLE:
                continue
            apart = [ks_distance(known.flights, self._attractors[other].flights) for other in numbers]
            if min(apart) <= SAME_DISTRIBUTION and not self._is_certified(known):
                self._owner[self._owner == number] = numbers[int(np.argmin(apart))]

    def _is_certified(self, cycle: Attractor) -> bool:
        if not self._spec.model.certifies:
            return False
        request = Request(cycle.state[None], 0, LONG_WINDOW, CYCLE_FLIGHTS, certify=True)
        return bool(np.isfinite(self._record(request).flight_error[0]))

    def _last_flights(self, which: _Ints) -> tuple[_Flights, _Flights]:
        """Flights of one more window of starts with any outcome: times and phases."""
        parts = []
        for first in range(0, len(which), self._block):
            states = self._ends.state[which[first : first + self._block]]
            request = Request(states, 0, self._spec.observe, self._keep, every=True)
            reduce = partial(_ends_of_flights, micro_flight=self._spec.micro_flight)
            parts.append(self._run(request, reduce))
        time, phase = (np.concatenate([part[name] for part in parts]) for name in ("time", "phase"))
        return time, phase

    def _samples(self, line: Line) -> list["_Sample"]:
        """The runs of a record that end on an unknown attractor: aperiodic, or on long cycles."""
        samples = []
        for i in range(len(line.outcome)):
            time, phase = counted_flights(line, i, self._spec.micro_flight)
            ended = line.outcome[i] not in (Outcome.DIVERGED, Outcome.UNRESOLVED)
            if ended and len(time) > 1 and self._known_attractor(line, i) is None:
                mode = int(line.bounces[i]), int(line.periods[i])
                samples.append(_Sample(time, phase, line.end_state[i].copy(), mode))
        return samples

    def _numbered(self) -> Found:
        counts = np.bincount(self._owner[self._owner >= 0], minlength=len(self._attractors))
        order = sorted(np.flatnonzero(counts).tolist(), key=lambda i: (-counts[i], *self._attractors[i].key))
        ids = np.zeros(len(self._attractors) + 1, np.uint16)  # the last one is of starts without an owner
        for rank, number in enumerate(order):
            ids[number] = rank + 1
            self._attractors[number].fraction = float(counts[number] / len(self._owner))
        attractors = tuple(self._attractors[i] for i in order)
        if attractors:
            self._observe(attractors)
        return Found(ids[self._owner], attractors)

    def _observe(self, attractors: Sequence[Attractor]) -> None:
        """Record a window of each attractor, and its exponents."""
        spec = self._spec
        states = np.stack([attractor.state for attractor in attractors])
        line = self._record(Request(states, 0, spec.observe, spec.keep))
        for i, attractor in enumerate(attractors):
            attractor.flight_time, attractor.takeoff_phase = line.flight_time[i], line.takeoff_phase[i]
        if spec.exponents:
            window = EXPONENT_WINDOW
            line = self._record(Request(states, 2 * window, window, 1, spec.exponents))
            for i, attractor in enumerate(attractors):
                attractor.lyapunov, attractor.lyapunov_error = line.lyapunov[i], float(line.lyapunov_error[i])


class _Sample(NamedTuple):
    """Flights of an aperiodic run, in order."""

    time: _Floats
    phase: _Floats
    state: _Floats
    mode: tuple[int, int]  # of a long cycle; (0, 0) without one


def _reduced(line: Line, micro_flight: float) -> dict[str, NDArray[Any]]:
    """The kept part of a record of n runs: `_Ends`, with flights only of the runs without a cycle."""
    cycle = np.zeros((len(line.outcome), 4))
    for i in np.flatnonzero(line.outcome == Outcome.PERIODIC).tolist():
        last = counted_flights(line, i, micro_flight)[0][-line.bounces[i] :]
        cycle[i] = last.sum(), (last * last).sum(), last.min(), last.max()
    return {
        "outcome": line.outcome, "bounces": line.bounces, "periods": line.periods, "state": line.end_state,
        "cycle": cycle, **_ends_of_flights(line, micro_flight, line.outcome != Outcome.PERIODIC),
    }  # fmt: skip


def _ends_of_flights(
    line: Line, micro_flight: float, which: NDArray[np.bool_] | None = None
) -> dict[str, NDArray[Any]]:
    """Times and phases of the last START_FLIGHTS flights of some or all runs, NaN beyond."""
    runs = np.arange(len(line.outcome)) if which is None else np.flatnonzero(which)
    ends = np.full((2, len(runs), START_FLIGHTS), np.nan, np.float32)
    for row, i in enumerate(runs.tolist()):
        for values, flights in zip(ends, counted_flights(line, i, micro_flight), strict=True):
            last = flights[-START_FLIGHTS:]
            values[row, : len(last)] = last
    return {"time": ends[0], "phase": ends[1]}


def _groups_of_cycles(ends: _Ends, which: _Ints) -> list[_Ints]:
    """Groups of starts that end at rest, or on cycles of one mode with nearly equal flights."""
    rest = which[ends.outcome[which] == Outcome.AT_REST]
    cycles = which[ends.outcome[which] == Outcome.PERIODIC]
    groups = [rest] if len(rest) else []
    if len(cycles) == 0:
        return groups
    modes = np.stack([ends.bounces[cycles], ends.periods[cycles]], axis=1)
    label = np.unique(modes, axis=0, return_inverse=True)[1].reshape(-1)
    bounces = ends.bounces[cycles]
    steps = (bounces, 2.0 * ends.cycle[cycles, 0] + 1.0, np.ones(len(cycles)), np.ones(len(cycles)))
    for step, values in zip(steps, ends.cycle[cycles].T, strict=True):
        order = np.lexsort((values, label))
        wide = np.diff(values[order]) > SAME_CYCLE * step[order][1:]
        label[order] = np.cumsum(np.concatenate([[False], wide | (np.diff(label[order]) != 0)]))
    order = np.argsort(label, kind="stable")
    return groups + np.split(cycles[order], np.flatnonzero(np.diff(label[order])) + 1)


def _spread(which: _Ints, count: int) -> _Ints:
    """At most `count` of the starts, evenly spaced."""
    return which[np.unique(np.linspace(0, len(which) - 1, min(count, len(which))).round().astype(np.intp))]


def _near(time: _Flights, flights: _Floats) -> NDArray[np.bool_]:
    """(n,) whether each flight in a row of `time` (n, m) is close to one of the sorted `flights`."""
    if len(flights) == 0:
        return np.zeros(len(time), np.bool_)
    index = np.searchsorted(flights, time)
    below, above = flights[np.maximum(index - 1, 0)], flights[np.minimum(index, len(flights) - 1)]
    near = np.minimum(np.abs(time - below), np.abs(above - time)) <= NEAR_CYCLE
    flown = np.isfinite(time)
    return np.asarray(np.all(near | ~flown, axis=1) & flown.any(axis=1))


def _features(time: _Floats, phase: _Floats) -> tuple[_Floats, ...]:
    """Features of flights to compare: their times, and sine and cosine of their take-off phases."""
    return time, np.sin(phase), np.cos(phase)


def ks_distance(a: _Floats, b: _Floats) -> float:
    """The two-sample statistic of Kolmogorov and Smirnov: 0 for equal, 1 for separate distributions."""
    both = np.sort(np.concatenate([a, b]))
    below_a, below_b = (np.searchsorted(np.sort(x), both, "right") / len(x) for x in (a, b))
    return float(np.abs(below_a - below_b).max())


def _distance_of_rows(time: _Flights, phase: _Flights, pool_time: _Floats, pool_phase: _Floats) -> _Floats:
    """(n,) the distance of each row (n, m) of flights from a pool of flights; NaN is no flight."""
    distance = np.zeros(len(time))
    pools = _features(pool_time, pool_phase)
    for pool, rows in zip(pools, _features(time.astype(float), phase.astype(float)), strict=True):
        values = np.sort(rows, axis=1)  # NaN last
        count = np.isfinite(values).sum(axis=1)
        ordered = np.sort(pool)
        below, up_to = (np.searchsorted(ordered, values, side) / len(pool) for side in ("left", "right"))
        rank = np.arange(values.shape[1])
        size = np.maximum(count, 1)[:, None]
        apart = np.maximum((rank + 1) / size - up_to, below - rank / size)
        distance = np.maximum(distance, np.where(rank < count[:, None], apart, 0.0).max(axis=1))
    return distance


def _nearest(
    flights: tuple[_Flights, _Flights], samples: Sequence[_Sample], groups: Sequence[Sequence[int]]
) -> tuple[_Ints, _Floats]:
    """The group nearest to each start, and its distance, (n,) each; flights: times and phases (n, m)."""
    pools = [[np.concatenate([samples[i][field] for i in group]) for field in (0, 1)] for group in groups]
    distances = np.stack([_distance_of_rows(*flights, *pool) for pool in pools])
    return distances.argmin(axis=0), distances.min(axis=0)


def _linked(samples: Sequence[_Sample]) -> list[list[int]]:
    """Groups of samples whose distributions agree, directly or through others."""
    features = [_features(sample.time, sample.phase) for sample in samples]
    noise = [max(ks_distance(x[: len(x) // 2], x[len(x) // 2 :]) for x in feature) for feature in features]

    def agree(i: int, j: int) -> bool:
        allowed = max(SAME_DISTRIBUTION, HALVES * max(noise[i], noise[j]))
        return all(ks_distance(x, y) <= allowed for x, y in zip(features[i], features[j], strict=True))

    groups: list[list[int]] = []
    for i in range(len(samples)):
        linked, others = [i], []
        for group in groups:
            if any(agree(i, j) for j in group):
                linked += group
            else:
                others.append(group)
        groups = [*others, sorted(linked)]
    return sorted(groups)


def _pooled(samples: Sequence[_Sample], rate: float) -> Attractor:
    """The attractor of samples that agree."""
    lifetime = 1.0 / rate if rate > 0.0 else np.inf
    modes = {sample.mode for sample in samples}
    if len(modes) == 1 and samples[0].mode[0]:
        bounces, periods = samples[0].mode
        cycle = np.sort(samples[0].time[-bounces:])
        return Attractor(int(Outcome.PERIODIC), bounces, periods, cycle, samples[0].state, lifetime)
    flights = np.sort(np.concatenate([sample.time for sample in samples]))
    return Attractor(int(Outcome.APERIODIC), 0, 0, flights, samples[0].state, lifetime)
