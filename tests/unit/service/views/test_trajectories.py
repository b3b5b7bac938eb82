"""One cell, sample by sample: what the kernel says at every phase, against runs of the kernel itself."""

import json
from typing import Any

import numpy as np
import pytest
import xarray
from fastapi.testclient import TestClient
from json_results import from_json
from kernel_runs import Model, run, sample
from tables import for_each

from kernel.cycles.starts import cycles_at
from kernel.params import Cell
from service.client import Client

CELL: dict[str, Any] = {"gamma": 2.3, "omega": 0.5, "xi": 0.26, "settle": 60, "periods": 4, "samples": 50}
MODELS: list[dict[str, Any]] = [{"kind": "rigid"}, {"kind": "soft"}, {"kind": "ball", "restitution": 0.5}]


def trajectory(client: TestClient, **changes: Any) -> xarray.Dataset:
    answer = client.post("/v1/trajectories", json={**CELL, **changes})
    assert answer.status_code == 200, answer.text
    return from_json(answer.content)


def test_a_start_on_a_cycle(client: TestClient):
    """Where stable and unstable cycles exist: each flies as its point of the branch says."""
    cell = {"gamma": 0.7, "omega": 0.6, "xi": 0.05, "model": {"kind": "rigid"}}
    plain = {key: value for key, value in CELL.items() if key not in ("settle", *cell)}
    unstable, stable = cycles_at(Cell(0.7, 0.6, 0.05), 1).flight_time
    for start, expected in (
        ({}, stable),
        ({"flight_time": 3.0}, unstable),
        ({"flight_time": stable + 0.1, "bounces": 1, "periods": 1}, stable),
    ):
        answer = client.post("/v1/trajectories", json={**plain, **cell, "start": start})
        assert answer.status_code == 200, answer.text
        path = from_json(answer.content)
        assert path.flight_time.values == pytest.approx([expected] * 3, abs=1e-9)
        assert path.cycle_flight_time.item() == pytest.approx(expected, abs=1e-12)
        largest = max(abs(complex(*mu)) for mu in path.cycle_multipliers.values)
        assert path.cycle_stable.item() == (expected == stable) == (largest < 1.0)
        assert path.cycle_violations.item() == 0


@for_each(("changes", "field", "rule"), [
    ({"start": {"periods": 2}}, "start", "there is no stable cycle (1, 2) at gamma 0.7, omega 0.6, xi 0.05"),
    ({"start": {"flight": 4.0}}, "start.flight", "is not a field here; did you mean 'flight_time'?"),
    ({"start": {}, "settle": 10}, "settle", "must be 0 with a start on a cycle, not 10"),
    ({"start": {"kind": "drop", "height": 0.0}}, "start.height", "must be above 0"),
    ({"start": {"kind": "drop", "height": 1.0}, "settle": 3}, "settle", "must be 0 with a start, not 3"),
])  # fmt: skip
def test_a_start_that_cannot_be_names_the_rule(
    client: TestClient, changes: dict[str, Any], field: str, rule: str
):
    cell = {"gamma": 0.7, "omega": 0.6, "xi": 0.05, "model": {"kind": "rigid"}}
    answer = client.post("/v1/trajectories", json=cell | changes)
    assert answer.status_code == 422, answer.text
    (problem,) = answer.json()["errors"]
    assert problem["field"] == field
    assert problem["rule"].startswith(rule)


@for_each("settle", [60, 3, 1])
@for_each("model", MODELS)
def test_flights_are_those_of_a_sweep(client: TestClient, model: dict[str, Any], settle: int):
    flights = trajectory(client, model=model, settle=settle)
    kind = Model[model["kind"].upper()]
    restitution = model.get("restitution", 0.01 if kind is Model.SOFT else 0.0)
    line = run(2.3, 0.5, 0.26, kind, restitution=restitution, settle=settle, observe=4)
    n = int(line.flights[0])
    np.testing.assert_allclose(flights["flight_time"], line.flight_time[0, :n], atol=1e-9)
    np.testing.assert_allclose(flights["takeoff_phase"], line.takeoff_phase[0, :n], atol=1e-9)


def test_a_certified_cell_is_on_its_cycle_close_to_a_flip(python_client: Client):
    """200 plate periods from rest its flights still alternate by 0.3 rad."""
    model = {"kind": "rigid", "restitution": 0.4}
    spec = {"name": "flip", "gamma": 2.08, "omega": 2 / 3, "xi": 0.175, "model": model}
    job = python_client.submit(spec).wait(progress=False)
    cell = job.diagram().isel(gamma=0)
    assert (cell.multiplier > 0.998, cell.multiplier_angle) == (True, pytest.approx(np.pi))
    flights = job.trajectory(2.08, periods=3).flight_time
    assert flights[flights > 4.0].values == pytest.approx([cell.flight_time.max().item()] * 2, abs=1e-9)


