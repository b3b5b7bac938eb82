"""Starts on the cycles of a branch, against the simulating kernel."""

import numpy as np
import pytest
from kernel_runs import TWO_PI, run

from kernel.cycles.events import branch
from kernel.cycles.starts import cycles_at, start_on_cycle, start_on_stable_cycle
from kernel.cycles.thresholds import thresholds
from kernel.params import STATE_FIELDS, Cell


def random_cells(count: int) -> list[tuple[Cell, int, float]]:
    """Cells with a stable admissible cycle, its plate periods and its flight time."""
    rng = np.random.default_rng(9)
    found: list[tuple[Cell, int, float]] = []
    while len(found) < count:
        omega, xi = float(rng.uniform(0.25, 2.0)), float(10.0 ** rng.uniform(-2.0, 0.3))
        periods = int(rng.integers(1, 4))
        line = branch(omega, xi, periods, rng.uniform(0.3, TWO_PI * periods - 0.3, 30))
        holds = np.flatnonzero(line.stable & (line.violations == 0) & (line.gamma < 8.0))
        found += [
            (Cell(float(line.gamma[i]), omega, xi), periods, float(line.flight_time[i])) for i in holds[:2]
        ]
    return found[:count]


def flights_of(found, cycles: int, periods: int):
    start = found.start
    gamma, omega, xi = start.cell
    line = run(gamma, omega, xi, carry=True, start=start, settle=0, observe=(cycles + 2) * periods, keep=64)
    return line.flight_time[0, :cycles]


def test_a_start_is_on_the_cycle():
    """In flight and in contact at phase 0; the simulation repeats the flight from its first landing on."""
    in_flight = 0
    for cell, periods, time in random_cells(60):
        start = start_on_cycle(cell, periods, time)
        assert start is not None
        state = start.start.state
        assert state.shape == (len(STATE_FIELDS),)
        assert state[0] == 0.0
        in_flight += int(state[1])
        assert start.cycle.flight_time == pytest.approx([time], abs=1e-9)
        assert flights_of(start, 2, periods) == pytest.approx([time, time], abs=1e-9)
    assert 0 < in_flight < 60


def test_the_stable_cycle_of_the_longest_flight_is_taken():
    """At Omega = 0.6 two stable cycles (1, 1) exist between Gamma_th and the jump; far below, none."""
    found = thresholds(0.6, 0.05)
    cell = Cell(0.5 * (found.gamma_th + found.jump), 0.6, 0.05)
    line = cycles_at(Cell(0.7, 0.6, 0.05), 1)
    assert line.gamma == pytest.approx([0.7, 0.7], abs=1e-12)
    assert line.stable.tolist() == [False, True]
    line = cycles_at(cell, 1)
    held = line.flight_time[line.stable & (line.violations == 0)]
    assert flights_of(start_on_stable_cycle(cell, 1), 1, 1) == pytest.approx(held[-1:], abs=1e-9)
    assert start_on_stable_cycle(Cell(found.down - 1e-6, 0.6, 0.05), 1) is None
    assert start_on_stable_cycle(Cell(found.down + 1e-6, 0.6, 0.05), 1) is not None
    assert start_on_cycle(Cell(0.3, 0.6, 0.05), 1, 4.0) is None
