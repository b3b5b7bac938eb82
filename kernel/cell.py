"""The event loop: one cell from a state to the end of its window, contact by flight, for every model.

The plate's phase is kept modulo 2 pi beside a count of plate periods, so that long runs lose no digits.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np

from kernel import modes
from kernel.interface import Phase, State, flies, plate_phase, rest
from kernel.modes import Flights, slot
from kernel.numerics.elementary import TWO_PI
from kernel.numerics.first_root import HORIZON, NON_FINITE, ROOT
from kernel.numerics.jit import allocating, compilable, inlined, jit
from kernel.params import BUDGET, Line, Outcome, periods_followed

SHORTEST_FLIGHT: Final = 1e-9  # rad; shorter flights, often rounding after long contacts, are not recorded
MODE_FLIGHTS: Final = 256  # considered for the mode, even if fewer are stored: cycles of up to 85 bounces
MODE_PERIODS: Final = 24  # plate periods; more flights are considered if MODE_FLIGHTS reach back less
KEPT_FLIGHTS: Final = 4096  # most that are considered; a landing at e = 0.95 is followed by 400 hops
FEWEST_PERIODS: Final = 3  # plate periods; kept flights that reach back less decide nothing
QUIET: Final = 10.0  # plate periods; a contact this long, over the last half of the window, ends all flights
FADED: Final = 0.5  # ratio of the longest late flight to the longest early one, of hops that die out
GROWS: Final = -1e-9  # relative margin below which a motion on the plate takes off, however slowly it grows
CACHE_SIZE: Final = 64  # numbers in the cache of a model for a cell (`interface.replay`)

_, PERIODIC, APERIODIC, AT_REST, UNRESOLVED, DIVERGED, SETTLING = map(int, Outcome)

compilable(periods_followed)


class Window(NamedTuple):
    """The observation window of a cell, as in `kernel.line.run_line`."""

    settle: int  # plate periods discarded
    observe: int  # plate periods recorded
    micro_flight: float  # rad; shorter flights do not count for the mode, unless all are
    settle_until: int  # most plate periods of a cell that still settles; 0: those of the window
    certify: bool  # whether only certified cycles are periodic, and end the cell


class Progress(NamedTuple):
    """The state of a cell's run between two phases."""

    phase: float  # of the plate, rad modulo 2 pi
    period: int  # plate periods since the cell began
    in_flight: bool
    state: State
    takeoff_phase: float
    takeoff_period: int  # -1 for a flight under way at the start or at an extension: it is not recorded
    recorded: int  # flights in the ring buffer so far
    opened: int  # how many of them precede the window
    flew: bool  # whether a flight was under way in the window
    budget: int  # evaluations left
    ending: int  # first_root.ROOT while running, HORIZON once the window's end is reached
    settle: int  # plate periods before the window: window.settle until the window is moved
    end: int  # plate periods to the end of the run: the window's end until `follow` moves it


#: Numbers that `store_run` writes.
RUN_FIELDS: Final = len(Progress._fields) - 1 + len(State._fields)


@jit
def begin(
    cell: Any, i: int, length: int, gamma: Any, omega: Any, states: Any, run: Progress, state: Any,
    window: Window,
) -> Progress:  # fmt: skip
    """The run of the i-th cell, of lines of `length` cells with gamma (n,) and omega (n,).

    The first cell of a line begins from its row of `states` (lines, 6), in its own units; others go on from
    `run`, the last cell's. Without a row, with NaN or after divergence: from rest. Overwrites `state` (6,).
    """
    if i % length == 0:
        number = i // length
        given = len(states) > 0 and not math.isnan(states[number, 0])
        for field in range(len(state)):
            state[field] = states[number, field] if given else 0.0
    else:
        given = run.ending != NON_FINITE
        store_state(run, state)
        rescale(state, gamma[i - 1], omega[i - 1], gamma[i], omega[i])
    here = State(state[2], state[3], state[4], state[5])
    if not given:
        state[0], state[1], here = 0.0, 0.0, rest(cell)
    in_flight = flies(cell, plate_phase(state[0]), here)
    takes_off = in_flight and state[1] == 0.0  # now, so that the flight is recorded
    end = window.settle + window.observe
    return Progress(
        phase=state[0],
        period=0,
        in_flight=in_flight,
        state=here,
        takeoff_phase=state[0],
        takeoff_period=0 if takes_off else -1,
        recorded=0,
        opened=0,
        flew=False,
        budget=BUDGET * end,
        ending=ROOT,
        settle=window.settle,
        end=end,
    )