@pytest.mark.parametrize(("model", "restitution"), [(Model.RIGID, 0.0), (Model.SOFT, 0.01)])
def test_the_motion_obeys_newton(model: Model, restitution: float):
    """Twice differentiated, the samples give the forces back, wherever no phase begins or ends."""
    contact = {"restitution": restitution}
    line = run(2.3, 0.5, 0.26, model, **contact, settle=0, observe=60, keep=1)
    path = sample(Cell(2.3, 0.5, 0.26), contact, line.end_state[0], model=model, periods=2, samples=4000)
    h = float(path.phase[1])
    z2, q = path.plate + path.gap, path.elongation
    z2_2, q_2 = (np.diff(x, 2) / h**2 for x in (z2, q))
    q_1 = (q[2:] - q[:-2]) / (2 * h)
    spring = 2 * 0.26 / 0.5 * q_1 + q[1:-1] / 0.25
    force = path.force[1:-1]
    inside = (path.in_flight[:-2] == path.in_flight[1:-1]) & (path.in_flight[2:] == path.in_flight[1:-1])
    quiet = inside & (np.abs(np.gradient(force)) < 0.02)
    assert np.count_nonzero(quiet) > 4000
    np.testing.assert_allclose(z2_2[quiet], (spring - 1 / 2.3 + force)[quiet], atol=0.05)
    np.testing.assert_allclose(q_2[quiet], (-2 * spring - force)[quiet], atol=0.05)
    np.testing.assert_allclose(path.velocity[1:-1][quiet], q_1[quiet], atol=1e-5)


UNDAMPED: dict[str, Any] = {"kind": "soft", "restitution": 1, "penetration": 1e-8}
BAD: dict[str, tuple[Any, int, str]] = {
    "not JSON": (b"{", 400, "not JSON"),
    "no gamma": ({"omega": 1, "xi": 1}, 422, "gamma: is required"),
    "an axis": ({**CELL, "gamma": [1, 2]}, 422, "gamma: must be a number, not a list of 2"),
    "a truth": ({**CELL, "omega": True}, 422, "omega: must be a number"),
    "too many samples": ({**CELL, "periods": 200, "samples": 200}, 413, "the limit is 20,000"),
    "no end of the settling": (
        {**CELL, "gamma": 1.5, "omega": 0.8, "xi": 0, "settle": 2, "model": UNDAMPED},
        422,
        "settle: the cell is unresolved before the first sample",
    ),
    "too long to settle": (
        {**CELL, "settle": 1_000_000, "model": {"kind": "stepped", "penetration": 1e-2}},
        413,
        "the limit for one answer is 5 s",
    ),
}


@for_each("case", BAD)
def test_bad_trajectory(client: TestClient, case: str):
    body, status, message = BAD[case]
    content = body if isinstance(body, bytes) else json.dumps(body).encode()
    answer = client.post("/v1/trajectories", content=content, headers={"Content-Type": "application/json"})
    assert answer.status_code == status, answer.text
    assert message in answer.json()["detail"]


def test_only_a_settled_cycle_of_one_bounce_without_restitution_has_its_energy(client: TestClient):
    rigid: dict[str, Any] = {"gamma": 1.5, "model": {"kind": "rigid"}, "settle": 300}
    settled = trajectory(client, **rigid)
    longer = {"gamma": 3.6, "model": {"kind": "rigid"}, "settle": 0, "periods": 6}
    cycle = trajectory(client, **longer, start={"periods": 2})
    assert cycle.cycle_periods.item() == 2
    for found in (settled, cycle):
        given, taken = (
            sum(found[f"energy_{name}"].item() for name in names)
            for names in (("plate_contact", "plate_impact"), ("dashpot", "impact"))
        )
        assert given == pytest.approx(taken, abs=1e-9)
    again = trajectory(client, **rigid, periods=3)
    assert again.energy_dashpot.item() == pytest.approx(settled.energy_dashpot.item(), abs=1e-6)
    for changes in (
        {"settle": 0},  # from rest, not settled yet
        {"settle": 0, "periods": 100},  # but for the last flights
        {"periods": 1},  # one take-off does not show a cycle
        {"gamma": 0.5},  # none
        {"gamma": 2.3},  # (2,2)
        {"model": {"kind": "rigid", "restitution": 0.1}},
    ):
        assert "energy_dashpot" not in trajectory(client, **rigid | changes)
