"""Lanes against the scalar functions they stand in for, and their arithmetic against 50 digits."""

import math

import mpmath
import numpy as np
import pytest
from kernel_runs import Model, assert_same_bytes, part, run_line
from tables import for_each

from kernel.numerics import elementary
from kernel.params import LANES, Line, Outcome

RANDOM = np.random.default_rng(1).uniform(-1.0, 1.0, 400)

#: Adhesive or not, e, d: underdamped and overdamped contacts, stiff and compliant.
CONTACTS = [
    (True, 0.01, 1e-3), (True, 0.01, 1e-6), (True, 0.5, 1e-2), (False, 0.01, 1e-3), (False, 0.3, 1e-5),
]  # fmt: skip


def computed(
    gamma, omega, xi, *, model=Model.RIGID, contact=(True, 0.0, 1e-3), settle=200, observe=60, lines=0,
    scalar=False, certify=False,
) -> Line:  # fmt: skip
    """Cells from rest, or so many lines of a ramp; `scalar`, as with exponents, by scalar functions."""
    gamma, omega, xi = (np.ascontiguousarray(a) for a in np.broadcast_arrays(gamma, omega, xi))
    adhesive, e, d = contact
    return run_line(
        gamma, omega, xi, model=model, restitution=np.full(len(gamma), e),
        penetration=np.full(len(gamma), d), adhesive=adhesive, carry=lines > 0,
        start=[None] * lines if lines else None, settle=settle, observe=observe, keep=40,
        exponents=int(scalar), certify=certify, settle_until=500 if certify else None,
    )  # fmt: skip


@for_each(
    ("function", "exact", "numbers"),
    [
        *(
            (elementary.sincos_small, (mpmath.sin, mpmath.cos), scale * RANDOM)
            for scale in (1e-6, 1.0, 1e3, 9e4)
        ),
        (lambda x: (elementary.exp(x),), (mpmath.exp,), elementary.LOWEST_EXPONENT * RANDOM**8),
    ],
)
def test_elementary_functions_of_lanes_against_50_digits(function, exact, numbers):
    scale = np.abs(numbers).max()
    for x in map(float, numbers):
        with mpmath.workdps(50):
            for mine, true in zip(function(x), (of(mpmath.mpf(x)) for of in exact), strict=True):
                assert abs(mine - true) <= 2 * np.spacing(abs(float(true))) + 1e-21 * scale, x


@for_each(
    ("omega", "xi"),
    [
        (0.5, 0.26), (1.0, 0.05), (1.24, 0.05), (5.0, 0.8), (0.2, 1.5), (0.0154, 10.0), (0.9, 0.02),
        # critical in contact, in flight, and next to that
        (0.5, 1.0), (2.0, math.sqrt(2.0)), (0.5, 1.0 + 1e-12), (2.0, 1.0 - 1e-9), (0.7, 1.003),
    ],
)  # fmt: skip
@for_each("restitution", [0.0, 0.4])
def test_short_runs_agree_to_rounding(omega, xi, restitution):
    """Four plate periods leave chaos no time: every flight agrees."""
    gamma = np.linspace(0.6, 5.9, 2 * LANES + 5)
    lanes = computed(gamma, omega, xi, contact=(True, restitution, 1e-3), settle=0, observe=4)
    alone = computed(gamma, omega, xi, contact=(True, restitution, 1e-3), settle=0, observe=4, scalar=True)
    np.testing.assert_array_equal(lanes.flights, alone.flights)
    close = np.isclose(lanes.flight_time, alone.flight_time, rtol=1e-6, atol=1e-8, equal_nan=True).all(axis=1)
    close &= np.isclose(lanes.end_state, alone.end_state, rtol=1e-6, atol=1e-6).all(axis=1)
    assert (~close).sum() <= 1  # where a landing grazes, what follows differs by the root of the rounding
    np.testing.assert_allclose(lanes.flight_time, alone.flight_time, atol=1e-4)


@pytest.mark.parametrize(("omega", "xi"), [(1.24, 0.05), (5.0, 0.8), (1.0, 0.05)])
def test_periodic_cells_agree_within_1e_10(omega, xi):
    gamma = np.linspace(0.8, 3.2, 40)
    lanes, alone = computed(gamma, omega, xi), computed(gamma, omega, xi, scalar=True)
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
    together = computed(gamma, omega, xi, settle=20, observe=20)
    order = rng.permutation(n)
    shuffled = computed(gamma[order], omega[order], xi[order], settle=20, observe=20)
    assert_same_bytes(part(together, order), shuffled)
    for i in (0, 7, n - 1):
        single = computed(gamma[i : i + 1], omega[i : i + 1], xi[i : i + 1], settle=20, observe=20)
        assert_same_bytes(part(together, slice(i, i + 1)), single)