@inlined
def changed(
    run: Progress, phase: float | None = None, period: int | None = None, in_flight: bool | None = None,
    state: State | None = None, takeoff_phase: float | None = None, takeoff_period: int | None = None,
    recorded: int | None = None, opened: int | None = None, flew: bool | None = None,
    budget: int | None = None, ending: int | None = None, settle: int | None = None, end: int | None = None,
) -> Progress:  # fmt: skip
    """`run` with these fields replaced: numba does not compile `run._replace`."""
    return Progress(
        phase=run.phase if phase is None else phase,
        period=run.period if period is None else period,
        in_flight=run.in_flight if in_flight is None else in_flight,
        state=run.state if state is None else state,
        takeoff_phase=run.takeoff_phase if takeoff_phase is None else takeoff_phase,
        takeoff_period=run.takeoff_period if takeoff_period is None else takeoff_period,
        recorded=run.recorded if recorded is None else recorded,
        opened=run.opened if opened is None else opened,
        flew=run.flew if flew is None else flew,
        budget=run.budget if budget is None else budget,
        ending=run.ending if ending is None else ending,
        settle=run.settle if settle is None else settle,
        end=run.end if end is None else end,
    )


@jit
def rescale(state: Any, gamma: float, omega: float, next_gamma: float, next_omega: float) -> None:
    """Convert `state` (6,) from the plate amplitude at gamma and omega to that at the next ones."""
    velocity = gamma / next_gamma * (next_omega / omega)
    length = velocity * (next_omega / omega)
    state[2] *= length
    state[3] *= velocity
    state[4] *= length
    state[5] *= velocity


@inlined
def horizon_of(run: Progress) -> float:
    """Rad from the run's phase to its end."""
    return TWO_PI * (run.end - run.period) - run.phase


@jit
def record(run: Progress, p: Phase, window: Window, flights: Flights, first: int) -> Progress:
    """The run after the contact or flight `p`; adds a flight that lies inside the window to `flights`.

    While settling, flights are recorded only to certify.
    """
    turns = math.floor((run.phase + p.tau) * (1.0 / TWO_PI))
    phase = run.phase + p.tau - TWO_PI * turns
    period = run.period + turns
    settling = period < run.settle
    recorded, flew = run.recorded, run.flew
    opens = run.period < run.settle and not settling
    if run.in_flight and p.tau > SHORTEST_FLIGHT:
        flew = flew or not settling
        inside = run.takeoff_period >= run.settle or window.certify
        if p.ending == ROOT and inside and run.takeoff_period >= 0:
            j = slot(flights, first, recorded)
            flights.time[j], flights.phase[j] = p.tau, run.takeoff_phase
            flights.period[j] = run.takeoff_period
            recorded += 1
    ending = p.ending
    if ending == HORIZON or (ending == ROOT and period >= run.end):
        # rounding of phase + tau may leave `period` one short
        phase, period, ending = 0.0, run.end, HORIZON
    return changed(
        run, phase=phase, period=period, in_flight=p.in_flight, state=p.state, takeoff_phase=phase,
        takeoff_period=period, recorded=recorded, opened=recorded if opens else run.opened, flew=flew,
        budget=run.budget - p.used, ending=ending,
    )  # fmt: skip


@jit
def follow(before: Progress, window: Window) -> Progress:
    """A run beyond its window, from `before` the phase in which that ended, which stays one phase."""
    added = periods_followed(window.observe)
    return changed(before, budget=before.budget + BUDGET * added, end=before.end + added)


