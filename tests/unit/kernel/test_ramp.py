"""Ramps: what is carried from cell to cell, and that it does not matter how a line was cut."""

import math

import numpy as np
import pytest
from kernel_runs import EACH_MODEL, Model, assert_same_bytes, recorded, run
from tables import for_each

from kernel.params import STATE_FIELDS, Cell, Line, Start

AXES = {
    "gamma": (np.linspace(1.2, 4.0, 13), 0.5, 0.26),
    "omega": (2.5, np.linspace(0.4, 1.3, 13), 0.05),
    "xi": (2.5, 0.7, np.linspace(0.02, 1.2, 13)),
    "all at once": (np.linspace(4.0, 1.2, 13), np.linspace(0.4, 1.3, 13), np.linspace(0.0, 1.2, 13)),
}


def units(cell: Cell) -> np.ndarray:
    """Of gap, gap', q, q' in metres and metres per second, on a plate with omega_0 = 50/s."""
    angular = cell.omega * 50.0
    amplitude = cell.gamma * 9.81 / angular**2
    return np.array([amplitude, amplitude * angular, amplitude, amplitude * angular])


@for_each(("model", "contact"), EACH_MODEL[:4])
@for_each(("old", "new"), [
    (Cell(2.5, 0.7, 0.05), Cell(2.4, 0.7, 0.05)),
    (Cell(2.5, 0.7, 0.05), Cell(2.5, 0.8, 0.05)),
    (Cell(2.5, 0.7, 0.05), Cell(2.5, 0.7, 0.4)),
    (Cell(2.5, 0.7, 0.05), Cell(3.5, 1.4, 0.2)),
])  # fmt: skip
def test_positions_and_velocities_are_kept_through_a_step(model, contact, old, new):
    """A start in the old cell's units is the same as one converted through metres and seconds."""
    before = run(*old, model, settle=13, observe=1, keep=8, carry=True, **contact).end_state[0]
    after = before.copy()
    after[2:] = before[2:] * units(old) / units(new)
    window = {"settle": 0, "observe": 3, "keep": 64, "carry": True}
    mine, true = (
        run(*new, model, start=start, **window, **contact)
        for start in (Start(before, old), Start(after, new))
    )
    assert mine.flights[0] == true.flights[0] > 0
    assert recorded(mine) == pytest.approx(recorded(true), abs=1e-11)
    assert mine.end_state[0] == pytest.approx(true.end_state[0], abs=1e-11)


@pytest.mark.parametrize(("model", "contact"), EACH_MODEL[:4])
def test_windows_of_one_cell_join_to_one_run(model, contact):
    """Ten windows of two periods have the flights of one of twenty, but for those under way at the joints."""
    cell = (2.5, 0.7, 0.05)
    whole = run(*cell, model, settle=0, observe=20, keep=200, **contact)
    pieces = run(np.full(10, cell[0]), *cell[1:], model, settle=0, observe=2, keep=200, carry=True, **contact)
    assert np.any(pieces.end_state[:, STATE_FIELDS.index("in_flight")] == 1.0)
    assert pieces.end_state[-1] == pytest.approx(whole.end_state[0], abs=1e-9)
    times = recorded(whole)
    joined = np.concatenate([recorded(pieces, i) for i in range(10)])
    # each flight of the pieces is one of the whole, in the same order
    position = 0
    for flown in joined:
        while not math.isclose(times[position], flown, abs_tol=1e-9):
            position += 1
        position += 1
    assert len(times) - len(joined) <= 9


@for_each(("model", "contact"), EACH_MODEL)
@for_each("axis", AXES)
def test_a_ramp_gives_the_same_bytes_however_it_is_cut(model, contact, axis):
    gamma, omega, xi = np.broadcast_arrays(*(np.asarray(a, dtype=float) for a in AXES[axis]))
    window = {"settle": 5, "observe": 7, "keep": 16, "carry": True, "settle_until": 40}
    whole = run(gamma, omega, xi, model, **window, **contact)
    for cuts in ([1], [6], [3, 4, 11], list(range(1, 13))):
        parts, start = [], None
        for piece in np.split(np.arange(13), cuts):
            line = run(gamma[piece], omega[piece], xi[piece], model, start=start, **window, **contact)
            last = piece[-1]
            start = Start(line.end_state[-1], Cell(float(gamma[last]), float(omega[last]), float(xi[last])))
            parts.append(line)
        assert_same_bytes(Line(*(np.concatenate(field) for field in zip(*parts, strict=True))), whole)


def test_the_last_flights_are_kept_in_order():
    everything, few = (
        run(5.0, 0.5, 0.26, Model.SOFT, restitution=0.3, settle=3, observe=120, keep=keep)
        for keep in (1000, 5)
    )
    assert everything.flights[0] == few.flights[0] > 256  # more than are remembered for the mode
    assert few.flight_time[0] == pytest.approx(recorded(everything)[-5:], abs=0.0)
    assert few.takeoff_phase[0] == pytest.approx(everything.takeoff_phase[0, : few.flights[0]][-5:], abs=0.0)
