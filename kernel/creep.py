"""Motions that are not cycles: how far down in Gamma they bounce, and the rotation numbers of tori."""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.cycles.any_contact import repeats
from kernel.cycles.cycles import Point, cycle_from
from kernel.cycles.roots import Floats
from kernel.line import run_line
from kernel.numerics.elementary import TWO_PI
from kernel.params import Cell, Line, Outcome, Start

#: Steps of Gamma, relative: the first, the largest, the smallest.
_FIRST, _LARGEST, _SMALLEST = 1e-3, 4e-3, 1e-6
#: Plate periods after each step, and after one smaller than this, relative.
_STAY, _FINE_STAY, _FINE = 3_000, 20_000, 1e-4
#: Copies of a motion, their relative spread, and most steps.
_COPIES, _SPREAD, _STEPS = 16, 1e-5, 150
#: Plate periods that a copy must outlive at the end; otherwise all are transients. A torus settles as long.
_LONG: Final = 200_000
#: Longest cycle, in plate periods, that ends the steps; longer ones are carried on as other motions.
LONGEST: Final = 24

#: Rounds of a torus, most plate periods of the cycle inside it, and states from which the cycle is sought.
_ROUNDS, _AROUND, _GUESSES = 6_000, 8, 16
#: Relative steps of differences of the map around that cycle, and the least value that they are relative to.
_DIFFERENCE: Final = 1e-6
#: Largest change of a rotation number from a half of the turns, or from before: absolute, and relative.
_CHANGE, _RELATIVE_CHANGE = 1e-4, 0.1
#: Its error in such changes: a motion may still approach its torus.
_CAUTION: Final = 3.0


class Crept(NamedTuple):
    """The lowest Gamma to which a motion is carried."""

    cell: Cell
    line: Line  # of the copies that bounce there
    gone: float = np.nan  # the Gamma below it at which all copies came to rest; NaN: none

    @property
    def periods(self) -> int:
        """Plate periods of the cycle that all copies have settled to; 0 without one."""
        modes = set(zip(self.line.bounces.tolist(), self.line.periods.tolist(), strict=True))
        return modes.pop()[1] if len(modes) == 1 else 0


class Rotation(NamedTuple):
    """The rotation of a torus around a cycle."""

    number: float  # turns in each round, in [0, 1/2]
    error: float
    around: Point


def run(
    plate: Any, gamma: Floats, omega: float, xi: float, states: Floats, settle: int, observe: int
) -> Line:
    """The record of n cells of one spring: gamma (n,), each from its row of `states` (n, 6)."""
    return _run(plate, gamma, omega, xi, carry=False, states=states, settle=settle, observe=observe, keep=64)


def _run(plate: Any, gamma: Floats, omega: float, xi: float, **options: Any) -> Line:
    """The record of n cells of one spring, whose plate is of one cell; options as of `run_line`."""
    n, one = len(gamma), np.ones(len(gamma))
    arrays = {name: np.repeat(x, n) for name, x in plate._asdict().items() if isinstance(x, np.ndarray)}
    return run_line(gamma, omega * one, xi * one, plate=plate._replace(**arrays), **options)


def creep(plate: Any, cell: Cell, state: Floats, rng: np.random.Generator) -> Crept | None:
    """Carry a motion from a state (6,) at `cell` down in Gamma as far as it bounces; None if it does not.

    Each step is halved until a copy of the motion survives it: a large step may end a motion that smaller
    ones keep. The steps end at a cycle of at most LONGEST plate periods. Otherwise returns the last step
    after which a copy bounces for long.
    """
    line = _bouncing(plate, cell, _copies(rng, state, 1.0), _STAY)
    if line is None:
        return None
    steps, step, gone = [Crept(cell, line)], _FIRST, np.nan
    for _ in range(_STEPS):
        last = steps[-1]
        lower = last.cell._replace(gamma=last.cell.gamma * (1.0 - step))
        copies = _copies(rng, last.line.end_state, last.cell.gamma / lower.gamma)
        line = _bouncing(plate, lower, copies, _STAY if step > _FINE else _FINE_STAY)
        if line is not None:
            steps.append(Crept(lower, line))
            if not lower.gamma > gone:  # where copies came to rest, one survives a smaller step
                gone, step = np.nan, min(1.5 * step, _LARGEST)
                if 0 < steps[-1].periods <= LONGEST:
                    return steps[-1]
        elif step < _SMALLEST:
            break
        else:
            gone, step = float(np.fmax(gone, lower.gamma)), 0.5 * step
    return _lasting(plate, steps, gone)


def _copies(rng: np.random.Generator, states: Floats, scale: float) -> Floats:
    """Copies of a motion in one or more states, its lengths and velocities scaled, spread a little."""
    copies = np.resize(states, (_COPIES, states.shape[-1]))
    copies[:, 2:] *= scale * (1.0 + _SPREAD * rng.normal(size=copies[:, 2:].shape))
    return copies


