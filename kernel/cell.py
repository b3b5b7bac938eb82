"""One cell from a state to the end of its window: phase after phase, whatever the contact model.

Phase is kept modulo 2 pi beside a count of plate periods, so that no digit is lost however
long a cell runs.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np

from kernel.interface import contact, flight, repeat
from kernel.modes import REPEATS, TWO_PI, find_cycle
from kernel.numerics.first_root import HORIZON, NON_FINITE, ROOT, Phase
from kernel.numerics.jit import inlined, jit
from kernel.params import Line, Outcome

#: A flight shorter than this (rad) cannot be told from none; it is not recorded.
SHORTEST_FLIGHT: Final = 1e-9

#: Flights remembered for finding the mode, when fewer are to be kept.
REMEMBERED: Final = 256

#: Flights after which settling is looked at again, where it may end early.
REHEARSAL: Final = 24

#: Numbers that a model may note of a cell in work.
MEMORY: Final = 64

#: Evaluations of a phase function a cell may use, for each plate period.
BUDGET: Final = 20_000

PERIODIC: Final = int(Outcome.PERIODIC)
APERIODIC: Final = int(Outcome.APERIODIC)
AT_REST: Final = int(Outcome.AT_REST)
UNRESOLVED: Final = int(Outcome.UNRESOLVED)
DIVERGED: Final = int(Outcome.DIVERGED)


class Window(NamedTuple):
    """How a cell is observed."""

    settle: int  # plate periods discarded
    observe: int  # plate periods recorded
    micro_flight: float  # rad; shorter flights do not count for outcome and mode
    settle_tolerance: float  # rad; flights repeating within it end the settling early; 0: never


class Flights(NamedTuple):
    """The last flights of some lanes of cells, a ring of `size` for each.

    A lane's newest is at first + (recorded - 1) % size, `first` being size times the lane's number.
    All arrays (lanes * size,).
    """

    time: Any  # float64, rad
    phase: Any  # float64, rad modulo 2 pi, at take-off
    period: Any  # int64, plate periods since the cell began, at take-off
    size: int


class Progress(NamedTuple):
    """Where a cell's run stands."""

    phase: float  # of the plate, rad modulo 2 pi
    period: int  # plate periods since the cell began
    in_flight: bool
    gap: float
    gap1: float
    q: float
    q1: float
    takeoff_phase: float
    takeoff_period: int  # -1 for a flight that came in with the state: it is not this cell's
    recorded: int  # flights that took off and landed inside the window (or so far, while settling)
    flew: bool  # whether a flight that counts was under way in the window
    budget: int  # evaluations left
    ending: int  # events.ROOT while running, HORIZON once the window's end is reached


@jit
def begin(state: Any, window: Window, carried: bool = False) -> Progress:
    """A run from `state` (6,), see params.STATE_FIELDS; a flight `carried` in with it is not the cell's."""
    budget = BUDGET * (window.settle + window.observe)
    return Progress(
        state[0],
        0,
        state[1] != 0.0,
        state[2],
        state[3],
        state[4],
        state[5],
        state[0],
        -1,
        0,
        False,
        budget,
        ROOT,
    )


@inlined
def horizon_of(run: Progress, window: Window) -> float:
    """Rad from now to the window's end."""
    return TWO_PI * (window.settle + window.observe - run.period) - run.phase


@inlined
def record(run: Progress, p: Phase, window: Window, flights: Flights, first: int) -> Progress:
    """The run after phase `p`; a flight that took off and landed inside the window goes to `flights`.

    `first`: where the lane's part of `flights` begins.
    """
    turns = math.floor((run.phase + p.tau) * (1.0 / TWO_PI))
    phase = run.phase + p.tau - TWO_PI * turns
    period = run.period + turns
    settling = period < window.settle
    recorded, flew = run.recorded, run.flew
    if run.period < window.settle and not settling:
        recorded = 0
    if run.in_flight and p.tau > SHORTEST_FLIGHT:
        flew = flew or (not settling and p.tau > window.micro_flight)
        inside = run.takeoff_period >= window.settle or (settling and window.settle_tolerance > 0.0)
        if p.ending == ROOT and inside and run.takeoff_period >= 0:
            slot = first + recorded % flights.size
            flights.time[slot] = p.tau
            flights.phase[slot] = run.takeoff_phase
            flights.period[slot] = run.takeoff_period
            recorded += 1
    ending = p.ending
    if ending == HORIZON or (ending == ROOT and period >= window.settle + window.observe):
        phase, ending = 0.0, HORIZON
    return Progress(
        phase, period, p.in_flight, p.gap, p.gap1, p.q, p.q1,
        phase, period, recorded, flew, run.budget - p.used, ending,
    )  # fmt: skip


