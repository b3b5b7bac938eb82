"""`stepped` against `soft` in many random periodic cells under both laws: of second order everywhere."""

from order_of_steps import check, random_cells

STEPS = (100, 400, 1600)


def test_second_order_in_120_cells_to_1e_5_at_1600_steps_per_contact():
    assert check(random_cells(2), 120, STEPS) < 1e-5