@jit
def decide(outcome: int, followed: Progress, flights: Flights, first: int, window: Window) -> int:
    """The outcome of a cell without a mode: `outcome` is by its window, `followed` the run beyond that."""
    decided = classify(followed, flights, first, window)[0]
    if decided in (PERIODIC, SETTLING):
        return SETTLING
    return APERIODIC if decided == APERIODIC else outcome


@jit
def go_on(before: Progress, run: Progress, outcome: int, window: Window) -> Progress:
    """The run after `run`, which has ended without a certificate; `run` itself unless its cell settles.

    It goes on from `before`, the run before the last phase: first to the end of `follow`, if that leaves room
    for a window, then to window.settle_until plate periods, if that is set.
    """
    end, added = window.settle_until, periods_followed(window.observe)
    if run.end == window.settle + window.observe and added >= window.observe:
        end = min(end, run.end + added)
    if outcome != SETTLING or end < run.end + window.observe:
        return run
    return changed(
        before, flew=False, budget=before.budget + BUDGET * (end - run.end), settle=end - window.observe,
        end=end,
    )  # fmt: skip


@jit
def extend(run: Progress, outcome: int, window: Window) -> Progress:
    """The run after `run`, which has ended; `run` itself unless its cell settles and settle_until permits.

    Doubles the plate periods, up to window.settle_until, and moves the window to their end. It begins where
    the old one ended or later, so that no flight is in both.
    """
    added = min(run.end, window.settle_until - run.end)
    if outcome != SETTLING or added < window.observe:
        return run
    return changed(
        run, takeoff_phase=run.phase, takeoff_period=-1, recorded=0, opened=0, flew=False,
        budget=run.budget + BUDGET * added, ending=ROOT, settle=run.settle + added, end=run.end + added,
    )  # fmt: skip


@jit
def store_run(run: Progress, numbers: Any) -> None:
    """Write a run to `numbers` (RUN_FIELDS,) float64. Its integers are far below 2**53."""
    numbers[0], numbers[1], numbers[2] = run.phase, run.period, run.in_flight
    numbers[3], numbers[4], numbers[5], numbers[6] = run.state
    numbers[7], numbers[8], numbers[9] = run.takeoff_phase, run.takeoff_period, run.recorded
    numbers[10], numbers[11], numbers[12], numbers[13] = run.flew, run.budget, run.ending, run.settle
    numbers[14], numbers[15] = run.end, run.opened


@jit
def load_run(numbers: Any) -> Progress:
    """The run that `store_run` has written."""
    return Progress(
        phase=numbers[0],
        period=int(numbers[1]),
        in_flight=numbers[2] != 0.0,
        state=State(numbers[3], numbers[4], numbers[5], numbers[6]),
        takeoff_phase=numbers[7],
        takeoff_period=int(numbers[8]),
        recorded=int(numbers[9]),
        flew=numbers[10] != 0.0,
        budget=int(numbers[11]),
        ending=int(numbers[12]),
        settle=int(numbers[13]),
        end=int(numbers[14]),
        opened=int(numbers[15]),
    )


@jit
def store_state(run: Progress, state: Any) -> None:
    """Write the run's current state to `state` (6,), see params.STATE_FIELDS."""
    state[0], state[1] = run.phase, 1.0 if run.in_flight else 0.0
    state[2], state[3], state[4], state[5] = run.state


@allocating
def classify(run: Progress, flights: Flights, first: int, window: Window) -> tuple[int, int, int]:
    """Outcome, bounces and plate periods of a cell whose run has ended (docs/model.md, section 4)."""
    if run.ending != HORIZON:
        return DIVERGED if run.ending == NON_FINITE else UNRESOLVED, 0, 0
    if not run.flew:
        return AT_REST, 0, 0
    considered, cut = _considered(run, flights, first)
    time, phase, period = _counted(flights, first, run.recorded, considered, window.micro_flight)
    bounces, periods = modes.find_mode(time, phase, period)
    if bounces > 0:
        return (SETTLING, 0, 0) if window.certify else (PERIODIC, bounces, periods)
    if _comes_to_rest(run, flights, first, window):
        return SETTLING, 0, 0
    if cut:
        return UNRESOLVED, 0, 0
    return SETTLING if modes.is_settling(time, phase) else APERIODIC, 0, 0


