"""Lyapunov exponents against multipliers of closed-form orbits, volumes in closed form, and a known chaos."""

import json
import math

import numpy as np
import pytest
from kernel_runs import TWO_PI, Model, recorded, run
from paths import GOLDEN
from tables import for_each

from kernel import interface
from kernel.cycles.starts import cycles_at, start_on_cycle
from kernel.labels import CHAOTIC, LABELS, QUASI_PERIODIC, label_codes
from kernel.models import rigid
from kernel.models.contact_law import contact_constants
from kernel.numerics.oscillator import motion
from kernel.params import Cell, KernelInputError, Outcome, Start
from kernel.restitution import scalar_damping_ratio

REFERENCE = json.loads((GOLDEN / "multipliers.json").read_text())
ORBITS = REFERENCE["rigid"]
CHAOS = REFERENCE["chaos"]


@for_each("orbit", [o for o in ORBITS if o["stable"]])
def test_in_a_cycle_they_are_the_logarithms_of_its_multipliers(orbit):
    """On the closed-form orbit over 3,000 periods. Those of a complex pair differ by 1e-3 within a cycle."""
    cell = Cell(orbit["gamma"], orbit["omega"], orbit["xi"])
    takeoff = np.array(
        [orbit["takeoff_phase"], 1.0, 0.0, 0.0, orbit["elongation"], orbit["elongation_velocity"]]
    )
    line = run(
        *cell, restitution=0.0, carry=True, start=Start(takeoff, cell), settle=200, observe=3000, exponents=2
    )
    assert (line.outcome[0], line.bounces[0], line.periods[0]) == (Outcome.PERIODIC, *orbit["mode"])
    assert line.lyapunov[0] == pytest.approx(orbit["lyapunov"], abs=1e-6)


@for_each("orbit", ORBITS)
def test_the_map_over_a_cycle_is_that_of_the_closed_form(orbit):
    """M_stuck(2 pi k - T) B(T) of docs/model.md, section 7: stable orbits and the unstable one."""
    cell = interface.prepare(
        rigid.plate(restitution=np.zeros(1)), 0, orbit["gamma"], orbit["omega"], orbit["xi"]
    )
    phi, q, q1 = orbit["takeoff_phase"], orbit["elongation"], orbit["elongation_velocity"]
    vectors = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    start = interface.plate_phase(phi), interface.State(0.0, 0.0, q, q1)
    p = interface.flight(cell, *start, math.inf, 10_000)
    interface.carry_in_flight(cell, vectors, p.tau)
    interface.carry_through_landing(cell, vectors, *start, p)
    landed = vectors[:, 2:].T.copy()
    interface.carry_in_contact(cell, vectors, orbit["mode"][1] * TWO_PI - p.tau)

    b, t = cell.dashpot, p.tau
    c, c1 = motion(cell.flight, 1.0, 0.0, t)
    s, s1 = motion(cell.flight, 0.0, 1.0, t)
    closed = 0.5 * np.array([[1.0 + c, t + s], [c1 + b * (c - 1.0), 1.0 + s1 - b * (t - s)]])
    assert landed == pytest.approx(closed, abs=1e-12)
    cycle = vectors[:, 2:].T
    assert np.trace(cycle) == pytest.approx(orbit["trace"], abs=1e-8)
    assert np.linalg.det(cycle) == pytest.approx(orbit["det"], abs=1e-8)
    assert np.all(vectors[:, :2] == 0.0)


@pytest.mark.parametrize("cell", REFERENCE["soft"])
def test_soft_cycles_have_the_multipliers_of_an_independent_program(cell):
    line = run(
        cell["gamma"], cell["omega"], cell["xi"], Model.SOFT, restitution=cell["restitution"],
        penetration=cell["penetration"], adhesive=cell["adhesive"], settle=200, observe=3000, exponents=2,
    )  # fmt: skip
    expected = [math.log(math.hypot(*m)) / cell["periods"] for m in cell["multipliers"]]
    assert line.outcome[0] == Outcome.PERIODIC
    assert line.lyapunov[0] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("settle", [10, 2000])  # variations begin with the cell, or later, within the contact
