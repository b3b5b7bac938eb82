"""A second opinion on folds: single shooting with the simulating kernel, which knows nothing of segments.

The map of the state over one plate period from phase 0 is simulated. Its fixed points with a given elongation
there are found by Newton's method with differences, and Gamma has its extremum at the fold.
"""

import numpy as np
import pytest
from contacts import rigid, soft

from kernel.cycles.any_contact import branches
from kernel.cycles.cycles import kernels_round
from kernel.cycles.events import Kind
from kernel.line import run_line
from kernel.params import Cell, Start

#: Of the differences, and of the gap on either side of a fold.
STEP, ASIDE = 1e-6, 3e-4


def one_period(plate, gamma, start):
    """The state (6,) a plate period after `start` (phase, gap, gap', q, q')."""
    phase, *state = start
    cell = Cell(gamma, 0.60, 0.05)
    begin = Start(np.array([phase, float(state[0] > 0.0), *state]), cell)
    window = {"settle": 0, "observe": 1, "keep": 1, "carry": True, "start": begin}
    return run_line(*np.array(cell)[:, None], plate=plate, **window).end_state[0]


def in_flight_at_phase_zero(point):
    """The state (4,) of a cycle when the plate's phase is next 0."""
    _, times, states = kernels_round(point.cycles, point.x, 2.0 * np.pi - point.phase)
    end = one_period(point.cycles.plate, point.parameter, [point.phase + times.sum(), *states[-1]])
    assert end[:2].tolist() == [0.0, 1.0]
    return end[2:]


def gamma_of(plate, gap, gamma, state):
    """Gamma of the fixed point with this gap at phase 0, near another state (4,)."""
    z = np.array([gamma, *state[1:]])

    def residual(z):
        return one_period(plate, z[0], [0.0, gap, *z[1:]])[2:] - [gap, *z[1:]]

    for _ in range(5):
        steps = STEP * np.eye(4)
        slope = np.array([residual(z + step) - residual(z - step) for step in steps]).T / (2.0 * STEP)
        z = z - np.linalg.solve(slope, residual(z))
    return z[0]


@pytest.mark.parametrize("plate", [soft(), soft(0.1, 1e-2, adhesive=False), rigid(0.3)])
def test_folds_are_where_gamma_turns_for_the_simulated_map(plate):
    events = branches(plate, 0.60, 0.05, 1, span=(0.5, 1.0))[0].events
    folds = [event.point for event in events if event.kind is Kind.FOLD]
    assert len(folds) == 2
    for point in folds:
        state = in_flight_at_phase_zero(point)
        low, middle, high = (
            gamma_of(plate, state[0] + away, point.parameter, state) for away in (-ASIDE, 0.0, ASIDE)
        )
        curvature = low + high - 2.0 * middle
        assert abs(curvature) > 1e-8
        assert middle - (high - low) ** 2 / (8.0 * curvature) == pytest.approx(point.parameter, abs=1e-9)
