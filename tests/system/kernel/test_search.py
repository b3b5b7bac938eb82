"""Searches for the lowest end of bouncing, where no list of short cycles decides it."""

import math

import numpy as np
import pytest
from contacts import rigid

from kernel.creep import Crept, _lasting, rotation, run
from kernel.cycles.descent import cycle_of
from kernel.line import run_line
from kernel.params import Cell, Outcome, empty_line
from kernel.search import Searched, random_starts, search, starts_of

#: Omega, xi, effort, at most where bouncing ends, and what ends there; see test_hysteresis_document, too.
KNOWN = [
    (0.5155, 0.02, 10, 0.7809716836, "fold of word zsss (4,3)"),
    # stable cycles in closed form, far below rest, in ranges that are narrow
    (1.235, 0.015, 0, 0.7058406975, "fold (1,2)"),
    (0.27, 0.005, 0, 0.2359274293, "fold (1,1)"),
    (0.6217, 0.005, 0, 0.0744518918, "fold (1,1)"),
]


@pytest.mark.parametrize(("omega", "xi", "effort", "gamma", "what"), KNOWN)
def test_cycles_below_the_rule_are_found_and_followed_to_their_ends(omega, xi, effort, gamma, what):
    result = search(rigid(0.0), omega, xi, effort=effort)
    assert result.gamma == pytest.approx(gamma, abs=1e-9)
    assert result.what.endswith(what)
    assert math.isnan(result.rotation)


def test_a_torus_that_locks_to_a_long_cycle_ends_at_its_fold():
    """A motion carried down from the cycle is gone at 0.800530."""
    result = search(rigid(0.0), 0.4555, 0.05, effort=0)
    assert result.gamma == pytest.approx(0.8005315516, abs=1e-9)
    assert result.what == "fold of word ssssssssssssssssss (18,18)"
    assert np.isnan(result.gone)


def test_a_torus_is_carried_down_to_its_end():
    """A motion of its own descends there in steps of 2e-6 and less."""
    result = search(rigid(0.0), 0.35, 0.05, effort=0)
    assert result.what.startswith("a torus around (1,1), locked")
    assert result.gamma == pytest.approx(0.910801, abs=4e-6)
    assert 0.0 < result.gamma - result.gone < 1e-5
    assert result.rotation == pytest.approx(1 / 25, abs=1e-12)


def test_what_dies_out_beyond_a_cycle_is_no_torus():
    """Beside its Neimark-Sacker point copies outlive 20,000 plate periods, and none 200,000."""
    result = search(rigid(0.0), 0.592, 0.0215, effort=0)
    assert result.gamma == pytest.approx(0.4796886320, abs=1e-9)
    assert "ss (2,2) ends at a neimark-sacker" in result.what


def test_what_dies_out_is_gone_at_the_step_below_the_last_that_lasts(monkeypatch: pytest.MonkeyPatch):
    steps = [Crept(Cell(1.0 - 0.1 * i, 0.46, 0.05), empty_line(1, 1), math.nan) for i in range(8)]
    monkeypatch.setattr(
        "kernel.creep._bouncing", lambda plate, cell, *_: empty_line(1, 1) if cell.gamma > 0.65 else None
    )
    lasting = _lasting(None, steps, 0.25)
    assert (lasting.cell, lasting.gone) == (steps[3].cell, steps[4].cell.gamma)


def test_a_rotation_number_is_that_of_the_flights():
    """It is the frequency of their strongest Fourier component."""
    plate, cell = rigid(0.0), Cell(0.85, 0.46, 0.05)
    states = random_starts(np.random.default_rng(1), cell.gamma, cell.omega, 100)
    line = run(plate, np.full(100, cell.gamma), cell.omega, cell.xi, states, 3_000, 100)
    state = line.end_state[np.flatnonzero(line.outcome != Outcome.AT_REST)[0]]
    found = rotation(plate, cell, state)
    assert cycle_of(found.around).name == "(1,1)"
    assert found.error < 1e-6
    flights = run_line(
        *np.array(cell)[:, None], plate=plate, carry=False, states=state[None], settle=0, observe=4_000,
        keep=4_000,
    ).flight_time[0, :-1]  # fmt: skip
    strongest = np.argmax(np.abs(np.fft.rfft(flights - flights.mean())))
    assert strongest / len(flights) == pytest.approx(found.number, abs=3e-4)


def test_a_torus_in_flight_at_each_period_turns_in_the_plane_of_its_cycle():
    """By elongation and velocity alone it seems to turn by 0.0046."""
    plate, cell = rigid(0.3), Cell(3.432424146, 0.9068539450, 0.0378609478)
    state = np.array([[0.0, 1.0, 0.007789, 0.165388, -0.732039, 0.767103]])
    line = run(plate, np.array([cell.gamma]), cell.omega, cell.xi, state, 5_000, 200)
    found = rotation(plate, cell, line.end_state[0])
    assert found.number == pytest.approx(np.angle(found.around.multipliers[0]) / (2.0 * np.pi), abs=1e-3)
    assert found.number == pytest.approx(0.436002, abs=1e-5)


@pytest.mark.parametrize("settle", [5_000, 5_001])
def test_a_torus_around_a_cycle_of_two_periods_is_within_its_error_while_it_is_approached(settle):
    """Just above its Neimark-Sacker point, Gamma 3.617643; the number is that after a million periods."""
    plate, cell = rigid(0.0), Cell(3.6177, 1.0, 0.05)
    state = np.array([[0.0, 1.0, 0.0002, 0.0062, -0.779, 2.2852]])
    line = run(plate, np.array([cell.gamma]), cell.omega, cell.xi, state, settle, 100)
    found = rotation(plate, cell, line.end_state[0])
    assert found.number == pytest.approx(0.3665319222, abs=found.error)
    assert found.error < 1e-4


def test_nothing_is_found_where_nothing_bounces_below_rest():
    result = search(rigid(0.0), 0.5, 0.26, effort=0)
    assert math.isnan(result.gamma)


def test_more_starts_miss_smaller_basins():
    assert Searched(0.5, "", 80).missed == pytest.approx(0.037, abs=5e-4)
    assert [starts_of(effort) for effort in (0, 50, 100)] == [100, 1000, 10_000]
