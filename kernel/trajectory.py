"""One cell from a state to the end of its window: phase after phase, whatever the contact model.

Phase is kept modulo 2 pi beside a count of plate periods, so that no digit is lost however
long a cell runs.
"""

import math
from typing import Any, Final, NamedTuple

from kernel.events import BROKEN, HORIZON, ROOT
from kernel.jit import jit
from kernel.model import contact, flight
from kernel.modes import TWO_PI, find_cycle
from kernel.params import Outcome

#: A flight shorter than this (rad) cannot be told from none; it is not recorded.
SHORTEST_FLIGHT: Final = 1e-9

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


class Flights(NamedTuple):
    """The last flights of a cell, a ring: the newest is at (recorded - 1) % size. All arrays (size,)."""

    time: Any  # float64, rad
    phase: Any  # float64, rad modulo 2 pi, at take-off
    period: Any  # int64, plate periods since the cell began, at take-off


class Run(NamedTuple):
    """How a cell's run went."""

    recorded: int  # flights that took off and landed inside the window
    flew: bool  # whether a flight that counts was under way in the window
    ending: int  # events.HORIZON if the window's end was reached


@jit
def run_cell(
    cell: Any,
    state: Any,
    window: Window,
    flights: Flights,
) -> Run:
    """Run one cell from `state` (6,), see params.STATE_FIELDS; it becomes the state at the window's end."""
    phase, in_flight = state[0], state[1] != 0.0
    gap, gap1, q, q1 = state[2], state[3], state[4], state[5]
    total = window.settle + window.observe
    counts = max(window.micro_flight, SHORTEST_FLIGHT)
    budget = BUDGET * total
    recorded, flew, ending = 0, False, HORIZON
    period = 0
    takeoff_phase, takeoff_period = phase, -1  # a flight that came in with the state is not this cell's
    while period < total:
        horizon = TWO_PI * (total - period) - phase
        if in_flight:
            p = flight(cell, phase, gap, gap1, q, q1, horizon, budget)
        else:
            p = contact(cell, phase, gap, gap1, q, q1, horizon, budget)
        budget -= p.used
        turns = math.floor((phase + p.tau) / TWO_PI)
        phase += p.tau - TWO_PI * turns
        period += turns
        if in_flight and p.tau > SHORTEST_FLIGHT:
            flew = flew or (period >= window.settle and p.tau > counts)
            if p.ending == ROOT and takeoff_period >= window.settle:
                slot = recorded % len(flights.time)
                flights.time[slot] = p.tau
                flights.phase[slot] = takeoff_phase
                flights.period[slot] = takeoff_period
                recorded += 1
        gap, gap1, q, q1, in_flight = p.gap, p.gap1, p.q, p.q1, p.in_flight
        if p.ending != ROOT:
            ending = p.ending
            break
        takeoff_phase, takeoff_period = phase, period
    if ending == HORIZON:
        phase = 0.0
    state[0], state[1] = phase, 1.0 if in_flight else 0.0
    state[2], state[3], state[4], state[5] = gap, gap1, q, q1
    return Run(recorded, flew, ending)


@jit
def classify(run: Run, flights: Flights, micro_flight: float) -> tuple[int, int, int]:
    """Outcome, bounces and plate periods of a cell that has been run."""
    if run.ending != HORIZON:
        return DIVERGED if run.ending == BROKEN else UNRESOLVED, 0, 0
    if not run.flew:
        return AT_REST, 0, 0
    size = len(flights.time)
    kept = min(run.recorded, size)
    time, phase = flights.time.copy()[:kept], flights.phase.copy()[:kept]
    period = flights.period.copy()[:kept]
    count = 0
    for i in range(run.recorded - kept, run.recorded):
        if flights.time[i % size] > micro_flight:
            time[count] = flights.time[i % size]
            phase[count] = flights.phase[i % size]
            period[count] = flights.period[i % size]
            count += 1
    bounces, periods = find_cycle(time[:count], phase[:count], period[:count])
    return PERIODIC if bounces else APERIODIC, bounces, periods