def ramps(lines: int, length: int = 7) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lines of a ramp of gamma, each with its own range, omega and xi."""
    rng = np.random.default_rng(lines)
    first, last = rng.uniform(0.4, 2, (lines, 1)), rng.uniform(2, 6, (lines, 1))
    gamma = first + (last - first) * np.linspace(0, 1, length)
    return (
        gamma.ravel(),
        np.repeat(rng.uniform(0.2, 2, lines), length),
        np.repeat(10 ** rng.uniform(-2, 0.3, lines), length),
    )


#: Of lines, around what the kernel runs side by side.
NUMBERS = (1, 2, LANES // 2 + 1, 2 * LANES + 1)


@for_each(
    ("plate", "lines"),
    [({"contact": (True, e, 1e-3)}, n) for e in (0.0, 0.3) for n in NUMBERS]
    + [({"model": Model.SOFT, "contact": contact}, LANES // 2 + 1) for contact in CONTACTS[2:4]]
    + [({"certify": True, "settle": 200}, n) for n in NUMBERS[1:]],
)
def test_a_line_does_not_depend_on_the_others(plate, lines):
    """Same bytes however many lines of a ramp run beside it, in whatever order."""
    length = 7
    cells = ramps(lines, length)
    if "certify" in plate:  # down, so that the last cells settle
        cells = cells[0].reshape(lines, length)[:, ::-1].ravel(), *cells[1:]
    plate = {"settle": 10, "observe": 20} | plate
    together = computed(*cells, **plate, lines=lines)
    assert len(set(together.outcome)) > 1
    for i in reversed(range(lines)):
        one = slice(i * length, (i + 1) * length)
        alone = computed(*(axis[one] for axis in cells), **plate, lines=1)
        assert_same_bytes(part(together, one), alone)


@pytest.mark.parametrize("restitution", [0.0, 0.3])
def test_short_ramps_agree_to_rounding(restitution):
    """Two cells of two plate periods, the second of which begins in the air or in contact."""
    lines = 300
    cells = ramps(lines, 2)
    lanes = computed(*cells, contact=(True, restitution, 1e-3), lines=lines, settle=0, observe=2)
    alone = computed(*cells, contact=(True, restitution, 1e-3), lines=lines, settle=0, observe=2, scalar=True)
    second = lanes.end_state[:-1:2, 1] == 1.0
    assert 0.1 * lines < second.sum() < 0.9 * lines
    close = np.isclose(lanes.flight_time, alone.flight_time, rtol=1e-9, atol=1e-10, equal_nan=True).all(
        axis=1
    )
    close &= np.isclose(lanes.end_state, alone.end_state, rtol=1e-8, atol=1e-8).all(axis=1)
    assert (~close).sum() <= 2  # where a landing grazes
    assert (lanes.flights == alone.flights).mean() > 0.99


@for_each("contact", CONTACTS)
def test_soft_short_runs_agree_to_rounding(contact):
    """Three plate periods leave chaos little time: nearly every flight agrees, the first ones all."""
    rng = np.random.default_rng(5)
    n = 400
    cells = rng.uniform(0.5, 6, n), 10 ** rng.uniform(-1, 1, n), 10 ** rng.uniform(-2.5, 1, n)
    how = {"model": Model.SOFT, "contact": contact, "settle": 0, "observe": 3}
    lanes, alone = (computed(*cells, **how, scalar=scalar) for scalar in (False, True))
    assert np.isfinite(alone.flight_time[:, 0]).sum() > n // 2
    np.testing.assert_allclose(lanes.flight_time[:, 0], alone.flight_time[:, 0], rtol=0, atol=2e-9)
    np.testing.assert_allclose(lanes.takeoff_phase[:, 0], alone.takeoff_phase[:, 0], rtol=0, atol=2e-9)
    assert (lanes.flights == alone.flights).mean() >= 0.99
    assert (np.abs(lanes.end_state - alone.end_state).max(axis=1) < 1e-6).mean() >= 0.98
