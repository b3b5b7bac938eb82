"""A periodic cell certifies itself: Newton's method from where its flights nearly repeat (docs/model.md).

A *candidate* is a number of flights after which the last flights repeat within NEAR. From a *section* of the
trajectory, in the middle of a contact or flight, Newton's method solves y = P(y), P being the map over the
candidate's plate periods. Its derivative M is carried along exactly (`interface.carry_in_contact` and kin).
The cycle is accepted if its leading multiplier is below one and the map surely contracts at the trajectory's
distance from it; otherwise the trajectory goes on. All this depends on a cell's flights only.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np

from kernel import interface
from kernel.cell import PERIODIC, Progress, Window, changed, record, store_state
from kernel.interface import Phase, State, phase_of, plate_phase
from kernel.modes import Flights, move_flights, slot
from kernel.numerics.elementary import TWO_PI
from kernel.numerics.first_root import HORIZON, ROOT
from kernel.numerics.jit import allocating, inlined, jit, outlined
from kernel.numerics.matrices import (
    apply,
    contracting_norm,
    dot,
    largest,
    leading_eigenvalue,
    set_identity,
    solve,
    trace,
    transpose,
)
from kernel.params import BUDGET, Line

EVERY: Final = 4  # counting flights between two searches for cycles of up to SHORT flights, ...
RARELY: Final = 32  # ... and of up to LONGEST
SHORT: Final = 24
LONGEST: Final = 85
SEARCHED: Final = 256  # flights kept for the search, a power of two of at least 3 * LONGEST
LINGERS: Final = 96  # flights that tell whether a motion lingers beside a cycle of up to LINGERING flights
LINGERING: Final = 8  # most motions beside longer ones are no transients, and would take a tenth of the time
ALONE: Final = 24  # plate periods without a counting flight after which all flights count

NEAR: Final = 1e-3  # rad within which flights of a candidate repeat; the result does not depend on it
LEFT: Final = 10.0 * NEAR  # rad beyond which the trajectory has left a candidate that failed
NEARER: Final = 0.3  # part of the difference at a failure, at which a candidate is tried again
BETTER: Final = 0.1  # a candidate's difference must be below this part of any divisor's
ROUNDING: Final = 1e-13  # rad by which differences may grow; relative error of states

SOLVED: Final = 1e-11  # the last step of Newton's method, relative to the state
STEPS: Final = 8  # most steps of Newton's method
SAME: Final = 1e-8  # rad within which flights of a cycle repeat
FAR: Final = 2**40  # plate periods: no end

MARGIN: Final = 1e-6  # of the leading multiplier from one
DEFECT: Final = 0.5  # of the map from its linear part, over the contraction that there must be
#: Rounding error of flights, rad, if small changes of state and phase change them by up to GROWTH times as
#: much; beside grazes and in long cycles it is larger in proportion. Where changes by SHIFT lead elsewhere,
#: those by LEAST are taken, about as small as rounding is.
FLOOR: Final = 5e-13
GROWTH: Final = 5.0
SHIFT: Final = 1e-13
LEAST: Final = 1e-15

#: The counts of a lane: flights read, flights that count, plate period of the last flight that is not too
#: short; flights and plate periods of the candidate.
READ, COUNTED, LONGER, BOUNCES, PERIODS = range(5)

#: The ending of a run whose cell is certified, beside those of `first_root`.
CERTIFIED: Final = 4


class Attempt(NamedTuple):
    """Arrays for an attempt."""

    cycle: Flights  # two turns of it
    vectors: Any  # (4, 4) the variations of a turn
    none: Any  # (0, 4) no variations
    y: Any  # (4,) the cycle's state at the section
    first: Any  # (4,) where the trajectory is after a turn
    step: Any  # (4,) of Newton's method
    turn: Any  # (4, 4) the derivative of a turn
    error: Any  # (1,) rad, by rounding: of the landings of a turn, in the end of the cycle's flights


class Search(NamedTuple):
    """The state of the search for cycles of the cells in some lanes."""

    time: Any  # (lanes * SEARCHED,) the flights that count, in ring buffers as `modes.Flights`
    phase: Any
    period: Any
    failed: Any  # (lanes, LONGEST + 1) rad, differences at which candidates last failed, -1: for good; 0: now
    counts: Any  # (lanes, 5) int64, see READ


def allocate_search(lanes: int) -> Search:
    """Room for the cells in some lanes."""
    n = lanes * SEARCHED
    failed, counts = np.full((lanes, LONGEST + 1), np.inf), np.zeros((lanes, 5), np.int64)
    return Search(np.empty(n), np.empty(n), np.empty(n, np.int64), failed, counts)


def allocate_attempt(flights: Flights) -> Attempt:
    """Room for an attempt at a cycle of cells whose flights are recorded in `flights`."""
    size = 2 * flights.size
    cycle = Flights(np.empty(size), np.empty(size), np.empty(size, np.int64), size, 0)
    vectors, none, turn = np.zeros((4, 4)), np.zeros((0, 4)), np.zeros((4, 4))
    return Attempt(cycle, vectors, none, np.zeros(4), np.zeros(4), np.zeros(4), turn, np.zeros(1))


@jit
def begin_search(search: Search, k: int) -> None:
    """Begin a cell in lane k."""
    search.failed[k] = math.inf
    search.counts[k] = 0


@jit
def move_search(search: Search, k: int, other: int) -> None:
    """Move the search of the cell in lane k to another lane."""
    move_flights(_ring(search), k * SEARCHED, other * SEARCHED)
    for i in range(LONGEST + 1):
        search.failed[other, i] = search.failed[k, i]
    for i in range(PERIODS + 1):
        search.counts[other, i] = search.counts[k, i]


@outlined
def certified(
    cell: Any, run: Progress, i: int, k: int, window: Window, line: Line, flights: Flights, search: Search,
    attempt: Attempt,
) -> Progress:  # fmt: skip
    """The run in lane k, which has a candidate; if certified, on the cycle, with the ending CERTIFIED.

    Then writes the record of the i-th cell.
    """
    periods = search.counts[k, PERIODS]
    begins, start = _section(cell, run, k, periods, window, flights, attempt)
    found = begins and _newton(cell, start, periods, window, attempt)
    if found:
        run = _accept(cell, run, start, periods, window, attempt, i, line)
    if run.ending != CERTIFIED:
        unbounded = found and attempt.error[0] == math.inf  # of the cycle, and so from any section
        search.failed[k, search.counts[k, BOUNCES]] = -1.0 if unbounded else search.failed[k, 0]
    return run


@jit
def follows_refused(k: int, search: Search) -> bool:
    """Whether the cell in lane k repeats, by rounding, a cycle that cannot be certified.

    Its error has no bound, or it repeats to the last digit and no attempt certifies it.
    """
    refused = False
    for bounces in range(1, LONGEST + 1):
        refused |= search.failed[k, bounces] <= 0.0
    return refused


@outlined
def lingers(k: int, search: Search) -> bool:
    """Whether the last flights of the cell in lane k nearly repeat a cycle, as beside one that is no more."""
    n, first, ring = search.counts[k, COUNTED], k * SEARCHED, _ring(search)
    begin = n - min(n, LINGERS)
    for bounces in range(1, min(LINGERING, (n - begin) // 4) + 1):
        newest, periods = _newest(n, first, bounces, search)
        near = newest <= LEFT
        if near and _difference(ring, first, begin + bounces, n, bounces, periods) <= LEFT:
            return not follows_refused(k, search)
    return False


# --- the search for a candidate -------------------------------------------------------------------------


@inlined
def has_candidate(run: Progress, k: int, window: Window, flights: Flights, search: Search) -> bool:
    """Whether the run in lane k, after a flight, nearly repeats a cycle worth an attempt."""
    is_new = run.ending == ROOT and run.recorded > search.counts[k, READ]
    return is_new and _read(run.recorded, k, window, flights, search) and _chosen(k, search)


@jit
def _chosen(k: int, search: Search) -> bool:
    """Whether there is a candidate, which is then noted as the one under way."""
    if not _is_near(k, search):
        return False
    bounces, periods, difference = _candidate(k, search)
    search.counts[k, BOUNCES], search.counts[k, PERIODS] = bounces, periods
    search.failed[k, 0] = difference
    return bounces > 0


@jit
def _read(recorded: int, k: int, window: Window, flights: Flights, search: Search) -> bool:
    """Read the flights recorded since the last call; whether it is time to look for a candidate."""
    counts, due = search.counts[k], False
    for n in range(counts[READ], recorded):
        j = slot(flights, k * flights.size, n)
        longer = flights.time[j] > window.micro_flight
        if longer:
            counts[LONGER] = flights.period[j]
        if longer or flights.period[j] - counts[LONGER] > ALONE:
            m = slot(_ring(search), k * SEARCHED, counts[COUNTED])
            search.time[m], search.phase[m] = flights.time[j], flights.phase[j]
            search.period[m] = flights.period[j]
            counts[COUNTED] += 1
            due = due or counts[COUNTED] % EVERY == 0
    counts[READ] = recorded
    return due


@inlined
def _ring(search: Search) -> Flights:
    """The counting flights of all lanes."""
    return Flights(search.time, search.phase, search.period, SEARCHED, 0)


@jit
def _most(n: int) -> int:
    """Flights of the longest cycle to look for after n flights."""
    return min(LONGEST if n % RARELY == 0 else SHORT, n // 3)


@jit
def _is_near(k: int, search: Search) -> bool:
    """Whether the last flight is about as long as one before; if not, failures are forgotten.

    Of chaotic motions one flight in seven is. With unsigned indices the loops are vectorized: they take a
    quarter of the time of `_candidate`, which is skipped for the others.
    """
    n, first, near = search.counts[k, COUNTED], k * SEARCHED, False
    most, last = _most(n), (n - 1) & (SEARCHED - 1)
    newest, start = search.time[first + last], last - min(most, last)
    for i in range(first + start, first + last):
        near |= abs(newest - search.time[np.uint64(i)]) <= LEFT
    for i in range(first + SEARCHED - most + last - start, first + SEARCHED):
        near |= abs(newest - search.time[np.uint64(i)]) <= LEFT
    if not near:
        search.failed[k, 1 : most + 1] = math.inf
    return near


@jit
def _candidate(k: int, search: Search) -> tuple[int, int, float]:
    """Flights and plate periods of the shortest cycle to try, and its difference, rad; 0 without one."""
    n, failed = search.counts[k, COUNTED], search.failed[k]
    ring, first = _ring(search), k * SEARCHED
    chosen, chosen_periods, difference = 0, 0, 0.0
    for bounces in range(1, _most(n) + 1):
        newest, periods = _newest(n, first, bounces, search)
        if newest > LEFT:
            failed[bounces] = math.inf
            continue
        if chosen == 0 and periods >= 1 and newest <= min(NEAR, NEARER * failed[bounces]):
            last = _difference(ring, first, n - bounces, n, bounces, periods)
            repeats = last <= min(NEAR, NEARER * failed[bounces])
            if repeats and _approaches(ring, first, n, bounces, periods, last):
                chosen, chosen_periods, difference = bounces, periods, last
    return chosen, chosen_periods, difference


@inlined
def _newest(n: int, first: int, bounces: int, search: Search) -> tuple[float, int]:
    """How far the last of n flights differs from one earlier, rad, and the plate periods between."""
    ring = _ring(search)
    j, i = slot(ring, first, n - 1), slot(ring, first, n - 1 - bounces)
    difference, periods = abs(search.time[j] - search.time[i]), 0
    if difference <= LEFT:
        shift = search.phase[j] - search.phase[i]
        turn = round(shift * (1.0 / TWO_PI))  # phases either side of the turn of a period are neighbours
        difference = max(difference, abs(shift - TWO_PI * turn))
        periods = search.period[j] - search.period[i] + int(turn)
    return difference, periods


@jit
def _difference(flights: Flights, first: int, begin: int, end: int, bounces: int, periods: int) -> float:
    """How far the flights from `begin` to `end` differ at most from those `bounces` before, rad."""
    difference = 0.0
    for n in range(begin, end):
        j, i = slot(flights, first, n), slot(flights, first, n - bounces)
        turns = flights.period[j] - flights.period[i] - periods
        shift = flights.phase[j] - flights.phase[i] + TWO_PI * turns
        difference = max(difference, abs(flights.time[j] - flights.time[i]), abs(shift))
    return difference


@jit
def _approaches(flights: Flights, first: int, n: int, bounces: int, periods: int, last: float) -> bool:
    """Whether the flights do not leave a candidate, and no part of it repeats nearly as well as all of it."""
    before = _difference(flights, first, n - 2 * bounces, n - bounces, bounces, periods)
    if before > LEFT or last > before + ROUNDING:
        return False
    for shorter in range(1, bounces // 2 + 1):
        if bounces % shorter == 0:
            difference = 0.0
            for m in range(n - bounces, n):
                j, i = slot(flights, first, m), slot(flights, first, m - shorter)
                difference = max(difference, abs(flights.time[j] - flights.time[i]))
            if BETTER * difference <= last:
                return False
    return True


# --- Newton's method ------------------------------------------------------------------------------------


@jit
def _section(
    cell: Any, run: Progress, k: int, periods: int, window: Window, flights: Flights, attempt: Attempt
) -> tuple[bool, Progress]:
    """Whether a long contact or flight begins within two turns, and the run in the middle of it.

    It is at least half as long as the longest of a turn.
    """
    least = 0.5 * _longest(run, k, periods, flights)
    run = changed(run, recorded=0, opened=0, budget=BUDGET * periods, settle=0, end=FAR)
    last = run.period + 2 * periods
    while run.ending == ROOT and run.period <= last:
        phi = plate_phase(run.phase)
        p = phase_of(cell, phi, run, TWO_PI * (2 * periods + 1))
        if p.ending == ROOT and p.tau >= least:
            half = 0.5 * p.tau
            p = phase_of(cell, phi, run, half)
            turns = math.floor((run.phase + half) * (1.0 / TWO_PI))
            phase, period = run.phase + half - TWO_PI * turns, run.period + turns
            return True, changed(run, phase=phase, period=period, state=p.state)
        run = record(run, p, window, attempt.cycle, 0)
    return False, run


@jit
def _longest(run: Progress, k: int, periods: int, flights: Flights) -> float:
    """The longest contact or flight of the last turn, rad."""
    longest, landing = 0.0, TWO_PI * run.period + run.phase
    for n in range(run.recorded - 1, max(run.recorded - flights.size, 0) - 1, -1):
        j = slot(flights, k * flights.size, n)
        takeoff = TWO_PI * flights.period[j] + flights.phase[j]
        longest = max(longest, flights.time[j], landing - takeoff - flights.time[j])
        landing = takeoff
        if takeoff < TWO_PI * (run.period - periods) + run.phase:
            break
    return longest


@jit
def _cover(
    cell: Any, run: Progress, left: float, window: Window, vectors: Any, attempt: Attempt
) -> tuple[Progress, Phase]:
    """Follow a run, and variations `vectors` (n, 4) with the error of landings, for `left` rad.

    Returns the run before the phase that is cut off there, and that phase; one that fails ends it too.
    """
    while True:
        phi = plate_phase(run.phase)
        p = phase_of(cell, phi, run, max(left, 0.0))
        if len(vectors) > 0:
            if run.in_flight:
                interface.carry_in_flight(cell, vectors, p.tau)
                if p.ending == ROOT:
                    error = interface.landing_error(cell, phi, run.state, p.tau)
                    attempt.error[0] = max(attempt.error[0], error)
                    interface.carry_through_landing(cell, vectors, phi, run.state, p)
            else:
                interface.carry_in_contact(cell, vectors, p.tau)
                if p.ending == ROOT:
                    interface.carry_through_takeoff(cell, vectors, p)
        if p.ending != ROOT:
            return run, p
        left -= p.tau
        run = record(run, p, window, attempt.cycle, 0)


@jit
def _from(start: Progress, y: Any) -> Progress:
    """The run that begins at the section `start` with the state y (4,)."""
    return changed(start, state=State(y[0], y[1], y[2], y[3]), takeoff_period=-1, recorded=0)


@jit
def _turn(
    cell: Any, start: Progress, periods: int, window: Window, attempt: Attempt
) -> tuple[bool, Progress, Phase]:
    """Follow a turn of `periods` plate periods from the state `attempt.y`, and its derivative `attempt.turn`.

    Returns whether it ends in the phase that it begins in, and the values of `_cover`.
    """
    set_identity(attempt.vectors)
    attempt.error[0] = 0.0
    run, p = _cover(cell, _from(start, attempt.y), TWO_PI * periods, window, attempt.vectors, attempt)
    transpose(attempt.vectors, attempt.turn)
    return p.ending == HORIZON and run.in_flight == start.in_flight, run, p


@jit
def _newton(cell: Any, start: Progress, periods: int, window: Window, attempt: Attempt) -> bool:
    """Whether Newton's method finds a cycle of `periods` plate periods from the section `start`.

    Writes `attempt.y` and `attempt.first`.
    """
    y, step, turn = attempt.y, attempt.step, attempt.turn
    y[0], y[1], y[2], y[3] = start.state
    scale, before = 1.0 + largest(y), 0.0
    for count in range(STEPS):
        closes, _, p = _turn(cell, start, periods, window, attempt)
        if not closes:
            return False
        if count == 0:
            attempt.first[0], attempt.first[1], attempt.first[2], attempt.first[3] = p.state
        step[0], step[1], step[2], step[3] = p.state
        for i in range(4):
            step[i] -= y[i]
            for j in range(4):
                turn[i, j] = (1.0 if i == j else 0.0) - turn[i, j]
        solve(turn, step)
        size = largest(step)
        if not size <= 0.5 * scale or (count >= 2 and size > 2.0 * before):
            return False
        for i in range(4):
            y[i] += step[i]
        # the next step would be about size * (size / before)**2
        nears = count >= 1 and size <= 1e-6 * scale and size <= 1e-3 * before
        if size <= SOLVED * scale or (nears and (size / before) ** 2 * size <= SOLVED * scale):
            return True
        before = size
    return False


# --- the cycle ------------------------------------------------------------------------------------------


@jit
def _accept(
    cell: Any, run: Progress, start: Progress, periods: int, window: Window, attempt: Attempt, i: int,
    line: Line,
) -> Progress:  # fmt: skip
    """The run on the cycle through `attempt.y` at the section `start`, if it is certified; else `run`.

    It then ends where the cycle passes the window's end, at phase zero. Writes the record of the i-th cell.
    """
    cycle = attempt.cycle
    end = start.period + periods + 1
    end += (window.settle + window.observe - end) % periods
    total, last = _two_turns(cell, run, start, periods, end, window, attempt)
    half = total // 2
    repeats = _difference(cycle, 0, half, total, half, periods)
    if total == 0 or not repeats <= SAME:
        return run
    modulus, angle = leading_eigenvalue(attempt.turn)
    if not (modulus < 1.0 and _contracts(attempt, modulus, start.state)):
        return run
    parts = _parts(cycle, total, periods, max(SAME, 10.0 * repeats))
    flights, part = half // parts, periods // parts
    if parts > 1:
        closes, _, _ = _turn(cell, start, part, window, attempt)
        modulus, angle = leading_eigenvalue(attempt.turn)
        if not closes:
            return run
    repeats = _difference(cycle, 0, half, total, flights, part)
    growth = _growth(cell, start, periods, total, window, attempt, SHIFT)
    if growth > GROWTH:  # changes may cancel: others are tried
        growth = max(growth, _growth(cell, start, periods, total, window, attempt, -SHIFT))
    if growth == math.inf:
        growth = _growth(cell, start, periods, total, window, attempt, LEAST)
        growth = max(growth, _growth(cell, start, periods, total, window, attempt, -LEAST))
    error = repeats + FLOOR * max(1.0, growth / GROWTH) + attempt.error[0]
    attempt.error[0] = error
    if not (modulus < 1.0 - MARGIN and error < math.inf):  # a touch whose rate is zero has no bound
        return run
    line.flight_error[i] = error / (1.0 - modulus)
    line.multiplier[i], line.multiplier_angle[i] = modulus, angle
    line.outcome[i], line.periods[i] = PERIODIC, part
    line.bounces[i] = _counting(cycle, total, flights, window.micro_flight)
    _write_flights(cycle, total, flights, part, end, window.observe, line, i)
    store_state(last, line.end_state[i])
    return last


@jit
def _two_turns(
    cell: Any, run: Progress, start: Progress, periods: int, end: int, window: Window, attempt: Attempt
) -> tuple[int, Progress]:
    """Follow two turns of the cycle through `attempt.y`: flights of both, 0 if they are not as many in each.

    The derivative of the first is `attempt.turn`. Also returns `run`, ended in the cycle's state at the plate
    period `end`, in the second turn.
    """
    closes, turn, _ = _turn(cell, start, periods, window, attempt)
    if not closes:
        return 0, run
    left = TWO_PI * (end - turn.period) - turn.phase
    last, p = _cover(cell, turn, left, window, attempt.none, attempt)
    if p.ending != HORIZON:
        return 0, run
    left = TWO_PI * (start.period + 2 * periods - last.period) + start.phase - last.phase
    total = _recorded(cell, last, left, periods, window, attempt)
    ended = changed(run, phase=0.0, period=run.end, in_flight=p.in_flight, state=p.state, ending=CERTIFIED)
    return total if total % 2 == 0 and total <= attempt.cycle.size else 0, ended


@jit
def _recorded(cell: Any, run: Progress, left: float, periods: int, window: Window, attempt: Attempt) -> int:
    """Follow a run for `left` rad and to the end of the phase that is cut off there: flights recorded."""
    while run.ending == ROOT:
        p = phase_of(cell, plate_phase(run.phase), run, TWO_PI * (periods + 1))
        run = record(run, p, window, attempt.cycle, 0)
        if p.tau >= max(left, 0.0):
            return run.recorded if run.ending == ROOT else 0
        left -= p.tau
    return 0


@jit
def _growth(
    cell: Any, start: Progress, periods: int, total: int, window: Window, attempt: Attempt, shift: float
) -> float:
    """Change of a turn's flights over small changes at each phase of it and of the turn before; rad.

    Each is relative, of the state, and absolute, of the phase. What rounding does at the section may be
    forgotten where the cycle sticks; what it does after that may grow until the cycle sticks again. total:
    flights of two turns. inf if the changed flights are no longer near. shift: of the phase at a take-off; at
    a landing half as much in the other sense, as changes at the ends of a short phase would cancel.
    """
    run, flights, size = _from(start, attempt.y), total // 2, abs(shift)
    more, less = 1.0 + size, 1.0 - size
    for _ in range(2):
        run = changed(run, recorded=0)
        while run.recorded < flights:
            x, change = run.state, shift if run.in_flight else -0.5 * shift
            state = State(more * x.gap, more * x.gap1, less * x.q, (1.0 + change) * x.q1)
            run = changed(run, phase=run.phase + change, state=state)
            p = phase_of(cell, plate_phase(run.phase), run, TWO_PI * (periods + 1))
            run = record(run, p, window, attempt.cycle, 0)
            if run.ending != ROOT:
                return math.inf
    difference = _difference(attempt.cycle, 0, flights, total, flights, 0)
    return difference / size if difference <= NEAR else math.inf


@jit
def _parts(cycle: Flights, total: int, periods: int, same: float) -> int:
    """Number of cycles in a turn of `periods` plate periods, which has half of `total` flights."""
    for parts in range(periods, 1, -1):
        flights = total // (2 * parts)
        whole = periods % parts == 0 and total % (2 * parts) == 0
        if whole and _difference(cycle, 0, total // 2, total, flights, periods // parts) <= same:
            return parts
    return 1


@allocating
def _contracts(attempt: Attempt, modulus: float, state: State) -> bool:
    """Whether a turn, whose derivative has this leading eigenvalue, contracts at the distance of a state.

    Its end `attempt.first` must differ by less than DEFECT of the contraction from what the derivative says.
    """
    turn, first, y, r = attempt.turn, attempt.first, attempt.y, 0.5 * (1.0 + modulus)
    norm, image, before, rest = np.empty((4, 4)), np.empty(4), np.empty(4), np.empty(4)
    contracting_norm(turn, r, norm)
    before[0], before[1], before[2], before[3] = state
    scale = 1.0 + largest(before)
    for j in range(4):
        before[j] -= y[j]
    apply(turn, before, image)
    for j in range(4):
        rest[j] = first[j] - y[j] - image[j]
    apply(norm, before, image)
    distance = math.sqrt(dot(before, image))
    apply(norm, rest, image)
    defect = math.sqrt(dot(rest, image))
    rounding = ROUNDING * scale * math.sqrt(trace(norm))
    return distance <= rounding or defect < DEFECT * (1.0 - r) * distance


@jit
def _write_flights(
    cycle: Flights, total: int, flights: int, periods: int, end: int, observe: int, line: Line, i: int
) -> None:
    """Write to the i-th record the cycle's flights in a window of `observe` plate periods before `end`.

    The cycle is that of the last `flights` of `total`.
    """
    first, number, latest = total - flights, 0, -FAR
    for n in range(first, total):
        turns = _last_before(cycle, n, periods, end)
        latest = max(latest, turns)
        # those that take off in the window
        number += max(turns + (cycle.period[n] - end + observe) // periods + 1, 0)
    keep = line.flight_time.shape[1]
    kept = min(number, keep)
    line.flights[i] = number
    for k in range(kept, keep):  # may hold flights of an earlier window
        line.flight_time[i, k] = line.takeoff_phase[i, k] = math.nan
    turns, n = latest, total - 1
    while kept > 0:
        if turns <= _last_before(cycle, n, periods, end):
            kept -= 1
            line.flight_time[i, kept], line.takeoff_phase[i, kept] = cycle.time[n], cycle.phase[n]
        n -= 1
        if n < first:
            turns, n = turns - 1, total - 1


@jit
def _last_before(cycle: Flights, n: int, periods: int, end: int) -> int:
    """Number of turns after which the n-th flight of a cycle lands for the last time before period `end`."""
    landing = cycle.period[n] + math.floor((cycle.phase[n] + cycle.time[n]) * (1.0 / TWO_PI))
    last: int = (end - 1 - landing) // periods
    return last


@jit
def _counting(cycle: Flights, total: int, flights: int, micro_flight: float) -> int:
    """How many of the last `flights` of `total` count for the mode."""
    longer = 0
    for n in range(total - flights, total):
        if cycle.time[n] > micro_flight:
            longer += 1
    return longer if longer > 0 else flights