@jit
def _considered(run: Progress, flights: Flights, first: int) -> tuple[int, bool]:
    """Number of last flights considered for the mode, and whether earlier ones are lost that are needed."""
    recorded = run.recorded - run.opened
    kept = min(recorded, flights.size)
    number = min(recorded, max(flights.stored, MODE_FLIGHTS))
    oldest = flights.period[slot(flights, first, run.recorded - number)]
    while number < kept and oldest > run.end - MODE_PERIODS:
        number += 1
        oldest = flights.period[slot(flights, first, run.recorded - number)]
    return number, number < recorded and oldest > run.end - FEWEST_PERIODS


@jit
def _comes_to_rest(run: Progress, flights: Flights, first: int, window: Window) -> bool:
    """Whether a run was in contact for its last QUIET periods and, without `certify`, half of its window."""
    if run.in_flight or run.recorded == run.opened:
        return False
    last = slot(flights, first, run.recorded - 1)
    landing = flights.period[last] + (flights.phase[last] + flights.time[last]) * (1.0 / TWO_PI)
    still: float = run.end - landing
    return still > (QUIET if window.certify else max(0.5 * (run.end - run.settle), QUIET))


@jit
def fades(run: Progress, flights: Flights, first: int) -> bool:
    """Whether the longest of the last third of a run's flights is much shorter than that of the first."""
    kept = min(run.recorded, flights.size)
    if kept < modes.FEWEST:
        return False
    begin, part = run.recorded - kept, kept // 3
    late = _longest(flights, first, run.recorded - part, run.recorded)
    return late < FADED * _longest(flights, first, begin, begin + part)


@jit
def _longest(flights: Flights, first: int, begin: int, end: int) -> float:
    """The longest of a run's flights from `begin` to `end`, rad; 0 without one."""
    longest = 0.0
    for i in range(begin, end):
        longest = max(longest, flights.time[slot(flights, first, i)])
    return longest


@allocating
def _counted(
    flights: Flights, first: int, recorded: int, kept: int, micro_flight: float
) -> tuple[Any, Any, Any]:
    """Times, take-off phases and periods, arrays (n,), of the last `kept` flights that count for the mode."""
    longest = _longest(flights, first, recorded - kept, recorded)
    shortest = micro_flight if longest > micro_flight else 0.0
    time, phase, period = np.empty(kept), np.empty(kept), np.empty(kept, dtype=np.int64)
    count = 0
    for i in range(recorded - kept, recorded):
        j = slot(flights, first, i)
        if flights.time[j] > shortest:
            time[count], phase[count], period[count] = flights.time[j], flights.phase[j], flights.period[j]
            count += 1
    return time[:count], phase[:count], period[:count]


def allocate_flights(keep: int, lanes: int) -> Flights:
    """Ring buffers for `lanes` cells at a time; `keep`: flights stored of each cell."""
    size = max(1 << (keep - 1).bit_length(), KEPT_FLIGHTS)
    n = lanes * size
    return Flights(np.empty(n), np.empty(n), np.empty(n, dtype=np.int64), size, keep)


@jit
def write_record(line: Line, i: int, run: Progress, flights: Flights, first: int, window: Window) -> None:
    """Write the record of a cell whose run has ended as the i-th of `line`."""
    outcome, bounces, periods = classify(run, flights, first, window)
    line.flights[i], line.outcome[i] = run.recorded - run.opened, outcome
    line.bounces[i], line.periods[i] = bounces, periods
    keep = line.flight_time.shape[1]
    kept = min(run.recorded - run.opened, keep)
    for k in range(kept):
        j = slot(flights, first, run.recorded - kept + k)
        line.flight_time[i, k], line.takeoff_phase[i, k] = flights.time[j], flights.phase[j]
    for k in range(kept, keep):  # may hold flights of an earlier window of this cell
        line.flight_time[i, k] = line.takeoff_phase[i, k] = math.nan
    store_state(run, line.end_state[i])
