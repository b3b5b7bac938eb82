"""States on the cycles of a (1,k) branch, from which a simulation starts.

The state is exact for an ideal plate with restitution 0. Other contacts start from the same elongation, gap
and velocities, near a cycle of their own.
"""

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from kernel.cycles.admissibility import gap_terms, gap_weights
from kernel.cycles.closed_form import TWO_PI, gamma_and_slope, orbit
from kernel.cycles.events import Branch, branch, branch_and_events, flight_times, rows_of
from kernel.cycles.roots import Floats, roots, stretches
from kernel.cycles.spring import flight, spring, stuck
from kernel.params import Cell, Start

#: A cycle of the closed form is one of the cell if it is within this in Gamma, relative.
_SAME_CELL: Final = 1e-10
#: Flight times beside an event's, parts of it.
_BESIDE: Final = (1.0 - 1e-9, 1.0 + 1e-9)
#: Velocities of the plate at the landing of cycles that never stick, parts of the largest.
_LANDING: Final = (0.95, 0.8, 0.6, 0.4)


class CycleStart(NamedTuple):
    """A start on a cycle, and that cycle as a branch of one point."""

    start: Start
    cycle: Branch


def cycles_at(cell: Cell, periods: int) -> Branch:
    """The cycles (1, periods) of the closed form at a cell, by flight time. Raises KernelInputError."""
    gamma, omega, xi = cell
    t = flight_times(omega, xi, periods)
    k = spring(omega, xi)

    def above(t: Floats) -> tuple[Floats, Floats]:
        value, slope = gamma_and_slope(k, periods, t)
        return value[None] - gamma, slope[None]

    with np.errstate(all="ignore"):  # poles of Gamma(T)
        times = roots(above, t, *above(t)).x
    return branch(omega, xi, periods, times)


def start_on_stable_cycle(cell: Cell, periods: int) -> CycleStart | None:
    """A start on the stable admissible cycle (1, periods) of a cell; None if there is none.

    If there are several, on the one with the longest flight. Raises KernelInputError.
    """
    line = cycles_at(cell, periods)
    holds = np.flatnonzero(line.stable & (line.violations == 0))
    return _start(cell, line, int(holds[-1])) if len(holds) else None


def start_on_cycle(cell: Cell, periods: int, flight_time: float) -> CycleStart | None:
    """A start on the cycle (1, periods) of a cell whose flight time is nearest to `flight_time`, rad.

    The cycle may be unstable or not admissible. None if the cell has no cycle. Raises KernelInputError.
    """
    gamma, omega, xi = cell
    itself = branch(omega, xi, periods, np.array([flight_time]))
    if abs(itself.gamma[0] - gamma) < _SAME_CELL * gamma:
        return _start(cell, itself, 0)  # at a fold too, beside which roots of Gamma(T) are hard to tell apart
    line = cycles_at(cell, periods)
    if not len(line.flight_time):
        return None
    return _start(cell, line, int(np.argmin(np.abs(line.flight_time - flight_time))))


def starts_between_landings(omega: float, xi: float, periods: int, restitution: float) -> Iterator[Start]:
    """Starts on cycles of one flight that never stick, after their landing on an ideal plate with rebound.

    There are two at each Gamma above the one at which they land where the plate is fastest.
    """
    time = TWO_PI * periods
    f = flight(spring(omega, xi), np.array([time])).free
    push = (1.0 - f.c) * (1.0 - f.s1) - f.s * f.c1
    if push[0] == 0.0:  # an undamped resonance
        return
    impact = 2.0 * time / (1.0 + restitution)  # this and what follows are Gamma times the values of the cycle
    q, q1 = float((-2.0 * time * f.s / push)[0]), float((-2.0 * time * (1.0 - f.c) / push)[0])
    sine = restitution * impact + 0.5 * (q1 - time)
    for part in _LANDING:
        gamma = abs(sine) / part
        phase = math.asin(sine / gamma)
        for landing in (phase % TWO_PI, (math.pi - phase) % TWO_PI):
            state = [landing, 1.0, 0.0, restitution * impact / gamma, q / gamma, q1 / gamma]
            yield Start(np.array(state), Cell(gamma, omega, xi))


def stable_ranges(omega: float, xi: float, periods: int, *, exact: bool = False) -> list[tuple[float, float]]:
    """Ranges of Gamma with a stable admissible cycle (1, periods), `exact` or to the branch's grid.

    Raises KernelInputError.
    """
    times = flight_times(omega, xi, periods)
    if exact:
        events = branch_and_events(omega, xi, periods)[1].flight_time
        times = np.sort(np.concatenate([times, *(events * side for side in _BESIDE)]))
    with np.errstate(all="ignore"):
        line = branch(omega, xi, periods, times)
    ranges = [line.gamma[low:high] for low, high in stretches(line.stable & (line.violations == 0))]
    return [(float(gamma.min()), float(gamma.max())) for gamma in ranges]


def starts_on_admissible_cycles(omega: float, xi: float, periods: int) -> Iterator[CycleStart]:
    """A start in each stretch of admissible cycles (1, periods), stable or not. Raises KernelInputError."""
    with np.errstate(all="ignore"):
        line = branch(omega, xi, periods, flight_times(omega, xi, periods))
    for low, high in stretches(line.violations == 0):
        i = (low + high) // 2
        yield _start(Cell(float(line.gamma[i]), omega, xi), line, i)


def _start(cell: Cell, line: Branch, i: int) -> CycleStart:
    cycle = rows_of(line, slice(i, i + 1))
    return CycleStart(Start(_state(cycle), cell), cycle)


def _state(cycle: Branch) -> Floats:
    """The state (6,) at phase 0 of a cycle, a branch of one point; as STATE_FIELDS."""
    k = spring(cycle.omega[0], cycle.xi[0])
    t, since = cycle.flight_time, TWO_PI - cycle.takeoff_phase
    x, flies = orbit(k, cycle.periods, t), since < t
    if flies:
        f = flight(k, since).free
        gap, gap1, _ = ((gap_weights(x) * terms).sum(axis=0) for terms in gap_terms(k, since))
        lengths = [gap, gap1, x.q0 * f.c + x.v0 * f.s, x.q0 * f.c1 + x.v0 * f.s1]
    else:
        f, rest, response = stuck(k, since - t), -1.0 / k.stiffness, k.q_re + 1j * k.q_im
        driven = response * (x.c + 1j * x.s) * np.exp(1j * t)  # about `rest`, at landing
        h, h1 = x.q_land - rest - driven.real, x.v_land + driven.imag
        driven = response * cycle.gamma  # at phase 0
        q, q1 = h * f.c + h1 * f.s + rest + driven.real, h * f.c1 + h1 * f.s1 - driven.imag
        lengths = [0.0 * h, 0.0 * h, q, q1]
    return np.array([0.0, float(flies[0]), *(np.concatenate(lengths) / cycle.gamma)])
