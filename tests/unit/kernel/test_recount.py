"""Modes of stored flights with another shortest flight: the same as if the kernel had classified with it.

Aperiodic is told from settling by flights beyond the window, which are not stored: there a few may differ.
"""

from typing import Any

import numpy as np
import pytest

from kernel.line import run_line
from kernel.models import rigid, soft
from kernel.modes import Modes, recount
from kernel.params import Line, Outcome

GAMMA = np.linspace(1.05, 6.0, 100)
OMEGA, XI = np.full(100, 0.5), np.full(100, 0.26)
PLATES = {
    "soft": soft.plate(restitution=np.full(100, 0.01), penetration=np.full(100, 1e-3), adhesive=True),
    "rigid, e = 0.3": rigid.plate(restitution=np.full(100, 0.3)),
}


def run(plate: Any, micro_flight: float, keep: int = 512) -> Line:
    """From rest, by default with room for all flights that the kernel itself looks at."""
    window = {"settle": 200, "observe": 60, "keep": keep, "micro_flight": micro_flight}
    return run_line(GAMMA, OMEGA, XI, plate=plate, carry=False, **window)


@pytest.mark.parametrize("plate", PLATES.values(), ids=PLATES)
@pytest.mark.parametrize(("before", "shortest"), [(0.0, 0.05), (0.05, 0.0), (0.0, 1.0), (1.0, 0.0)])
def test_the_modes_are_those_the_kernel_finds(plate: Any, before: float, shortest: float):
    stored, expected = run(plate, before), run(plate, shortest)
    modes = Modes(stored.outcome, stored.bounces, stored.periods)
    found = recount(stored.flight_time, stored.takeoff_phase, stored.flights, modes, before, shortest)
    differing = found.outcome != expected.outcome
    assert np.count_nonzero(differing) <= 4
    for line in (found, expected):
        assert set(line.outcome[differing]) <= {Outcome.APERIODIC, Outcome.SETTLING}
    np.testing.assert_array_equal(found.bounces, expected.bounces)
    np.testing.assert_array_equal(found.periods, expected.periods)
    assert np.count_nonzero(found.bounces != stored.bounces) > 10  # the test is of something


@pytest.mark.parametrize("shortest", [0.0, 0.3])
def test_a_periodic_cell_stays_so_or_has_too_few_flights(shortest: float):
    """One cycle in the stored flights is enough."""
    plate = PLATES["rigid, e = 0.3"]
    stored, expected = run(plate, 0.05, keep=16), run(plate, shortest)
    modes = Modes(stored.outcome, stored.bounces, stored.periods)
    found = recount(stored.flight_time, stored.takeoff_phase, stored.flights, modes, 0.05, shortest)
    periodic = stored.outcome == Outcome.PERIODIC
    assert set(found.outcome[periodic]) == {Outcome.PERIODIC, Outcome.UNRESOLVED}
    still = periodic & (found.outcome == Outcome.PERIODIC)
    np.testing.assert_array_equal(found.bounces[still], expected.bounces[still])
    np.testing.assert_array_equal(found.periods[still], expected.periods[still])
    assert np.count_nonzero(still) > np.count_nonzero(periodic) / 2


@pytest.mark.parametrize("plate", PLATES.values(), ids=PLATES)
@pytest.mark.parametrize("shortest", [0.0, 1.0, 6.0])
def test_less_than_a_cycle_decides_nothing(plate: Any, shortest: float):
    stored, expected = run(plate, 0.05, keep=2), run(plate, shortest)
    modes = Modes(stored.outcome, stored.bounces, stored.periods)
    found = recount(stored.flight_time, stored.takeoff_phase, stored.flights, modes, 0.05, shortest)
    periodic = found.outcome == Outcome.PERIODIC
    np.testing.assert_array_equal(found.bounces[periodic], expected.bounces[periodic])
    np.testing.assert_array_equal(found.periods[periodic], expected.periods[periodic])
