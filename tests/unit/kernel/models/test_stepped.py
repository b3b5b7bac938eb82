"""Fixed time steps against the exact soft plate and against eigenvalues; soft contacts as d, e -> 0."""

import math

import numpy as np
import pytest
from kernel_runs import Model, run

from kernel import restitution
from kernel.interface import State
from kernel.models import stepped
from kernel.params import Line, Outcome
from kernel.step_limits import largest_stable_step, stable_steps_per_contact

SCHEMES = ["verlet", "euler"]
ORDER = {"verlet": 2.0, "euler": 1.0}


def last_flights(line: Line, count: int, at_least: float = 0.0) -> np.ndarray:
    """The last `count` flights that are long enough, sorted: the same cycle wherever the window cuts it."""
    times = line.flight_time[0, : line.flights[0]]
    return np.sort(times[times > at_least][-count:])


@pytest.mark.parametrize("adhesive", [True, False])
@pytest.mark.parametrize("name", SCHEMES)
@pytest.mark.parametrize(
    ("gamma", "omega", "xi", "e"), [(1.5, 0.5, 0.26, 0.1), (0.5, 1.0, 0.05, 0.1), (2.5, 2.0, 0.3, 0.3)]
)
def test_converges_to_exact_soft_at_its_order(gamma, omega, xi, e, name, adhesive):
    contact = {"restitution": e, "penetration": 0.02, "adhesive": adhesive, "settle": 150, "observe": 30}
    exact = run(gamma, omega, xi, Model.SOFT, **contact)
    bounces = int(exact.bounces[0])
    assert exact.outcome[0] == Outcome.PERIODIC
    numbers, errors = [80, 160, 320], []
    for number in numbers:
        line = run(gamma, omega, xi, Model.STEPPED, **contact, steps_per_contact=number, scheme=name)
        assert line.bounces[0] == bounces
        errors.append(np.abs(last_flights(line, bounces) - last_flights(exact, bounces)).max())
    slope, _ = np.polyfit(np.log(numbers), np.log(errors), 1)
    assert slope == pytest.approx(-ORDER[name], abs=0.15)


def random_contacts(count: int) -> list[dict]:
    random = np.random.default_rng(11)
    return [
        {
            "omega": 10.0 ** random.uniform(-3, 1),
            "xi": 10.0 ** random.uniform(-2, 1.5),
            "restitution": 10.0 ** random.uniform(-6, 0),
            "penetration": 10.0 ** random.uniform(-5, -1),
            "adhesive": bool(random.integers(2)),
        }
        for _ in range(count)
    ]


def step_law(h: float, m: float, contact: dict, pressed: bool) -> stepped.Law:
    omega, d = contact["omega"], contact["penetration"]
    zeta = float(restitution.damping_ratio(contact["restitution"], contact["adhesive"]))
    kappa, beta = (1.0 / d**2, 2.0 * zeta / d) if pressed else (0.0, 0.0)
    grid = stepped.Grid(1, h, math.cos(h), math.sin(h), m)
    return stepped.law(grid, 2.0 * contact["xi"] / omega, 1.0 / omega**2, kappa, beta, 0.0, not pressed)


def propagation(h: float, m: float, contact: dict, pressed: bool) -> np.ndarray:
    """One step as a matrix on (gap, h gap', q, h q')."""
    law = step_law(h, m, contact, pressed)
    columns = []
    for gap, gap1, q, q1 in np.diag([1.0, 1.0 / h, 1.0, 1.0 / h]):
        end = stepped.step(law, m, 0.0, 0.0, State(gap, gap1, q, q1), h)
        columns.append((end.gap, h * end.gap1, end.q, h * end.q1))
    return np.array(columns).T


@pytest.mark.parametrize("kind", SCHEMES)
def test_limit_of_stability_is_where_an_eigenvalue_leaves_the_circle(kind: str):
    m = 0.5 if kind == "verlet" else 0.0
    for contact in random_contacts(150):
        limit = float(largest_stable_step(**contact, scheme=kind))
        for part in (0.03, 0.5, 0.97, 0.9999):
            for pressed in (True, False):
                matrix = propagation(part * limit, m, contact, pressed)
                assert np.abs(np.linalg.eigvals(matrix)).max() < 1.0 + 1e-7
        grown = np.linalg.eigvals(propagation(1.001 * limit, m, contact, True))
        assert grown[np.abs(grown).argmax()].real < -1.0


@pytest.mark.parametrize("adhesive", [True, False])
def test_contact_time_is_that_of_an_isolated_impact(adhesive: bool):
    """Let a light, free mass fall on the plate: march until it leaves."""
    for e in (0.9, 0.3, 0.02):
        zeta = float(restitution.damping_ratio(e, adhesive))
        grid = stepped.Grid(100_000, 1e-4, math.cos(1e-4), math.sin(1e-4), 0.5)
        law = stepped.law(grid, 0.0, 1e-9, 1.0, 2.0 * zeta, 0.0 if adhesive else 2.0 * zeta, False)
        first = stepped.step(law, 0.5, 0.0, 0.0, State(0.0, -1.0, 0.0, 0.0), 1e-4)
        start = stepped.begin_march(grid, law, 0.0, first)
        row = stepped.march(grid._replace(cos=1.0, sin=0.0), law, 0.0, 0.0, 0.0, start, 200_000)
        assert row.over
        assert (row.taken + 1) * 1e-4 == pytest.approx(
            float(restitution.contact_time(e, 1.0, adhesive)), abs=3e-4
        )
        assert row.now.gap1 == pytest.approx(e, abs=3e-4)


@pytest.mark.parametrize(
    ("name", "omega", "xi", "d"), [("euler", 10.0 / 650.0, 10.0, 1e-2), ("verlet", 2e-3, 0.1, 5e-2)]
)
def test_a_run_needs_the_fewest_stable_steps(name: str, omega: float, xi: float, d: float):
    fewest = int(stable_steps_per_contact(omega, xi, 0.1, d, scheme=name))
    contact = {"restitution": 0.1, "penetration": d, "settle": 60, "observe": 30}
    exact = last_flights(run(1.5, omega, xi, Model.SOFT, **contact), 1, 1.0)

    def outcome(number: int) -> tuple[int, np.ndarray]:
        line = run(1.5, omega, xi, Model.STEPPED, **contact, scheme=name, steps_per_contact=number)
        return int(line.outcome[0]), last_flights(line, 1, 1.0)

    assert outcome(fewest) == (Outcome.PERIODIC, pytest.approx(exact, abs=0.01))
    assert outcome(fewest - 1)[0] != Outcome.PERIODIC
    assert outcome(int(0.9 * fewest))[0] == Outcome.DIVERGED
