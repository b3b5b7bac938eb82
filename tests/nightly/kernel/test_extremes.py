"""Every phase of every cell at the edges of parameter space obeys the equations."""

from itertools import product

import pytest
from extremes import CELLS, CONTACTS, check_phase, settings_of
from kernel_runs import phases


@pytest.mark.parametrize(("cell", "contact"), list(product(CELLS, CONTACTS)))
def test_extreme_phases_obey_the_equations_of_motion(cell, contact):
    s = settings_of(cell, contact)
    for step in phases(s, 3, 3):
        check_phase(s, step)
