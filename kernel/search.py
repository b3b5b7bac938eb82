"""Where bouncing ends on the way down by search: at low damping no list of short cycles decides it.

Many starts at many Gammas below that at which rest ends, long runs in lanes. What survives is followed down:
a cycle by continuation to its fold, flip or end, everything else by a ramp in small steps.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np

from kernel.cycles.contact_thresholds import rest_ends
from kernel.cycles.cycles import Point, cycle_from
from kernel.cycles.descent import Descent, descend
from kernel.cycles.roots import Floats
from kernel.cycles.starts import cycles_at, start_on_cycle
from kernel.line import run_line
from kernel.numerics.elementary import TWO_PI
from kernel.params import Cell, Line, Outcome, Start

#: Plate periods before a start is looked at, and those for which what bounces then is followed.
SETTLE: Final = 3_000
FOLLOWED: Final = 20_000

#: Starts of one Gamma that are followed: those that bounce are on few attractors.
_MOST: Final = 24

#: The highest Gamma of a round lies so far below what bounds it, relative; each round begins at the end that
#: the last found.
_BELOW: Final = 3e-4
_ROUNDS: Final = 6

#: Cycles of the closed form beside which starts lie, how far, relative, and starts at each distance.
_PERIODS: Final = 3
_BESIDE: Final = (1e-3, 1e-2, 0.05)
_OF_EACH: Final = 8

#: Cells of a ramp down, the part of Gamma that it descends, and plate periods of each.
_CELLS, _DESCENDS, _STAY = 200, 0.02, 1_000
#: The lowest cells of a ramp of which one must bounce on as a survivor does.
_TRIED: Final = 40
#: Ramps, one after the other, each with a cycle followed from its end if it is one.
_RAMPS: Final = 12

#: Plate periods of cycles that are followed.
_LONGEST: Final = 16


class Searched(NamedTuple):
    """The lowest end that a search finds."""

    gamma: float  # at which bouncing ends; NaN: nothing bounces below the bound
    what: str  # ends there
    starts: int  # at each Gamma

    @property
    def missed(self) -> float:
        """A basin of this share of all starts would have been found with 95 % at a Gamma that has it."""
        return 1.0 - math.pow(0.05, 1.0 / self.starts)


def search(
    plate: Any, omega: float, xi: float, *, starts: int = 400, gammas: int = 30, lowest: float = 0.3,
    seed: int = 0,
) -> Searched:  # fmt: skip
    """The lowest Gamma at which something bounces, searched from where rest ends down to `lowest` of it.

    plate: of one cell. starts: at each of `gammas` values, beside those near cycles of the closed form.
    """
    rng = np.random.default_rng(seed)
    top = rest_ends(plate, omega, xi)
    end: Descent | None = None
    for _ in range(_ROUNDS):
        bound = top if end is None else end.gamma
        if not bound * (1.0 - _BELOW) > lowest * top:
            break
        values = bound * (1.0 - np.geomspace(_BELOW, 1.0 - lowest * top / bound, gammas))
        lower = _lowest_end(plate, Cell(bound, omega, xi), values, rng, starts)
        if lower is None or lower.gamma >= bound:
            break
        end = lower
    if end is None:
        return Searched(math.nan, "", starts)
    return Searched(end.gamma, end.reason if end.fold is None else end.fold.name, starts)


def _lowest_end(
    plate: Any, spring: Cell, values: Floats, rng: np.random.Generator, starts: int
) -> Descent | None:
    """The lowest end of what bounces at these Gammas; None if nothing does."""
    _, omega, xi = spring
    states = [_starts(rng, gamma, omega, xi, starts) for gamma in values]
    gamma = np.repeat(values, [len(each) for each in states])
    line = _run(plate, gamma, omega, xi, np.concatenate(states), SETTLE)
    bouncing = np.flatnonzero(line.outcome != Outcome.AT_REST)
    chosen = np.concatenate([np.empty(0, np.intp), *(bouncing[gamma[bouncing] == g][:_MOST] for g in values)])
    if not len(chosen):
        return None
    gamma = gamma[chosen]
    line = _run(plate, gamma, omega, xi, line.end_state[chosen], FOLLOWED)
    ends = [_down(plate, Cell(float(gamma[i]), omega, xi), line, i) for i in _lowest_of_each(line, gamma)]
    return min(ends, key=lambda end: end.gamma, default=None)


def _lowest_of_each(line: Line, gamma: Floats) -> list[int]:
    """The survivor of lowest Gamma of each mode; aperiodic ones are one mode."""
    modes: dict[tuple[int, int], int] = {}
    left = np.flatnonzero(line.outcome != Outcome.AT_REST)
    for i in left[np.argsort(gamma[left], kind="stable")]:
        modes.setdefault((int(line.bounces[i]), int(line.periods[i])), int(i))
    return list(modes.values())


def _down(plate: Any, cell: Cell, line: Line, i: int) -> Descent:
    """Where what a cell of a line settled to ends on the way down."""
    state, end = line.end_state[i], Descent(cell.gamma, None, "bounces, followed to no end")
    for _ in range(_RAMPS):
        cycle = _cycle(plate, cell, int(line.periods[i]), state)
        if cycle is not None and (here := descend(cycle)).gamma <= cell.gamma:
            end = here
            if end.fold is not None:
                return end
        values = cell.gamma * np.linspace(1.0, 1.0 - _DESCENDS, _CELLS)
        begin = Start(state, cell)
        line = run_line(
            values, np.full(_CELLS, cell.omega), np.full(_CELLS, cell.xi), plate=_cells(plate, _CELLS),
            carry=True, settle=_STAY, observe=60, keep=64, start=begin,
        )  # fmt: skip
        resting = np.flatnonzero(line.outcome == Outcome.AT_REST)
        last = int(resting[0]) if len(resting) else _CELLS
        if last == 0:
            return end
        lowest = slice(max(last - _TRIED, 0), last)
        line = _run(plate, values[lowest], cell.omega, cell.xi, line.end_state[lowest], FOLLOWED)
        bouncing = np.flatnonzero(line.outcome != Outcome.AT_REST)
        if not len(bouncing):
            return end
        values, i = values[lowest], int(bouncing[-1])
        cell, state = cell._replace(gamma=float(values[i])), line.end_state[i]
        mode = f"({line.bounces[i]},{line.periods[i]})" if line.periods[i] else "an aperiodic motion"
        if cell.gamma < end.gamma:
            end = Descent(cell.gamma, None, f"{mode}, crept down")
        if len(resting):
            cycle = _cycle(plate, cell, int(line.periods[i]), state)
            here = end if cycle is None else descend(cycle)
            return here if here.fold is not None and here.gamma <= cell.gamma else end
    return end


def _cycle(plate: Any, cell: Cell, periods: int, state: Floats) -> Point | None:
    """The stable cycle near a state, if it is one."""
    point = cycle_from(plate, cell, periods, state) if 0 < periods <= _LONGEST else None
    return point if point is not None and point.stable else None


def _run(plate: Any, gamma: Floats, omega: float, xi: float, states: Floats, settle: int) -> Line:
    """Cells from states of their own."""
    one = np.ones(len(gamma))
    return run_line(
        gamma, omega * one, xi * one, plate=_cells(plate, len(gamma)), carry=False, states=states,
        settle=settle, observe=100, keep=64,
    )  # fmt: skip


def _cells(plate: Any, count: int) -> Any:
    """The plate of one cell under `count`."""
    return plate._replace(
        **{name: np.repeat(x, count) for name, x in plate._asdict().items() if isinstance(x, np.ndarray)}
    )


def _starts(rng: np.random.Generator, gamma: float, omega: float, xi: float, count: int) -> Floats:
    """States (n, 6): `random_starts`, and beside the admissible cycles of the closed form."""
    cell = Cell(float(gamma), omega, xi)
    rows = [random_starts(rng, float(gamma), omega, count)]
    for periods in range(1, _PERIODS + 1):
        line = cycles_at(cell, periods)
        for t in line.flight_time[line.violations == 0].tolist():
            start = start_on_cycle(cell, periods, t)
            if start is not None:
                beside = np.tile(start.start.state, (len(_BESIDE) * _OF_EACH, 1))
                away = np.repeat(_BESIDE, _OF_EACH)[:, None]
                beside[:, 2:] *= 1.0 + away * rng.normal(size=beside[:, 2:].shape)  # zero stays zero
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
