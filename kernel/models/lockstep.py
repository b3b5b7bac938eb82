"""The event loop for many lines of cells at a time, in lanes.

Every lane holds one cell and one of its contacts or flights. `lanes.advance` moves all lanes on. A lane
whose phase has ended goes through the landing or take-off here and gets its next phase or, at the end of
its window, the next cell of its line, or of the next line. Cells from rest are lines of one cell. Phases
that lanes cannot compute well, such as flights so short that they need the power series, are computed by the
scalar functions of `rigid` at once, so that a cell's record depends on nothing but the cell and those before
it on its line.
"""

from typing import Any, Final, NamedTuple

import numpy as np

from kernel.cell import (
    RUN_FIELDS,
    Flights,
    Progress,
    Window,
    begin_line,
    begin_next,
    decide,
    end_settling,
    extend,
    follow,
    horizon_of,
    load_run,
    may_repeat,
    record,
    shows_no_mode,
    skip_cycles,
    store_run,
    store_state,
    write_record,
)
from kernel.interface import advance_lanes, contact, flight, load_lane, prepare, unload_lane
from kernel.models.lanes import AT_ROOT, FALLBACK, K0, ROWS, SEARCHING, SHORT_FLIGHT, STATUS, TAU
from kernel.numerics.elementary import sincos
from kernel.numerics.first_root import ROOT, Phase
from kernel.numerics.jit import allocating, inlined, jit
from kernel.params import LANES, STATE_FIELDS, Line

#: Up to so many lines are computed one by one, more in a vector.
FEW: Final = 3


@inlined
def _needs_scalar(table: Any, k: int, run: Progress) -> bool:
    """Whether lane k's phase must be computed again by the scalar functions.

    So are short flights, searches that failed, and contacts that reached their horizon: it may be the time
    from which they never end, not the window's.
    """
    if table[STATUS * LANES + k] == AT_ROOT:
        return run.in_flight and table[TAU * LANES + k] < SHORT_FLIGHT
    return table[STATUS * LANES + k] == FALLBACK or not run.in_flight


@inlined
def _scalar_phase(s: Any, run: Progress) -> Phase:
    """The run's next phase by the scalar functions."""
    horizon = horizon_of(run)
    p: Phase
    if run.in_flight:
        p = flight(s, run.phase, run.gap, run.gap1, run.q, run.q1, horizon, run.budget)
    else:
        p = contact(s, run.phase, run.gap, run.gap1, run.q, run.q1, horizon, run.budget)
    return p


class Lanes(NamedTuple):
    """What is in the lanes of a line under way."""

    table: Any  # (ROWS * LANES,) the phases, see `lanes`
    runs: Any  # (LANES, RUN_FIELDS) the cells' runs
    index: Any  # (LANES,) int64, the cell in each lane; -1: none
    counts: Any  # (2,) int64: lines put into a lane so far, cells done
    followed: Any  # (LANES,) bool, whether the cell is followed beyond its window
    ends: Any  # (LANES, RUN_FIELDS) of cells that are, the run at the window's end


def allocate_lanes() -> Lanes:
    """Empty lanes."""
    table = np.zeros(ROWS * LANES)
    table[K0 * LANES : (K0 + 1) * LANES] = 1.0  # F = 1 keeps the arithmetic of idle lanes finite
    runs, ends = np.zeros((LANES, RUN_FIELDS)), np.zeros((LANES, RUN_FIELDS))
    index, counts = np.full(LANES, -1), np.zeros(2, np.int64)
    return Lanes(table, runs, index, counts, np.zeros(LANES, dtype=np.bool_), ends)