@jit
def settled(before: Progress, run: Progress, window: Window, flights: Flights, first: int) -> Progress:
    """`run`, done with settling if its last flights repeat within the tolerance the specification allows.

    Apart from `record`, which would be too big to be inlined where no cell asks for this.
    """
    if run.recorded == before.recorded or run.period >= window.settle or run.recorded % REHEARSAL:
        return run
    tolerance = window.settle_tolerance
    bounces, _ = _cycle(flights, first, run.recorded, REHEARSAL, window.micro_flight, tolerance)
    if bounces == 0:
        return run
    return Progress(
        run.phase, window.settle, run.in_flight, run.gap, run.gap1, run.q, run.q1,
        run.phase, window.settle, 0, run.flew, run.budget, run.ending,
    )  # fmt: skip


@jit
def run_cell(cell: Any, state: Any, window: Window, flights: Flights, carried: bool) -> Progress:
    """Run one cell from `state` (6,) to the end of its window; `carried`: see `begin`."""
    run = begin(state, window, carried)
    memory = np.zeros(MEMORY)
    while run.ending == ROOT:
        if run.in_flight and run.gap == 0.0 and run.gap1 == 0.0:
            run = repeat(cell, run, window, flights, memory)
            if run.ending != ROOT:
                break
        horizon = horizon_of(run, window)
        if run.in_flight:
            p = flight(cell, run.phase, run.gap, run.gap1, run.q, run.q1, horizon, run.budget)
        else:
            p = contact(cell, run.phase, run.gap, run.gap1, run.q, run.q1, horizon, run.budget)
        before, run = run, record(run, p, window, flights, 0)
        if window.settle_tolerance > 0.0:
            run = settled(before, run, window, flights, 0)
    return run


@jit
def leave(run: Progress, state: Any) -> None:
    """Write the state a run ended in to `state` (6,)."""
    state[0], state[1] = run.phase, 1.0 if run.in_flight else 0.0
    state[2], state[3], state[4], state[5] = run.gap, run.gap1, run.q, run.q1


@jit
def classify(run: Progress, flights: Flights, first: int, micro_flight: float) -> tuple[int, int, int]:
    """Outcome, bounces and plate periods of a cell that has been run."""
    if run.ending != HORIZON:
        return DIVERGED if run.ending == NON_FINITE else UNRESOLVED, 0, 0
    if not run.flew:
        return AT_REST, 0, 0
    bounces, periods = _cycle(flights, first, run.recorded, flights.size, micro_flight, REPEATS)
    return PERIODIC if bounces else APERIODIC, bounces, periods


@jit
def _cycle(
    flights: Flights, first: int, recorded: int, most: int, micro_flight: float, tolerance: float
) -> tuple[int, int]:
    """The cycle of the last `most` flights of at least `micro_flight`: see modes.find_cycle."""
    kept = min(recorded, most)
    time, phase, period = np.empty(kept), np.empty(kept), np.empty(kept, dtype=np.int64)
    count = 0
    for i in range(recorded - kept, recorded):
        slot = first + i % flights.size
        if flights.time[slot] > micro_flight:
            time[count] = flights.time[slot]
            phase[count] = flights.phase[slot]
            period[count] = flights.period[slot]
            count += 1
    return find_cycle(time[:count], phase[:count], period[:count], tolerance)


@jit
def room_for_flights(keep: int, lanes: int) -> Flights:
    """Rings for the flights of as many cells as there are lanes."""
    size = max(keep, REMEMBERED)
    n = lanes * size
    return Flights(np.empty(n), np.empty(n), np.empty(n, dtype=np.int64), size)


@jit
def write(
    line: Line, i: int, run: Progress, flights: Flights, first: int, state: Any, window: Window
) -> None:
    """The record of a cell that has been run, as the i-th of its line."""
    outcome, bounces, periods = classify(run, flights, first, window.micro_flight)
    line.flights[i], line.outcome[i] = run.recorded, outcome
    line.bounces[i], line.periods[i] = bounces, periods
    keep = line.flight_time.shape[1]
    kept = min(run.recorded, keep)
    for k in range(kept):
        slot = first + (run.recorded - kept + k) % flights.size
        line.flight_time[i, k] = flights.time[slot]
        line.takeoff_phase[i, k] = flights.phase[slot]
    for field in range(len(state)):
        line.end_state[i, field] = state[field]
