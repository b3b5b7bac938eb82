"""`stepped` against `soft` in random periodic cells under both laws: of second order everywhere."""

import numpy as np
from kernel_runs import Model
from order_of_steps import check, random_cells, run_cell


def test_second_order_under_both_laws():
    assert check(random_cells(1), 16, (100, 400)) < 3e-4


def test_a_pressed_flight_keeps_its_velocity():
    """Nonadhesive, a flight ends below the surface, rising, where the force would turn positive again."""
    cell = {"gamma": 2.3, "omega": 0.5, "xi": 0.26, "restitution": 0.05, "penetration": 1e-2}
    line = run_cell(cell | {"adhesive": False}, Model.STEPPED, steps_per_contact=320)
    times = line.flight_time[0, : line.flights[0]]
    assert np.abs(times - 3.71843947).min() < 1e-6
