"""Settling that ends as soon as the flights repeat, where the specification allows it."""

import numpy as np
import pytest
from kernel_runs import Model, run_line

from kernel.cell import Flights, Progress, Window, end_settling, record, start_run
from kernel.numerics.first_root import ROOT, Phase
from kernel.params import Line, Outcome


def run(gamma, settle_tolerance, *, settle=400, carry=False, model=Model.RIGID) -> Line:
    full = np.full_like
    return run_line(
        gamma, full(gamma, 0.5), full(gamma, 0.26), model=model, restitution=full(gamma, 0.01),
        penetration=full(gamma, 1e-3), adhesive=True, carry=carry, settle=settle, observe=40, keep=24,
        settle_tolerance=settle_tolerance,
    )  # fmt: skip


@pytest.mark.parametrize("carry", [False, True])
def test_periodic_cells_keep_their_flights_within_the_tolerance(carry):
    gamma = np.linspace(1.3, 3.6, 24)
    full, early = run(gamma, 0.0, carry=carry), run(gamma, 1e-9, carry=carry)
    both = (full.outcome == Outcome.PERIODIC) & (early.outcome == Outcome.PERIODIC)
    both &= full.bounces == early.bounces
    assert both.sum() >= 15
    for i in np.flatnonzero(both):
        cycles = [np.sort(line.flight_time[i][: line.bounces[i]]) for line in (full, early)]
        np.testing.assert_allclose(cycles[0], cycles[1], atol=1e-8)


def test_settling_really_ends_early():
    """Equal flights, one a plate period: the window begins after the first test, not after 1000 periods."""
    window = Window(1000, 10, 0.0, 1e-9, 0, 0)
    flights = Flights(np.zeros(64), np.zeros(64), np.zeros(64, dtype=np.int64), 64, 64)
    state = np.zeros(6)
    state[1] = 1.0
    progress: Progress = start_run(state, window, False)
    steps = 0
    while progress.ending == ROOT:
        hop = Phase(2 * np.pi, ROOT, True, 0.0, 0.0, 0.0, 0.0, 1)
        before, progress = progress, record(progress, hop, window, flights, 0)
        progress = end_settling(before, progress, window, flights, 0)
        steps += 1
    assert steps < 40
    assert progress.recorded == 10


def test_off_by_default():
    gamma = np.array([1.5])
    assert run(gamma, 0.0, settle=30).flights[0] == run(gamma, 0.0, settle=30).flights[0]
    window = Window(30, 10, 0.0, 0.0, 0, 0)
    flights = Flights(np.zeros(64), np.zeros(64), np.zeros(64, dtype=np.int64), 64, 64)
    progress = start_run(np.array([0.0, 1.0, 0, 0, 0, 0]), window, False)
    steps = 0
    while progress.ending == ROOT:
        progress = record(progress, Phase(2 * np.pi, ROOT, True, 0.0, 0.0, 0.0, 0.0, 1), window, flights, 0)
        steps += 1
    assert steps == 40
    assert progress.recorded == 10
