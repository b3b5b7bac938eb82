"""Words continued from the cells of a sweep: the branches of the cycles to which its cells settled.

For the rigid contact without restitution: the flights of a cell with another contact are a guess, which may
not lead to a cycle of the rigid one.
"""

import math
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.branches.continuation import events as events_of
from kernel.branches.continuation import follow
from kernel.branches.cycles import Point
from kernel.branches.descent import ideal_plate, solved
from kernel.branches.events import Events, rows_of
from kernel.branches.folds import Cycle
from kernel.branches.words import Word, WordBranch, from_flights
from kernel.params import KernelInputError, Outcome
from worker import store
from worker.analysis.bisection import BOUNCING
from worker.sweep import SweepSpec

Floats = NDArray[np.float64]

#: Branches followed per line of cells, and points per branch and direction; 0.3 s for each.
MAX_WORDS: Final = 12
POINTS: Final = 400

#: Settled cells of lowest Gamma in a line whose words are followed to their ends.
LOWEST: Final = 3

#: In a settled cell, flights of two rounds of a cycle agree within this, rad.
_REPEATS: Final = 1e-3

#: A cell lies on a branch if its flights are this close to those between two points of it, rad.
_NEAR: Final = 0.02

#: Flights of neighbouring points on a branch differ by less than this, rad.
_STEP: Final = 0.3

#: Events of one kind closer than this in Gamma are one.
_SAME: Final = 1e-9


class Skipped(NamedTuple):
    """A settled cell from which no branch was followed."""

    gamma: float
    bounces: int
    periods: int
    reason: str


class Words(NamedTuple):
    """The branches of one line of cells."""

    branches: tuple[WordBranch, ...]
    events: tuple[Events, ...]  # of each branch
    skipped: tuple[Skipped, ...]


class _Cycle(NamedTuple):
    """One round of a settled cell's flights, in order."""

    omega: float
    xi: float
    gamma: float
    bounces: int
    periods: int
    flight_time: Floats  # (flights,) rad
    takeoff_phase: Floats  # (flights,) rad

    def word(self) -> Word:
        """The cycle as a word. Raises KernelInputError."""
        times, phases = self.flight_time, self.takeoff_phase
        return from_flights(self.omega, self.xi, self.gamma, phases, times, self.periods)

    def skipped(self, reason: str) -> Skipped:
        return Skipped(self.gamma, self.bounces, self.periods, reason)


def continue_words(
    spec: SweepSpec, url: str, direction: int, xi: int, omega: int, gamma_max: float, complete: bool
) -> Words:
    """Follow the cycles of the periodic cells along gamma at these indices of the grid.

    A cell whose cycle lies on an earlier branch is not followed again. Raises a `store.StoreError`.
    """
    branches: list[WordBranch] = []
    events: list[Events] = []
    skipped: list[Skipped] = []
    for cycle in _cycles(spec, _read_line(spec, url, (direction, xi, omega), complete), (xi, omega), skipped):
        if any(_lies_on(cycle, branch) for branch in branches):
            continue
        if len(branches) == MAX_WORDS:
            skipped.append(cycle.skipped(f"{MAX_WORDS} branches were followed before it, the limit"))
            continue
        try:
            branch, turns = follow(cycle.word(), points=POINTS, gamma=(0.0, gamma_max))
        except KernelInputError as error:
            skipped.append(cycle.skipped(str(error)))
            continue
        branches.append(_up_to_shorter(branch, cycle))
        events.append(_once(events_of(turns)))
    return Words(tuple(branches), tuple(events), tuple(skipped))


def lowest_words(
    spec: SweepSpec, url: str, direction: int, xi: int, omega: int, complete: bool
) -> tuple[list[Point], float]:
    """Cycles of settled cells at these indices, up to LOWEST, and the lowest Gamma that bounces.

    Uses the cells of lowest Gamma and omits those that lead to no cycle. Gamma is infinite if no
    cell bounces. Raises a `store.StoreError`.
    """
    arrays = _read_line(spec, url, (direction, xi, omega), complete)
    words: list[Point] = []
    for cycle in islice(_cycles(spec, arrays, (xi, omega), []), LOWEST):
        with suppress(KernelInputError):
            if (point := _point(cycle.word())) is not None:
                words.append(point)
    bouncing = spec.axis_values("gamma")[np.isin(arrays["outcome"], BOUNCING)]
    return words, float(bouncing.min()) if len(bouncing) else math.inf


def _point(word: Word) -> Point | None:
    """The cycle of a word at its Gamma."""
    letters = "".join("S" * (word.letters[n - 1] == "s") + word.letters[n] for n in range(len(word.letters)))
    guess = Cycle(letters, word.periods, np.append(0.0, word.unknowns))
    point = solved(ideal_plate(), word.omega, word.xi, guess)
    return point.cycles.at(point.x, word.gamma)


