"""Exponents by kernels that the unit tests do not need compiled."""

import math

import numpy as np
import pytest
from kernel_runs import TWO_PI, Model, assert_same_bytes, run

from kernel.params import Cell, Outcome, Start


@pytest.mark.parametrize("gamma", [1.1, 1.2, 1.5])
def test_a_ball_that_bounces_once_a_period(gamma):
    """From its orbit in closed form: M = K F, F being the free fall over 2 pi and K the impact."""
    e = 0.5
    hop = TWO_PI / gamma * e / (1.0 + e)
    sine = -math.pi / gamma * (1.0 - e) / (1.0 + e)
    phi = TWO_PI + math.asin(sine)
    gap2, impact = math.cos(phi) - 1.0 / gamma, -hop / e
    at_impact = np.array([[-e, 0.0], [(1.0 + e) * gap2 / impact, -e]])
    multipliers = np.linalg.eigvals(at_impact @ np.array([[1.0, TWO_PI], [0.0, 1.0]]))
    cell = Cell(gamma, 1.0, 0.0)
    line = run(
        *cell, Model.BALL, restitution=e, carry=True, settle=200, observe=3000, exponents=2,
        start=Start(np.array([phi, 1.0, 0.0, hop, 0.0, 0.0]), cell),
    )  # fmt: skip
    assert (line.outcome[0], line.bounces[0], line.periods[0]) == (Outcome.PERIODIC, 1, 1)
    assert line.lyapunov[0] == pytest.approx(sorted(np.log(np.abs(multipliers)))[::-1], abs=1e-6)
    assert line.lyapunov.shape == (1, 2)


@pytest.mark.parametrize("model", [Model.SOFT, Model.BALL, Model.RIGID])
def test_the_record_beside_exponents_is_the_same(model):
    gamma = np.linspace(1.2, 5.0, 12)
    options = {"restitution": 0.3, "penetration": 1e-2, "settle": 30, "observe": 20, "carry": True}
    # cell by cell, as with exponents: lanes differ in the last digits
    plain = run(gamma, 0.5, 0.26, model, in_lanes=False, **options)
    line = run(gamma, 0.5, 0.26, model, exponents=2, **options)
    assert line.lyapunov.shape == (12, 2)
    assert_same_bytes(plain, line._replace(lyapunov=plain.lyapunov))
