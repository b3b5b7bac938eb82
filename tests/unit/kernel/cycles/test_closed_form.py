"""The closed form of (1,k) branches: reference numbers and another solution."""

import json
import math

import dense_branches
import numpy as np
import pytest
from paths import GOLDEN
from tables import for_each

from kernel.cycles.admissibility import Reason
from kernel.cycles.closed_form import floquet, gamma_and_slope, orbit
from kernel.cycles.energy import energy
from kernel.cycles.events import branch, branch_and_events, flight_times
from kernel.cycles.spring import spring
from kernel.params import KernelInputError

REFERENCE = json.loads((GOLDEN / "branches.json").read_text())

#: Underdamped, critical and overdamped in flight, in contact, and beside; slow and fast plates.
SPRINGS = [
    (0.5, 0.26), (0.62, 0.05), (0.3, 0.02), (1.0, 0.7071067811865476), (0.8, 0.72), (0.9, 1.0),
    (0.9, 1.0 - 1e-12), (2.0, 3.0), (5.0, 10.0), (12.0, 0.1), (0.1, 1.0),
]  # fmt: skip
EXTREME = [(300.0, 0.1), (0.5, 1e3), (0.06, 1e5), (40.0, 1e6)]


@for_each("cell", REFERENCE["floquet"])
def test_reference_orbits(cell):
    line = branch(cell["omega"], cell["xi"], cell["mode"][1], np.array([cell["flight_time"]]))
    point = {name: np.asarray(value)[0] for name, value in line._asdict().items() if np.ndim(value)}
    # flight_time is given to 12 digits: what depends on it steeply differs by some 1e-10
    for name in ("gamma", "takeoff_phase", "elongation", "elongation_velocity", "impact_velocity"):
        assert point[name] == pytest.approx(cell[name], abs=2e-10), name
    f = floquet(spring(cell["omega"], cell["xi"]), cell["mode"][1], np.array([cell["flight_time"]]))
    assert [f.trace[0], f.det[0]] == pytest.approx([cell["trace"], cell["det"]], abs=5e-10)
    expected = sorted((complex(*m) for m in cell["multipliers"]), key=lambda m: (-abs(m), m.imag))
    assert np.abs(point["multiplier"] - expected).max() < 1e-9
    assert point["stable"] == cell["stable"]
    assert point["violations"] == 0


@for_each("cell", REFERENCE["floquet"])
def test_energy_and_momentum_of_a_cycle(cell):
    e = energy(cell["omega"], cell["xi"], cell["mode"][1], np.array([cell["flight_time"]]))
    for name, value in cell["energy"].items():
        assert getattr(e, name)[0] == pytest.approx(value, abs=1e-9), name


@for_each(("omega", "xi"), SPRINGS)
def test_balance_along_whole_branches(omega, xi):
    t = flight_times(omega, xi, 2)[2:-2]
    e = energy(omega, xi, 2, t)
    taken = e.dashpot + e.impact
    size = np.abs(e.plate_contact) + np.abs(e.plate_impact) + taken
    assert np.max(np.abs(e.plate_contact + e.plate_impact - taken) / size) < 1e-9
    assert np.max(np.abs(e.force + e.impulse - e.weight) / (np.abs(e.force) + e.weight)) < 1e-9


@for_each(("omega", "xi"), SPRINGS + EXTREME)
@for_each(("periods", "flight_time"), [(1, 1e-5), (1, 0.9), (2, 11.8)])
def test_the_four_conditions(omega, xi, periods, flight_time):
    """Against their solution by matrix exponentials of 50 digits."""
    x = orbit(spring(omega, xi), periods, np.array([flight_time]))
    expected = dense_branches.takeoff(omega, xi, periods, flight_time)
    gamma = float(np.hypot(*expected[2:]))
    assert np.hypot(x.c, x.s)[0] == pytest.approx(gamma, rel=1e-13)
    if flight_time > 0.1:  # shorter ones have small phases beside strong dampers
        found = [x.q0[0], x.v0[0], x.c[0], x.s[0]]
        assert found == pytest.approx(expected, rel=1e-13, abs=1e-14 * gamma)


@for_each(("omega", "xi"), SPRINGS)
def test_series_and_closed_forms_meet(omega, xi):
    """Across each time at which another formula takes over, Gamma goes on with its slope."""
    k = spring(omega, xi)
    rate = max(math.sqrt(2.0) / omega, 4.0 * xi / omega)
    for switch in (1.0, 1.0 / rate):
        t = switch * np.array([1.0 - 1e-6, 1.0 + 1e-6])
        x = orbit(k, 1, t)
        gamma = np.hypot(x.c, x.s)
        assert gamma[1] - gamma[0] == pytest.approx(
            gamma_and_slope(k, 1, t)[1].mean() * (t[1] - t[0]), abs=1e-11 * gamma[0]
        )


@for_each(
    ("omega", "xi", "periods", "argument"),
    [(0.0, 0.1, 1, "omega"), (math.nan, 0.1, 1, "omega"), (0.5, -0.1, 1, "xi"), (1.0, 0.0, 1, "xi"),
     (0.5, 0.1, 0, "periods"), (1e-6, 0.1, 1, "omega"), (0.5, 0.1, 637, "periods")],
)  # fmt: skip
def test_refuses_what_has_no_branch(omega, xi, periods, argument):
    with pytest.raises(KernelInputError) as refusal:
        branch_and_events(omega, xi, periods)
    assert refusal.value.argument == argument


def test_a_grid_of_too_many_points_is_refused_with_what_works():
    with pytest.raises(KernelInputError, match=r"^points: must be at most 20,000, got 20,001"):
        flight_times(0.5, 0.1, 1, 20_001)
    with pytest.raises(KernelInputError, match=r"^periods: must be at most 109 at omega = 0.5, got 637"):
        flight_times(0.5, 0.1, 637)
    assert len(flight_times(0.5, 0.1, 109)) < 20_000


def test_reasons():
    """Orbits of the closed form that do not exist, and which condition they break."""
    line = branch(0.67, 0.05, 1, np.array([3.6, 4.0, 6.0]))
    assert line.violations.tolist() == [0, Reason.CONTACT, Reason.GAP | Reason.CONTACT | Reason.TAKEOFF]