def test_at_rest_they_are_those_of_the_stuck_spring(settle: int):
    """Underdamped, both exponents are -2 pi xi/Omega; overdamped, 2 pi times the two roots."""
    gamma, omega, xi = 0.1, np.array([0.5, 0.5]), np.array([0.26, 1.1])
    line = run(gamma, omega, xi, settle=settle, observe=1000, exponents=3)
    assert np.all(line.outcome == Outcome.AT_REST)
    assert line.lyapunov[0] == pytest.approx([-TWO_PI * 0.52, -TWO_PI * 0.52, -math.inf], abs=1e-6)
    root = math.sqrt(1.1**2 - 1.0)
    assert line.lyapunov[1, :2] == pytest.approx([TWO_PI * (-1.1 + root) / 0.5, TWO_PI * (-1.1 - root) / 0.5])


def test_the_chaos_of_fig_2():
    """As the reference, the mean of 16 runs of 30,000 periods; single ones have a deviation of 0.0035."""
    starts = np.full(16, CHAOS["gamma"])
    line = run(
        starts, CHAOS["omega"], CHAOS["xi"], restitution=0.0, carry=True, settle=200, observe=30_000,
        exponents=1,
    )  # fmt: skip
    assert np.all(line.outcome == Outcome.APERIODIC)
    assert np.mean(line.lyapunov) == pytest.approx(CHAOS["lyapunov"], abs=CHAOS["deviation"])
    assert np.std(line.lyapunov) < 2.0 * CHAOS["deviation"]


@pytest.mark.parametrize(
    ("gamma", "omega", "xi"),
    [(5.0, 0.5, 0.26), (4.2, 1.0, 0.05), (3.5, 0.6, 0.05), (11.3271, 1.0489, 0.0214)],
)
def test_the_error_of_the_largest_is_the_scatter_of_independent_windows(gamma, omega, xi):
    """100 windows of 100 plate periods, 250 apart, within 2; least where a motion switches slowly."""
    windows = run(
        np.full(100, gamma), omega, xi, restitution=0.0, carry=True, settle=250, observe=100, exponents=1
    )
    assert np.all(windows.outcome == Outcome.APERIODIC)
    scatter = np.std(windows.lyapunov[:, 0], ddof=1)
    error = np.sqrt(np.mean(windows.lyapunov_error**2))
    assert 0.5 < error / scatter < 2.0


def test_a_torus_is_told_from_chaos():
    """Omega = 1, xi = 0.05 (Fig. 7b): a torus from the Neimark-Sacker point of (1,2), chaos from near 4.1."""
    torus, chaos = np.arange(3.64, 4.05, 0.02), np.arange(4.12, 4.21, 0.02)
    for settle, observe in ((200, 100), (2000, 1000)):
        line = run(np.concatenate([torus, chaos]), 1.0, 0.05, settle=settle, observe=observe, exponents=2)
        codes = label_codes(line.outcome, line.lyapunov, line.lyapunov_error, observe)
        # the flights of a few drift over the window, as those of a cell that still settles; a short one does
        # not tell slow tori
        untold = np.isin(codes, (Outcome.SETTLING, Outcome.APERIODIC))
        assert np.count_nonzero(untold) <= (8 if observe == 100 else 4)
        expected = np.where(np.arange(len(codes)) < len(torus), QUASI_PERIODIC, CHAOTIC)
        assert np.all(untold | (codes == expected))
        # the second exponent tells a torus from two frequencies more
        assert np.all(line.lyapunov[: len(torus), 1] < 0.0)


def test_a_slow_torus_is_not_chaotic_but_aperiodic_until_a_window_shows_it():
    """Its exponent over 100 plate periods is 0.02, above the resolution and within twice its error."""
    for settle, observe, label in ((900, 100, "aperiodic"), (2000, 1000, "quasi-periodic")):
        line = run(
            3.908981843029922, 0.9918374009355095, 0.05, settle=settle, observe=observe, exponents=1,
            settle_until=5000,
        )  # fmt: skip
        codes = label_codes(line.outcome, line.lyapunov, line.lyapunov_error, observe)
        assert [LABELS[code] for code in codes] == [label]


