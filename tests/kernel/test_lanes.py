"""Lanes against the scalar functions they stand in for, and their arithmetic against 50 digits."""

import math

import mpmath
import numpy as np
import pytest
from kernel_runs import Model, run_line

from kernel.numerics import elementary
from kernel.params import LANES, Line, Outcome


def rigid(gamma, omega, xi, *, restitution=0.0, settle=200, observe=60, one_by_one=False) -> Line:
    """Cells from rest; `one_by_one` takes each through the scalar functions, as a ramp of one."""
    gamma, omega, xi = (np.ascontiguousarray(a) for a in np.broadcast_arrays(gamma, omega, xi))
    n = len(gamma)

    def run(part: slice) -> Line:
        return run_line(
            gamma[part], omega[part], xi[part], model=Model.RIGID,
            restitution=np.full(n, restitution)[part], penetration=np.full(n, 1e-3)[part], adhesive=True,
            carry=one_by_one, settle=settle, observe=observe, keep=40,
        )  # fmt: skip

    if not one_by_one:
        return run(slice(0, n))
    parts = [run(slice(i, i + 1)) for i in range(n)]
    return Line(*(np.concatenate(field) for field in zip(*parts, strict=True)))


@pytest.mark.parametrize("scale", [1e-6, 1.0, 10.0, 1e3, 9e4])
def test_sincos_against_50_digits(scale):
    for x in np.random.default_rng(1).uniform(-scale, scale, 400):
        sin, cos = elementary.sincos_small(float(x))
        with mpmath.workdps(50):
            exact_sin, exact_cos = mpmath.sin(mpmath.mpf(x)), mpmath.cos(mpmath.mpf(x))
            assert abs(sin - exact_sin) <= 2 * np.spacing(abs(float(exact_sin))) + 1e-21 * scale
            assert abs(cos - exact_cos) <= 2 * np.spacing(abs(float(exact_cos))) + 1e-21 * scale


def test_hyperbolic_functions_against_50_digits():
    for x in np.append(
        10 ** np.random.default_rng(4).uniform(-9, math.log10(elementary.HYPERBOLIC_LIMIT), 1000), 0.0
    ):
        sinh, cosh = elementary.circular_or_hyperbolic(float(x), -1.0)
        with mpmath.workdps(50):
            exact_sinh, exact_cosh = mpmath.sinh(mpmath.mpf(x)), mpmath.cosh(mpmath.mpf(x))
            assert abs(sinh - exact_sinh) <= 2 * np.spacing(float(exact_sinh))
            assert abs(cosh - exact_cosh) <= 2 * np.spacing(float(exact_cosh))


def test_exp_against_50_digits():
    for x in -(10 ** np.random.default_rng(2).uniform(-9, 2.8, 1000)):
        with mpmath.workdps(50):
            exact = mpmath.exp(mpmath.mpf(x))
            assert abs(elementary.exp(float(x)) - exact) <= 2 * np.spacing(float(exact))
    assert elementary.exp(0.0) == 1.0
    assert elementary.exp(-1e9) < 1e-300


@pytest.mark.parametrize(
    ("omega", "xi"),
    [
        (0.5, 0.26),
        (1.0, 0.05),
        (1.24, 0.05),
        (5.0, 0.8),
        (0.2, 1.5),
        (0.0154, 10.0),
        (0.9, 0.02),
        (0.3, 0.7071),
        # critical in contact, in flight, and next to that
        (0.5, 1.0),
        (2.0, math.sqrt(2.0)),
        (0.5, 1.0 + 1e-12),
        (2.0, 1.0 - 1e-9),
        (1.3, math.sqrt(2.0) + 1e-6),
        (0.7, 1.003),
    ],
)
@pytest.mark.parametrize("restitution", [0.0, 0.4])
def test_short_runs_agree_to_rounding(omega, xi, restitution):
    """Four plate periods leave chaos no time: every flight agrees."""
    gamma = np.linspace(0.6, 5.9, 2 * LANES + 5)
    lanes = rigid(gamma, omega, xi, restitution=restitution, settle=0, observe=4)
    alone = rigid(gamma, omega, xi, restitution=restitution, settle=0, observe=4, one_by_one=True)
    np.testing.assert_array_equal(lanes.flights, alone.flights)
    close = np.isclose(lanes.flight_time, alone.flight_time, rtol=1e-6, atol=1e-8, equal_nan=True).all(axis=1)
    close &= np.isclose(lanes.end_state, alone.end_state, rtol=1e-6, atol=1e-6).all(axis=1)
    assert (~close).sum() <= 1  # where a landing grazes, what follows differs by the root of the rounding
    np.testing.assert_allclose(lanes.flight_time, alone.flight_time, atol=1e-4)


@pytest.mark.parametrize(("omega", "xi"), [(1.24, 0.05), (5.0, 0.8), (1.0, 0.05)])
def test_periodic_cells_agree_within_1e_10(omega, xi):
    gamma = np.linspace(0.8, 3.2, 40)
    lanes, alone = rigid(gamma, omega, xi), rigid(gamma, omega, xi, one_by_one=True)
    both = (lanes.outcome == Outcome.PERIODIC) & (alone.outcome == Outcome.PERIODIC)
    both &= (lanes.bounces == alone.bounces) & (lanes.flights == alone.flights)
    assert both.sum() > 10
    for i in np.flatnonzero(both):
        cycle = lanes.bounces[i]
        got, expected = (
            np.sort(line.flight_time[i][: min(line.flights[i], 40)][-cycle:]) for line in (lanes, alone)
        )
        np.testing.assert_allclose(got, expected, atol=1e-10)


def test_a_cell_does_not_depend_on_its_neighbours():
    """Same bytes wherever in a line a cell stands and whatever runs beside it."""
    rng = np.random.default_rng(3)
    n = 3 * LANES + 1
    gamma, omega, xi = rng.uniform(0.5, 6, n), 10 ** rng.uniform(-1.5, 1.3, n), 10 ** rng.uniform(-2, 1, n)
    xi[::5] = 1.0
    together = rigid(gamma, omega, xi, settle=20, observe=20)
    order = rng.permutation(n)
    shuffled = rigid(gamma[order], omega[order], xi[order], settle=20, observe=20)
    for name, field in together._asdict().items():
        assert np.array_equal(field[order], getattr(shuffled, name), equal_nan=True), name
    for i in (0, 7, n - 1):
        single = rigid(gamma[i : i + 1], omega[i : i + 1], xi[i : i + 1], settle=20, observe=20)
        for name, field in together._asdict().items():
            assert np.array_equal(field[i : i + 1], getattr(single, name), equal_nan=True), name


def test_slow_springs_with_strong_dashpots_are_left_to_the_scalar_functions():
    """Their elongation, of the order Omega^2/Gamma, would cancel against the gap."""
    rng = np.random.default_rng(3)
    n = 60
    gamma, omega, xi = 10 ** rng.uniform(0.3, 2, n), 10 ** rng.uniform(1.6, 3, n), 10 ** rng.uniform(1, 3, n)
    lanes = rigid(gamma, omega, xi, settle=0, observe=3)
    alone = rigid(gamma, omega, xi, settle=0, observe=3, one_by_one=True)
    first = slice(0, 2)  # later ones have grown apart
    assert np.isfinite(alone.flight_time[:, first]).sum() > n
    np.testing.assert_allclose(
        lanes.flight_time[:, first], alone.flight_time[:, first], rtol=0, atol=1e-12, equal_nan=True
    )
