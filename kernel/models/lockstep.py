"""The event loop of `rigid` for many lines of cells at a time, in lanes.

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
    record,
    shows_no_mode,
    store_run,
    store_state,
    write_record,
)
from kernel.interface import contact, flight, prepare
from kernel.models.lanes import (
    AT_ROOT,
    COS,
    COUNT,
    FALLBACK,
    K0,
    K1,
    MOVE,
    ROWS,
    SEARCHING,
    SIN,
    STATUS,
    TAU,
    Y1,
    Y,
    advance,
    coefficients,
    load,
    supports,
)
from kernel.models.rigid import RigidPlate, Spring, land
from kernel.numerics.elementary import sincos
from kernel.numerics.first_root import HORIZON, ROOT, Phase, departure_step
from kernel.numerics.jit import inlined, jit
from kernel.numerics.oscillator import decay_time, derivatives
from kernel.params import LANES, STATE_FIELDS, Line
from kernel.portable_math import hypot

#: Flights shorter than this (rad) are computed again by the scalar functions, whose power series keeps the
#: digits. The closed form of the gap cancels to the order tau**3: here to 1e-4, which leaves 12 digits.
SHORT_FLIGHT: Final = 0.05

#: So are flights whose first safe step from the plate is shorter than this (rad): there the gap, of the
#: order of the cube, 1e-12, is near the rounding of the closed form.
SHORT_START: Final = 1e-4

#: Up to so many lines are computed one by one, more in a vector.
FEW: Final = 3


@inlined
def _load_contact(
    table: Any, k: int, s: Spring, run: Progress, sin: float, cos: float, horizon: float
) -> bool:
    """Put a contact into lane k, unless it never ends, which `rigid` knows in closed form.

    sin and cos are of the plate's phase now.
    """
    h = run.q - s.static_elongation - (s.q_re * cos - s.q_im * sin)
    h1 = run.q1 + (s.q_re * sin + s.q_im * cos)
    h2, h3, _ = derivatives(s.stuck, h, h1)
    decayed = decay_time(s.stuck, h2, h3, s.mean_force - hypot(s.n_re, s.n_im))
    if decayed == 0.0:
        return False
    load(table, k, s.stuck, run.phase, h, h1, 0.0, min(horizon, decayed))
    coefficients(table, k, -s.stiffness, -s.dashpot, s.mean_force, 0.0, 0.0, -s.n_re, s.n_im)
    return True


@inlined
def _load_flight(
    table: Any, k: int, s: Spring, run: Progress, sin: float, cos: float, horizon: float
) -> bool:
    """Put a flight into lane k, unless it begins with a short hop or too close to the plate."""
    q2, q3, q4 = derivatives(s.flight, run.q, run.q1)
    gap2, start = cos - s.gravity - 0.5 * q2, 0.0
    if run.gap == 0.0 and run.gap1 == 0.0:
        start = departure_step(max(gap2, 0.0), -sin - 0.5 * q3, 1.0 + 0.5 * q4)
        if start < SHORT_START:
            return False
    elif run.gap == 0.0 and 2.0 * run.gap1 < -gap2 * SHORT_FLIGHT:
        return False
    load(table, k, s.flight, run.phase, run.q, run.q1, start, horizon)
    coefficients(
        table, k, -0.5, 0.0, run.gap + (cos + 0.5 * run.q), run.gap1 + (0.5 * run.q1 - sin),
        0.5 * s.gravity, -1.0, 0.0,
    )  # fmt: skip
    return True


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
def _phase_of(table: Any, k: int, s: Spring, run: Progress) -> tuple[Phase, float, float]:
    """The phase that ended in lane k, with sin and cos of the plate's phase at its end.

    The state at the zero follows from that at the last evaluation by Taylor series in the last step, MOVE,
    to the fourth order (y) and third (y'); MOVE is below first_root.NEAR, so that the rest is rounding.
    """
    sin, cos = table[SIN * LANES + k], table[COS * LANES + k]
    move = table[MOVE * LANES + k]
    tau = table[TAU * LANES + k] + move
    y, y1 = table[Y * LANES + k], table[Y1 * LANES + k]
    osc = s.flight if run.in_flight else s.stuck
    y2, y3, _ = derivatives(osc, y, y1)
    y4 = -2.0 * osc.damping * y3 - osc.stiffness * y2
    y += move * (y1 + 0.5 * move * (y2 + move * (1.0 / 3.0) * (y3 + 0.25 * move * y4)))
    y1 += move * (y2 + 0.5 * move * (y3 + move * (1.0 / 3.0) * y4))
    square = move * move
    sine, versine = move * (1.0 - square * (1.0 / 6.0)), square * (0.5 - square * (1.0 / 24.0))
    sin, cos = sin + cos * sine - sin * versine, cos - sin * sine - cos * versine
    ending = ROOT if table[STATUS * LANES + k] == AT_ROOT else HORIZON
    used = int(table[COUNT * LANES + k])
    if not run.in_flight:
        q = s.static_elongation + (s.q_re * cos - s.q_im * sin) + y
        q1 = y1 - (s.q_re * sin + s.q_im * cos)
        return Phase(tau, ending, ending == ROOT, 0.0, 0.0, q, q1, used), sin, cos
    drift = table[K1 * LANES + k]
    gap1 = sin + drift - s.gravity * tau - 0.5 * y1
    if ending != ROOT:
        gap = table[K0 * LANES + k] - cos + (drift - 0.5 * s.gravity * tau) * tau - 0.5 * y
        return Phase(tau, ending, True, gap, gap1, y, y1, used), sin, cos
    return land(s, sin, cos, tau, gap1, y, y1, used), sin, cos


@jit
def _scalar_phase(s: Spring, run: Progress) -> Phase:
    """The run's next phase by the scalar functions of `rigid`."""
    horizon = horizon_of(run)
    p: Phase
    if run.in_flight:
        p = flight(s, run.phase, run.gap, run.gap1, run.q, run.q1, horizon, run.budget)
    else:
        p = contact(s, run.phase, run.gap, run.gap1, run.q, run.q1, horizon, run.budget)
    return p


@inlined
def _load(table: Any, k: int, s: Spring, run: Progress, sin: float, cos: float) -> bool:
    """Put the run's next phase into lane k; False if it must be computed by the scalar functions."""
    horizon = horizon_of(run)
    if run.in_flight:
        loaded = _load_flight(table, k, s, run, sin, cos, horizon)
    else:
        loaded = _load_contact(table, k, s, run, sin, cos, horizon)
    return loaded and supports(s.stuck) and supports(s.flight)


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


@jit
def run_lockstep(
    plate: RigidPlate, gamma: Any, omega: Any, xi: Any, length: int, states: Any, window: Window, line: Line,
    flights: Flights, lanes: Lanes, steps: int,
) -> bool:  # fmt: skip
    """Run lines of `length` cells each and fill `line`; arrays (n,) as in `kernel.line.run_line`.

    `states`: (n / length, 6) where each line begins, as in `cell.begin_line`. Within a line the state is
    carried from cell to cell. Pauses after `steps` moves of all lanes or scalar phases, or a few more;
    returns whether all is done. The next call goes on from `flights` and `lanes`.
    """
    table, index, counts, followed = lanes.table, lanes.index, lanes.counts, lanes.followed
    springs = [prepare(plate, i, gamma[i], omega[i], xi[i]) for i in np.maximum(index, 0)]
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
                        p, sin, cos = _phase_of(table, k, springs[k], before)
                    runs[k] = record(before, p, window, flights, first)
                    if window.settle_tolerance > 0.0:
                        runs[k] = end_settling(before, runs[k], window, flights, first)
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
                    loaded = _load(table, k, springs[k], runs[k], sin, cos)
                    table[STATUS * LANES + k] = SEARCHING if loaded else FALLBACK
                    if not loaded and steps <= 0:  # the next call goes on with this lane
                        _store_runs(runs, lanes.runs)
                        return False
        advance(table, used)
        steps -= 1
    _store_runs(runs, lanes.runs)
    return bool(counts[1] == len(gamma))


@jit
def lanes_used(lines: int) -> int:
    """Lanes that so many lines are computed in: one by one, one vector (half of all), or all."""
    if lines <= FEW:
        return lines
    return LANES // 2 if lines <= LANES // 2 else LANES


@inlined
def _store_runs(runs: list[Progress], numbers: Any) -> None:
    for k in range(LANES):
        store_run(runs[k], numbers[k])