@pytest.mark.parametrize("adhesive", [True, False])
def test_their_sum_is_the_mean_rate_of_volume_of_soft(adhesive):
    """The divergence is -2b in flight and -(2b + beta) in contact, and events keep the volume."""
    xi, e, d = 0.1, 0.5, 0.2
    line = run(
        2.0, 1.0, xi, Model.SOFT, restitution=e, penetration=d, adhesive=adhesive, settle=300, observe=1200,
        keep=100, exponents=4,
    )  # fmt: skip
    assert line.outcome[0] == Outcome.PERIODIC
    bounces, time = int(line.bounces[0]), TWO_PI * int(line.periods[0])
    in_flight = recorded(line)[-bounces:].sum()
    _, beta = contact_constants(d, scalar_damping_ratio(e, adhesive))
    volume = -4.0 * xi * time - beta * (time - in_flight)
    assert line.lyapunov[0].sum() * time / TWO_PI == pytest.approx(volume, abs=1e-6)


@for_each(
    ("model", "restitution", "most"), [(Model.RIGID, 0.0, 3), (Model.RIGID, 0.5, 4), (Model.STEPPED, 0.5, 0)]
)
def test_no_more_than_the_state_has_dimensions(model, restitution, most):
    if most:
        line = run(2.0, 1.0, 0.1, model, restitution=restitution, settle=5, observe=5, exponents=most)
        assert line.lyapunov.shape == (1, most)
    with pytest.raises(KernelInputError, match=f"exponents: must be .* {most}"):
        run(2.0, 1.0, 0.1, model, restitution=restitution, settle=5, observe=5, exponents=most + 1)


def test_rounding_holds_a_start_on_an_unstable_cycle_and_the_label_says_so():
    """The same numbers return, bit for bit, while a difference would grow by the multiplier."""
    cell = Cell(2.721, 0.818, 0.171)
    cycles = cycles_at(cell, 1)
    [unstable] = np.flatnonzero(~cycles.stable & (cycles.violations == 0))
    start, cycle = start_on_cycle(cell, 1, cycles.flight_time[unstable])
    line = run(*cell, restitution=0.0, carry=True, start=start, settle=10_000, observe=100, exponents=1)
    assert (line.outcome[0], line.bounces[0], line.periods[0]) == (Outcome.PERIODIC, 1, 1)
    assert len(np.unique(recorded(line))) < 16
    growth = np.max(np.abs(cycle.multiplier))
    assert growth > 1.5
    assert line.lyapunov[0, 0] == pytest.approx(np.log(growth), abs=1e-6)
    assert label_codes(line.outcome, line.lyapunov, line.lyapunov_error, 100) == [LABELS.index("unstable")]


def test_chaos_that_ends_within_the_window_makes_no_cycle_unstable():
    """Its growth is in the mean, and so in the error; the cycle's own multiplier is 0.25."""
    cell = (3.1604210042970933, 0.6558982444478886, 0.03461752048647314)
    line = run(*cell, restitution=0.0, settle=200, observe=1000, exponents=1)
    assert (line.outcome[0], line.bounces[0], line.periods[0]) == (Outcome.PERIODIC, 5, 7)
    assert line.lyapunov[0, 0] > 0.3
    assert label_codes(line.outcome, line.lyapunov, line.lyapunov_error, 1000) == [Outcome.PERIODIC]


def test_labels_refine_aperiodic_and_unstable_cells_only():
    outcome = np.array([*Outcome, *[Outcome.APERIODIC] * 9])
    largest = np.array([0.3] * len(Outcome) + [0.009, -0.009, 0.011, -0.011, math.nan, 0.0, 0.3, 0.3, -0.002])
    error = np.array([0.004] * (len(largest) - 4) + [0.006, 0.16, math.nan, 0.0005])
    lyapunov = np.stack([largest, largest - 1.0], axis=-1)
    told = {Outcome.APERIODIC: "chaotic", Outcome.PERIODIC: "unstable"}
    expected = [told.get(o, o.name.lower()) for o in Outcome]
    expected += ["quasi-periodic", "quasi-periodic", "chaotic", *["aperiodic"] * 6]
    assert [LABELS[code] for code in label_codes(outcome, lyapunov, error, 100)] == expected
    assert LABELS[: len(Outcome)] == tuple(o.name.lower() for o in Outcome)
    shape = (2, 3)
    grid = label_codes(
        np.full(shape, Outcome.APERIODIC, np.uint8), np.zeros((*shape, 1)), np.zeros(shape), 100
    )
    assert grid.shape == shape
    assert np.all(grid == QUASI_PERIODIC)
