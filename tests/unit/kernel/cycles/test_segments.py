"""The equations of a cycle: their derivatives against differences, their motions against the kernel's."""

import numpy as np
import pytest
from contacts import rigid, soft

from kernel.cycles.any_contact import branches
from kernel.cycles.cycles import kernels_round
from kernel.cycles.segments import go_round

STATE = [0.3, -0.9, 0.2, 0.4, 0.5]


@pytest.mark.parametrize(("plate", "letters", "times"), [
    (rigid(0.0), "SszsS", [1.3, 2.0, 1.5, 0.7, 0.4]),
    (rigid(0.3), "hhcS", [1.3, 0.6, 0.1, 2.0]),
    (soft(), "CFCF", [0.3, 0.2, 1.5, 2.5]),
    (soft(penetration=0.1, adhesive=False), "CbCF", [0.4, 0.3, 0.6, 2.5]),
    (rigid(0.3), "hhcS", [1e-3, 2e-4, 3e-5, 2.0]),
])  # fmt: skip
def test_derivatives_are_those_of_the_equations(plate, letters, times):
    code, u = np.frombuffer(letters.encode(), np.uint8), np.array([*STATE, *times])
    slope = go_round(plate, 0.6, 0.05, code, 1, u).slope
    for j in range(len(u)):
        step = np.zeros(len(u))
        step[j] = 1e-6 * min(1.0, abs(u[j]))
        sides = [go_round(plate, 0.6, 0.05, code, 1, u + way * step).value for way in (1.0, -1.0)]
        difference = (sides[0] - sides[1]) / (2.0 * step[j])
        assert difference == pytest.approx(slope[:, j], abs=1e-6 * np.abs(slope).max()), j


@pytest.mark.parametrize("plate", [rigid(0.5), soft(), soft(penetration=1e-2, adhesive=False)])
def test_a_cycle_closes_in_the_kernel(plate):
    for point in branches(plate, 0.60, 0.05, 1, span=(0.5, 1.4))[0].points[20::15]:
        letters, times, states = kernels_round(point.cycles, point.x, 2.0 * np.pi + 0.5)
        n = len(point.letters)
        assert letters[:n] == point.letters
        assert times[:n] == pytest.approx(point.times, abs=1e-9)
        assert states[n, 1:] * point.cell[0] == pytest.approx(point.x[:3], abs=1e-8)
