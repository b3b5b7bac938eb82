"""`stepped` against `soft` in random periodic cells under both laws: Verlet is of second order everywhere.

The cells: Gamma 0.5 to 6, Omega 0.3 to 2, xi 0.02 to 1, e 0.01 to 0.5 and d 0.003 to 0.05 (log-uniform),
adhesive and nonadhesive in turn, those whose cycle the exact contact finds and holds to DRIFT. Errors are the
largest of a cycle's flights over LONG, relative to the flight. The bound in rad holds for every flight.
"""

import numpy as np
import pytest
from kernel_runs import Model, run

from kernel.params import Outcome

#: rad: some contact times. A shorter flight has the same error, which is large relative to it: 2.8e-5 of a
#: flight of 0.053 rad at 1600 steps.
LONG = 0.1

#: A flight's error in rad is at most this times (pi/steps per contact)**2 (docs/model.md, section 2): the
#: contact before it is integrated with that error, however short the flight.
BOUND = 0.5

#: rad by which two cycles of the exact contact may differ: errors of steps are measured against the last.
DRIFT = 1e-10


def random_cells(seed):
    """Endless dictionaries of arguments of `run`."""
    rng = np.random.default_rng(seed)
    while True:
        for adhesive in (True, False):
            yield {
                "gamma": rng.uniform(0.5, 6.0), "omega": rng.uniform(0.3, 2.0), "xi": rng.uniform(0.02, 1.0),
                "restitution": 10 ** rng.uniform(-2.0, -0.3), "penetration": 10 ** rng.uniform(-2.5, -1.3),
                "adhesive": adhesive,
            }  # fmt: skip


def cycle(line):
    """The flight times of the last cycle and of the one before, sorted."""
    times = line.flight_time[0, : line.flights[0]]
    bounces = int(line.bounces[0])
    return np.sort(times[-bounces:]), np.sort(times[-2 * bounces : -bounces])


def run_cell(cell, which, **more):
    return run(which=which, **cell, settle=200, observe=40, micro_flight=0.0, **more)


def errors(cell, steps):
    """The largest relative error for each number of steps per contact; None for a cell that is not used."""
    exact = run_cell(cell, Model.SOFT)
    if exact.outcome[0] != Outcome.PERIODIC or 2 * exact.bounces[0] > min(64, exact.flights[0]):
        return None
    times, before = cycle(exact)
    long = times > LONG
    if not long.any() or np.abs(times - before).max() > DRIFT:
        return None
    largest = []
    for number in steps:
        line = run_cell(cell, Model.STEPPED, steps_per_contact=number)
        assert line.bounces[0] == exact.bounces[0], cell
        error = np.abs(cycle(line)[0] - times)
        assert error.max() < BOUND * (np.pi / number) ** 2, cell
        largest.append((error / times)[long].max())
    return largest


def check(cells, count, steps):
    """Check `count` of the cells; returns the largest error at the most steps."""
    measured = []
    while len(measured) < count:
        cell = next(cells)
        each = errors(cell, steps)
        if each is not None:
            # sixteen times less for four times the steps, unless two parts of the error happen to cancel
            assert each[-1] < max(each[-2] / 8.0, 10.0 * DRIFT), (cell, each)
            measured.append(each)
    slope = np.log(np.array(measured)[:, 0] / np.array(measured)[:, -1]) / np.log(steps[-1] / steps[0])
    assert np.median(slope) == pytest.approx(2.0, abs=0.02)
    return max(each[-1] for each in measured)


STEPS = (100, 400, 1600)


def test_second_order_in_120_cells_to_1e_5_at_1600_steps_per_contact():
    assert check(random_cells(2), 120, STEPS) < 1e-5