def _read_line(
    spec: SweepSpec, url: str, line: tuple[int, int, int], complete: bool
) -> dict[str, NDArray[Any]]:
    """The stored cycles along gamma at indices (direction, xi, omega)."""
    names = ["flight_time", "takeoff_phase", "flights", "bounces", "periods", "outcome"]
    direction, xi, omega = line
    return store.read_slice(url, names, direction=direction, xi=xi, omega=omega, complete=complete)


def _cycles(
    spec: SweepSpec, arrays: dict[str, NDArray[Any]], line: tuple[int, int], skipped: list[Skipped]
) -> Iterator[_Cycle]:
    """The cycles of the periodic cells at `line` (xi, omega); skips those that store less than two rounds."""
    xi, omega = (float(spec.axis_values(axis)[i]) for axis, i in zip(("xi", "omega"), line, strict=True))
    gamma = spec.axis_values("gamma")
    # a cell that is filled in from another has no flights
    for i in np.flatnonzero((arrays["outcome"] == Outcome.PERIODIC) & (arrays["flights"] > 0)):
        times, phases = arrays["flight_time"][i], arrays["takeoff_phase"][i]
        stored = min(int(arrays["flights"][i]), len(times))
        bounces, periods = int(arrays["bounces"][i]), int(arrays["periods"][i])
        flights = _round(times[:stored], phases[:stored], bounces)
        last = slice(stored - flights, stored)
        cycle = _Cycle(omega, xi, float(gamma[i]), bounces, periods, times[last], phases[last])
        if flights:
            yield cycle
        else:
            skipped.append(cycle.skipped(f"its {stored} stored flights do not show two rounds: keep more"))


def _round(times: Floats, phases: Floats, bounces: int) -> int:
    """Flights of one round, those too short to count included: at least `bounces`; 0 if none repeats."""
    for n in range(max(bounces, 1), len(times) // 2 + 1):
        turned = np.abs(np.mod(phases[-n:] - phases[-2 * n : -n] + np.pi, 2.0 * np.pi) - np.pi)
        if np.abs(times[-n:] - times[-2 * n : -n]).max() < _REPEATS and turned.max() < _REPEATS:
            return n
    return 0


def _lies_on(cycle: _Cycle, branch: WordBranch) -> bool:
    """Whether a branch passes through a cycle, by its flights at the cycle's Gamma."""
    if branch.periods != cycle.periods or len(branch.word) != len(cycle.flight_time):
        return False
    low, high = branch.gamma[:-1], branch.gamma[1:]
    beside = np.flatnonzero((np.minimum(low, high) <= cycle.gamma) & (cycle.gamma <= np.maximum(low, high)))
    flights = np.sort(branch.flight_time, axis=1)
    for i in beside:
        part = (cycle.gamma - low[i]) / (high[i] - low[i]) if high[i] != low[i] else 0.0
        here = flights[i] + part * (flights[i + 1] - flights[i])
        if np.abs(here - np.sort(cycle.flight_time)).max() < _NEAR:
            return True
    return False


def _up_to_shorter(branch: WordBranch, cycle: _Cycle) -> WordBranch:
    """The part of a branch with the cycle on it, up to where it becomes a repeated shorter cycle.

    There the branch began by a flip; beyond, it returns with its flights in another order.
    """
    flights = len(branch.word)
    away = np.abs(np.sort(branch.flight_time, axis=1) - np.sort(cycle.flight_time)).max(axis=1)
    low, nearest, high = 0, int(np.argmin(away)), len(branch.gamma)
    for n in range(1, flights):
        if flights % n or branch.word != branch.word[:n] * (flights // n):
            continue
        apart = branch.flight_time - np.roll(branch.flight_time, -n, axis=1)
        turns = np.flatnonzero((apart[:-1, 0] > 0.0) != (apart[1:, 0] > 0.0))
        size = np.abs(apart).max(axis=1)
        same = turns[np.minimum(size[turns], size[turns + 1]) < _STEP]
        low = max([low, *(same[same < nearest] + 1).tolist()])
        high = min([high, *(same[same >= nearest] + 1).tolist()])
    return rows_of(branch, slice(low, high))


def _once(events: Events) -> Events:
    """The events without repetitions with the flights in another order; keeps the first along the branch.

    Repetitions differ in the last digits of Gamma, which depend on the processor and decide nothing.
    """
    if not len(events.gamma):
        return events
    order = np.lexsort((events.gamma, events.kind))
    kind, gamma = events.kind[order], events.gamma[order]
    other = (kind[1:] != kind[:-1]) | (np.diff(gamma) >= _SAME)
    return rows_of(
        events, np.sort(np.minimum.reduceat(order, np.flatnonzero(np.concatenate([[True], other]))))
    )
