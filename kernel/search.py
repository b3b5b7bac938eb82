"""Where bouncing ends on the way down, by search: at low damping no list of short cycles decides it.

First the branches beside those of the closed form are followed. Then many starts run at many Gammas below
their lowest end, or below the Gamma at which rest ends. Transients pass by cycles, stable or not: from their
states Newton's method finds the cycles, and the branches through them lead to stable cycles that no start
reaches. Other motions that survive long runs are carried down in small steps.
"""

import math
from collections.abc import Iterator
from fractions import Fraction
from typing import Any, Final, NamedTuple

import numpy as np

from kernel.creep import LONGEST, Crept, creep, rotation, run
from kernel.cycles.any_contact import both_ways, lies_on, repeats, seeds
from kernel.cycles.contact_thresholds import above, lowest_stable, rest_ends
from kernel.cycles.cycles import LANDINGS, Point, admissible, cycle_from, read
from kernel.cycles.descent import Descent, cycle_of, descend, ended, fold_of, folds_of_twice
from kernel.cycles.events import Kind
from kernel.cycles.follow import Followed
from kernel.cycles.roots import Floats
from kernel.cycles.starts import cycles_at, start_on_cycle
from kernel.cycles.thresholds import closed_form
from kernel.numerics.elementary import TWO_PI
from kernel.params import Cell, Line, Outcome

#: Of a search, by default.
EFFORT: Final = 50.0
#: Number of Gammas in a round, and the first and last: relative distance from the lowest end, and part of it.
_GAMMAS, _BELOW, _LOWEST = 30, 3e-4, 0.3
_ROUNDS: Final = 4
#: A cycle is read this far above a fold, relative.
_ABOVE: Final = 1e-6
#: Branches are followed down to this part of where rest ends.
_DEEPEST: Final = 0.01

#: Plate periods of successive runs, after each of which states of transients are taken; those that survivors
#: then run; and the longest of the former after which all starts still run on.
_LOOKS, _FOLLOWED, _TRANSIENT = (5, 10, 20, 40, 80, 160), 5_000, 40
#: Starts that run on longer at each Gamma, and most motions that are carried down.
_MOST, _CARRIED = 32, 12

#: Newton's method begins at this part of all starts after each run, for cycles of up to this many plate
#: periods, if the error of their equations is between these.
_SEEDS, _PERIODS, _NEAR, _FAR = 0.1, 18, 1e-6, 0.5
#: Points of a branch each way.
_POINTS: Final = 300
#: A rotation number this close to a fraction with up to this denominator is locked.
_EXACTLY, _LOCKED = 1e-10, 64
#: Largest multiplier of a cycle at an event next to which a cycle is stable.
_CRITICAL: Final = 1.001

#: Plate periods of the cycles in closed form beside which starts lie, their relative distances, and starts at
#: each.
_NEAR_PERIODS, _BESIDE, _OF_EACH = 3, (1e-3, 1e-2, 0.05), 8


class Searched(NamedTuple):
    """The lowest end that a search finds."""

    gamma: float  # at which bouncing ends; NaN: nothing bounces below where rest ends
    what: str  # ends there
    starts: int  # at each Gamma
    gone: float = math.nan  # the Gamma below it at which a motion that was carried down no longer bounces
    rotation: float = math.nan  # of a torus, in turns for each round of the cycle inside it
    rotation_error: float = math.nan

    @property
    def missed(self) -> float:
        """The share of all starts of a basin that the starts at one Gamma find with a probability of 95 %."""
        return 1.0 - math.pow(0.05, 1.0 / self.starts)


def starts_of(effort: float) -> int:
    """Starts at each Gamma, from 100 to 10,000, for an effort from 0 to 100."""
    return round(100.0 * math.pow(10.0, effort / 50.0))


def search(plate: Any, omega: float, xi: float, *, effort: float = EFFORT) -> Searched:
    """The lowest Gamma at which a spring bounces. plate: of one cell. Raises KernelInputError.

    Starts lie between the lowest known end, where rest or a branch beside the closed form ends, and _LOWEST
    of it.
    """
    return _Search(plate, omega, xi, starts_of(effort)).lowest()