def _bouncing(plate: Any, cell: Cell, states: Floats, settle: int) -> Line | None:
    """The copies that still bounce after `settle` plate periods; None if all are at rest."""
    line = run(plate, np.full(len(states), cell.gamma), cell.omega, cell.xi, states, settle, 100)
    bounces = line.outcome != Outcome.AT_REST
    return Line(*(x[bounces] for x in line)) if bounces.any() else None


def _lasting(plate: Any, steps: list[Crept], gone: float) -> Crept | None:
    """The last step after which a copy bounces for long, by bisection. gone: below the last step."""
    good, bad, lasting = -1, len(steps), None
    i = bad - 1
    while bad - good > 1:
        line = _bouncing(plate, steps[i].cell, steps[i].line.end_state, _LONG)
        if line is None:
            bad, gone = i, steps[i].cell.gamma
        else:
            good, lasting = i, steps[i]._replace(line=line)
        i = (good + bad) // 2
    return None if lasting is None else lasting._replace(gone=gone)


def rotation(plate: Any, cell: Cell, state: Floats) -> Rotation | None:
    """The rotation of a settled motion, in a state (6,) at phase 0, around an unstable cycle; None if none.

    The number is a weighted mean of the turns after _LONG more plate periods; its error is thrice the change
    from before, or from a half of them. Newton's method seeks the cycle from the motion's mean state and from
    some of its states.
    """
    later = run(plate, np.array([cell.gamma]), cell.omega, cell.xi, state[None], _LONG, 1).end_state[0]
    for periods in range(1, _AROUND + 1):
        before, states = (_strobed(plate, cell, start, periods, _ROUNDS) for start in (state, later))
        for guess in (states.mean(axis=0).round(15), *states[:_GUESSES]):
            around = cycle_from(plate, cell, periods, guess)
            if around is None or around.multipliers[0].imag == 0.0 or repeats(around):
                continue
            turns = _turns(plate, cell, around, states)
            change = max(abs(_mean(turns) - _mean(half)) for half in np.array_split(turns, 2))
            means = _mean(turns), _mean(_turns(plate, cell, around, before))
            number, earlier = (abs(mean - round(mean)) for mean in means)  # whose planes may be mirrored
            change = max(change, abs(number - earlier))
            if change < min(_CHANGE, _RELATIVE_CHANGE * number):  # number 0: the cycle lies outside
                return Rotation(number, _CAUTION * change, around)
    return None


def _turns(plate: Any, cell: Cell, around: Point, states: Floats) -> Floats:
    """The turns (n - 1,) around a cycle from each of its states (n, 6) to the next."""
    turns = np.diff(np.angle(_on_plane(plate, cell, around, states))) / TWO_PI
    middle = np.angle(np.exp(1j * TWO_PI * turns).mean()) / TWO_PI
    return np.asarray(turns - np.round(turns - middle))


def _mean(turns: Floats) -> float:
    """The mean of turns (n,), with a weight that vanishes smoothly at both ends."""
    t = (np.arange(len(turns)) + 0.5) / len(turns)
    return float(np.average(turns, weights=np.exp(-1.0 / (t * (1.0 - t)))))


def _on_plane(plate: Any, cell: Cell, around: Point, states: Floats) -> NDArray[np.complex128]:
    """States (n, 6) at phase 0 in the plane in which motions turn around a cycle, as complex numbers (n,).

    With a gap a state has four dimensions: a torus can cross itself in a plane that is not this one.
    """
    mean, centres = states.mean(axis=0), _strobed(plate, cell, around.state, 1, around.cycles.periods)
    centre = min(centres, key=lambda state: float(np.linalg.norm(state - mean)))
    first = 2 if centre[2] else 4  # without a gap, elongation and its velocity are the state
    step = _DIFFERENCE * np.maximum(np.abs(centre[first:]), _DIFFERENCE)
    moved = np.tile(centre, (2 * step.size, 1))
    moved[:, first:] += np.vstack([np.diag(step), -np.diag(step)])
    gamma, periods = np.full(len(moved), cell.gamma), around.cycles.periods
    after = run(plate, gamma, cell.omega, cell.xi, moved, periods - 1, 1)
    up, down = np.split(after.end_state[:, first:], 2)
    values, vectors = np.linalg.eig((up - down) / (2.0 * step[:, None]))
    plane: NDArray[np.complex128] = (states - centre)[:, first:] @ vectors[:, np.argmax(np.abs(values))]
    return plane


def _strobed(plate: Any, cell: Cell, state: Floats, periods: int, rounds: int) -> Floats:
    """The states (rounds, 6) at plate phase 0, one in each `periods` plate periods."""
    gamma, start = np.full(rounds, cell.gamma), Start(state, cell)
    options: Any = {"carry": True, "settle": periods - 1, "observe": 1, "keep": 1, "start": start}
    return _run(plate, gamma, cell.omega, cell.xi, **options).end_state