@allocating
def run_lockstep(
    plate: Any, gamma: Any, omega: Any, xi: Any, length: int, states: Any, window: Window, line: Line,
    flights: Flights, lanes: Lanes, steps: int,
) -> bool:  # fmt: skip
    """Run lines of `length` cells each and fill `line`; arrays (n,) as in `kernel.line.run_line`.

    `states`: (n / length, 6) where each line begins, as in `cell.begin_line`. Within a line the state is
    carried from cell to cell. Pauses after `steps` moves of all lanes or scalar phases, or a few more;
    returns whether all is done. The next call goes on from `flights` and `lanes`.
    """
    table, index, counts, followed = lanes.table, lanes.index, lanes.counts, lanes.followed
    springs = [prepare(plate, max(i, 0), gamma[i], omega[i], xi[i]) for i in index]
    runs = [load_run(lanes.runs[k]) for k in range(LANES)]
    state = np.zeros(len(STATE_FIELDS))
    lines = len(gamma) // length
    used = lanes_used(lines)
    while counts[1] < len(gamma) and steps > 0:
        for k in range(used):
            first = k * flights.size
            while index[k] < 0 or table[STATUS * LANES + k] != SEARCHING:
                steps -= 1
                i = index[k]
                if i < 0:
                    if counts[0] == lines:
                        break
                    i = counts[0] * length
                    springs[k] = prepare(plate, i, gamma[i], omega[i], xi[i])
                    runs[k] = begin_line(springs[k], states, counts[0], state, window)
                    index[k] = i
                    sin, cos = sincos(runs[k].phase)
                    counts[0] += 1
                else:
                    before = runs[k]
                    scalar = _needs_scalar(table, k, before)
                    if scalar:
                        p = _scalar_phase(springs[k], before)
                    else:
                        p, sin, cos = unload_lane(springs[k], table, k, before)
                    runs[k] = record(before, p, window, flights, first)
                    if window.settle_tolerance > 0.0:
                        runs[k] = end_settling(before, runs[k], window, flights, first)
                    if may_repeat(before, runs[k], window):
                        runs[k] = skip_cycles(runs[k], flights, first)
                    if scalar:
                        sin, cos = sincos(runs[k].phase)
                    if runs[k].ending != ROOT:
                        if followed[k]:
                            line.outcome[i] = decide(line.outcome[i], runs[k], flights, first, window)
                            runs[k], followed[k] = load_run(lanes.ends[k]), False
                        else:
                            store_state(runs[k], state)
                            write_record(line, i, runs[k], flights, first, state, window)
                            if shows_no_mode(line.outcome[i]):
                                store_run(runs[k], lanes.ends[k])
                                runs[k], followed[k] = follow(before, window), True
                                sin, cos = sincos(before.phase)
                    if runs[k].ending != ROOT:
                        runs[k] = extend(runs[k], line.outcome[i], window)
                        sin, cos = 0.0, 1.0  # a window ends at phase zero
                    if runs[k].ending != ROOT:
                        counts[1] += 1
                        if (i + 1) % length == 0:
                            index[k] = -1
                        else:
                            index[k] = i + 1
                            springs[k] = prepare(plate, i + 1, gamma[i + 1], omega[i + 1], xi[i + 1])
                            runs[k] = begin_next(
                                springs[k], runs[k], gamma[i], omega[i], gamma[i + 1], omega[i + 1], state,
                                window,
                            )  # fmt: skip
                            sin, cos = sincos(runs[k].phase)
                if index[k] >= 0:
                    loaded = load_lane(springs[k], table, k, runs[k], sin, cos, horizon_of(runs[k]))
                    table[STATUS * LANES + k] = SEARCHING if loaded else FALLBACK
                    if not loaded and steps <= 0:  # the next call goes on with this lane
                        _store_runs(runs, lanes.runs)
                        return False
        advance_lanes(plate, table, used)
        steps -= 1
    _store_runs(runs, lanes.runs)
    return bool(counts[1] == len(gamma))


@jit
def lanes_used(lines: int) -> int:
    """Lanes that so many lines are computed in: one by one, one vector (half of all), or all."""
    if lines <= FEW:
        return lines
    return LANES // 2 if lines <= LANES // 2 else LANES


@allocating
def _store_runs(runs: list[Progress], numbers: Any) -> None:
    for k in range(LANES):
        store_run(runs[k], numbers[k])