class _Search:
    """The branches of one spring that were followed, and the lowest end."""

    def __init__(self, plate: Any, omega: float, xi: float, starts: int) -> None:
        self.plate, self.omega, self.xi, self.starts = plate, omega, xi, starts
        self.rng = np.random.default_rng(0)
        self.top = rest_ends(plate, omega, xi)
        self.end = Searched(math.nan, "", starts)
        self.lines: list[Followed] = []
        self.carried = 0

    @property
    def bound(self) -> float:
        """The Gamma below which an end is sought."""
        return self.top if math.isnan(self.end.gamma) else self.end.gamma

    def lowest(self) -> Searched:
        """Search below the last end until nothing is found."""
        for point in self._beside_closed_form():
            self._follow(point)
        for _ in range(_ROUNDS):
            bound = self.bound
            self._look(bound * (1.0 - np.geomspace(_BELOW, 1.0 - _LOWEST, _GAMMAS)))
            if not self.bound < bound:
                break
        return self.end

    def _beside_closed_form(self) -> Iterator[Point]:
        """Cycles beside those of the closed form: stable ones, and those at folds."""
        for periods in range(1, _NEAR_PERIODS + 1):
            yield from seeds(self.plate, self.omega, self.xi, periods)
        folds = closed_form(self.omega, self.xi).minima
        yield from above(self.plate, self.omega, self.xi, folds, (_ABOVE,))

    def _look(self, values: Floats) -> None:
        """Run starts at these Gammas; follow cycles beside their transients, and the survivors."""
        starts = [_starts(self.rng, Cell(float(x), self.omega, self.xi), self.starts) for x in values]
        gamma, state = np.repeat(values, list(map(len, starts))), np.concatenate(starts)
        transients = []
        for settle in _LOOKS:
            line = run(self.plate, gamma, self.omega, self.xi, state, settle, 8)
            left = np.flatnonzero(line.outcome != Outcome.AT_REST)
            if settle > _TRANSIENT:
                left = np.concatenate([left[gamma[left] == x][:_MOST] for x in values])
            gamma, state = gamma[left], line.end_state[left]
            if not len(gamma):
                break
            some = self.rng.permutation(len(gamma))[: round(_SEEDS * self.starts)]
            transients += list(zip(gamma[some].tolist(), state[some], strict=True))
        for point in self._cycles(transients):
            self._follow(point)
        if len(gamma):
            line = run(self.plate, gamma, self.omega, self.xi, state, _FOLLOWED, 100)
            for i in _lowest_of_each(line, gamma):
                cell = Cell(float(gamma[i]), self.omega, self.xi)
                self._down(cell, int(line.periods[i]), line.end_state[i])

    def _cycles(self, states: list[tuple[float, Floats]]) -> list[Point]:
        """The cycles that Newton's method finds beside states, each once, the shortest first."""
        points: dict[tuple[object, ...], Point] = {}
        for gamma, state in states:
            for periods in range(1, _PERIODS + 1):
                guess = read(self.plate, Cell(gamma, self.omega, self.xi), periods, state)
                if guess is None or not _NEAR < np.abs(guess[0].equations(guess[1]).value).max() < _FAR:
                    continue
                solved = guess[0].about(guess[1], gamma)
                point = None if solved is None else admissible(solved)
                if point is not None and not repeats(point):
                    begin = _first(point)
                    key = (gamma, np.roll(point.times, -begin).round(6).tobytes())
                    points.setdefault(key, point.begun(begin) if key not in points else point)
        return sorted(points.values(), key=lambda point: (point.cycles.periods, len(point.letters)))

    def _follow(self, point: Point) -> None:
        """The branch through a cycle, unless it is known, and the ends of all stable cycles on it."""
        if any(lies_on(point, line) for line in self.lines):
            return
        line = both_ways(point, (_DEEPEST * self.top, max(self.top, point.parameter)), _POINTS)
        self.lines.append(line)
        for event in line.events:
            mu = np.abs(event.point.multipliers[0])
            if event.point.parameter >= self.bound or not mu < _CRITICAL:
                continue
            folds = [fold_of(event)] if event.kind is Kind.FOLD else []
            if event.kind is Kind.FLIP:
                folds = folds_of_twice(event.point, self.bound)
            elif event.kind is Kind.NEIMARK_SACKER:
                self._ends(ended(event))
            for fold in folds:
                if fold.curvature > 0.0 and fold.holds:
                    self._ends(Descent(fold.gamma, fold, ""))
        for lowest in lowest_stable(line):
            self._ends(descend(lowest))

    def _ends(self, end: Descent) -> None:
        """Note the end of a stable cycle; carry a motion that bounces beyond it down."""
        if end.gamma < self.bound and (end.fold or end.reason):  # not at rest
            self.end = Searched(end.gamma, end.fold.name if end.fold else end.reason, self.starts)
            if end.last is not None:
                self._down(end.last.cell, 0, end.last.state)

    def _down(self, cell: Cell, periods: int, state: Floats) -> None:
        """Follow a motion down to its end: a stable cycle along its branch, others by steps."""
        while self.carried < _CARRIED:
            cycle = cycle_from(self.plate, cell, periods, state) if 0 < periods <= LONGEST else None
            if cycle is not None and cycle.stable:
                self._follow(cycle.begun(_first(cycle)))
                return
            self.carried += 1
            crept = creep(self.plate, cell, state, self.rng)
            if crept is None:
                return
            cell, state = crept.cell, crept.line.end_state[0]
            if cell.gamma < self.bound:
                self.end = self._named(crept)
            if not math.isnan(crept.gone):
                return
            periods = crept.periods

    def _named(self, crept: Crept) -> Searched:
        """The end of a motion that was carried down."""
        line = crept.line
        torus = rotation(self.plate, crept.cell, line.end_state[0])
        mode = f"({line.bounces[0]},{line.periods[0]})" if line.periods[0] else ""
        what, number, error = mode or "an aperiodic motion", math.nan, math.nan
        if torus is not None:
            what, number, error = f"a torus around {cycle_of(torus.around).name}", torus.number, torus.error
            part = Fraction(number).limit_denominator(_LOCKED)
            locked = f"to {mode}" if mode else str(part) if abs(number - part) < _EXACTLY else ""
            what += f", locked {locked}" if locked else ""
        return Searched(crept.cell.gamma, what, self.starts, crept.gone, number, error)


def _first(point: Point) -> int:
    """The segment at which a cycle begins: after a landing, with the letters first in order.

    Of equal ones, the segment after the longest flight.
    """

    def begins(j: int) -> tuple[str, float]:
        return point.letters[j:] + point.letters[:j], -point.times[j - 1]

    return min((j for j in range(len(point.letters)) if point.letters[j - 1] in LANDINGS), key=begins)


def _lowest_of_each(line: Line, gamma: Floats) -> list[int]:
    """Indices of the survivors of lowest Gamma, one of each mode; aperiodic ones are one mode."""
    modes: dict[tuple[int, int], int] = {}
    left = np.flatnonzero(line.outcome != Outcome.AT_REST)
    for i in left[np.argsort(gamma[left], kind="stable")]:
        modes.setdefault((int(line.bounces[i]), int(line.periods[i])), int(i))
    return list(modes.values())


def _starts(rng: np.random.Generator, cell: Cell, count: int) -> Floats:
    """States (n, 6): `random_starts`, and states beside the admissible cycles of the closed form."""
    rows = [random_starts(rng, cell.gamma, cell.omega, count)]
    for periods in range(1, _NEAR_PERIODS + 1):
        line = cycles_at(cell, periods)
        for t in line.flight_time[line.violations == 0].tolist():
            start = start_on_cycle(cell, periods, t)
            if start is not None:
                beside = np.tile(start.start.state, (len(_BESIDE) * _OF_EACH, 1))
                distance = np.repeat(_BESIDE, _OF_EACH)[:, None]
                beside[:, 2:] *= 1.0 + distance * rng.normal(size=beside[:, 2:].shape)  # zero stays zero
                rows.append(beside)
    return np.concatenate(rows)


def random_starts(rng: np.random.Generator, gamma: float, omega: float, count: int) -> Floats:
    """States (count, 6): half in flight, half in contact at phase 0, as far from rest as long hops go."""
    states = np.zeros((count, 6))
    half, size, speed = count // 2, omega * omega / gamma, omega / gamma
    turn, far = rng.uniform(0.0, TWO_PI, count), rng.exponential(1.5, count)
    states[:, 4] = -size + size * far * np.cos(turn)
    states[:, 5] = speed * far * np.sin(turn)
    states[:half, 0] = rng.uniform(0.0, TWO_PI, half)
    states[:half, 1] = 1.0
    fall = rng.uniform(0.0, 2.0 * TWO_PI, half)  # rad that a fall from the height takes
    states[:half, 2] = 0.5 * fall * fall / gamma
    states[:half, 3] = np.sin(states[:half, 0]) + rng.normal(0.0, 2.0, half) / gamma
    states[:half, 4] += size
    return states
