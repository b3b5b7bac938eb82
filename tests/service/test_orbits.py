"""Closed-form answers over HTTP and in the client, against the kernel's functions and known numbers."""

import itertools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from scripted import wait_for
from served import computing, get

from kernel.branches.curves import Parameter, curves
from kernel.branches.energy import energy
from kernel.branches.events import branch_and_events
from service.api import schemas
from service.client import BadRequest, Client
from service.results import orbits

FOLD_060, JUMP_060 = 0.553244593, 0.915989  # BRANCHES: xi = 0.05, Omega = 0.60
SPRING: dict[str, Any] = {"omega": 0.6, "xi": 0.05}


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    with computing(tmp_path_factory.mktemp("data")) as client:
        yield client


@pytest.fixture
def client(service: TestClient) -> Client:
    return Client("http://localhost", http=service)


def refused(service: TestClient, path: str, status: int, **query: Any) -> str:
    answer = service.get(path, params=query)
    assert answer.status_code == status, answer.text
    return str(answer.json()["detail"])


def test_the_thresholds_of_a_spring(service: TestClient):
    answer = get(service, "/v1/threshold", **SPRING, delta=1e-5)
    assert set(answer) == set(schemas.Threshold.model_fields)
    assert answer["down"] == pytest.approx(FOLD_060, abs=1e-9)
    assert answer["jump"] == pytest.approx(JUMP_060, abs=1e-6)
    assert answer["threshold"] == pytest.approx(0.7818, abs=1e-4)
    assert (answer["cause"], answer["reason"]) == ("fold (1,1)", None)
    assert answer["lifetime"]["delta"] == 1e-5
    assert answer["lifetime"]["periods"] == pytest.approx(1102, abs=1)
    balance = answer["energy"]
    assert balance["plate_contact"] + balance["plate_impact"] == pytest.approx(
        balance["dashpot"] + balance["impact"], abs=1e-9
    )


def test_thresholds_that_there_are_not_are_null(service: TestClient):
    plain = get(service, "/v1/threshold", omega=0.5, xi=0.26)
    assert (plain["down"], plain["cause"]) == (plain["threshold"], "Eq. 25")
    assert plain["lifetime"] is None
    assert plain["energy"] is None
    torus = get(service, "/v1/threshold", omega=0.46, xi=0.05)
    assert (torus["down"], torus["cause"]) == (None, "unresolved")
    assert "torus" in torus["reason"]
    never = get(service, "/v1/threshold", omega=math.sqrt(2), xi=0)
    assert never["threshold"] is None or never["threshold"] > 1e6
    resonance = get(service, "/v1/threshold", omega=1, xi=0)
    assert (resonance["threshold"], resonance["down"]) == (0.0, None)
    assert "omega = 1" in resonance["reason"]
    slow = get(service, "/v1/threshold", omega=0.001, xi=0.05)
    assert slow["cause"] == "unresolved"
    assert "points" in slow["reason"]


def test_branches_are_those_of_the_kernel(service: TestClient):
    answer = get(service, "/v1/orbits", **SPRING, modes="1-1,1-2", gamma_max=1e6, energy="true")
    assert set(answer) == set(schemas.OrbitsView.model_fields)
    events = []
    for periods, view in zip((1, 2), answer["branches"], strict=True):
        branch, found = branch_and_events(0.6, 0.05, periods)
        assert set(view) == set(schemas.BranchView.model_fields)
        assert (view["bounces"], view["periods"]) == (1, periods)
        for name in ("gamma", "flight_time", "takeoff_phase", "elongation", "impact_velocity", "stable"):
            assert view[name] == getattr(branch, name).tolist()
        assert view["multipliers"][3] == [[m.real, m.imag] for m in branch.multiplier[3].tolist()]
        balance = energy(0.6, 0.05, periods, branch.flight_time)
        assert view["energy"]["impact"] == balance.impact.tolist()
        events += list(zip(found.kind.tolist(), found.gamma.tolist(), strict=True))
    assert [(event["kind"], event["gamma"]) for event in answer["events"]] == events
    folds = [event for event in answer["events"] if event["kind"] == "fold" and event["periods"] == 1]
    assert min(event["gamma"] for event in folds) == pytest.approx(FOLD_060, abs=1e-9)
    assert set(folds[0]) == set(schemas.EventView.model_fields)


def test_a_branch_that_leaves_gamma_max_is_several_pieces(service: TestClient):
    whole = get(service, "/v1/orbits", **SPRING, modes="1-1", gamma_max=1e6)["branches"][0]
    cut = get(service, "/v1/orbits", **SPRING, modes="1-1", gamma_max=0.9)
    pieces = cut["branches"]
    assert len(pieces) > 1
    inside = [t for t, gamma in zip(whole["flight_time"], whole["gamma"], strict=True) if gamma <= 0.9]
    assert [t for piece in pieces for t in piece["flight_time"]] == inside
    for before, after in itertools.pairwise(pieces):
        between = [
            gamma
            for t, gamma in zip(whole["flight_time"], whole["gamma"], strict=True)
            if before["flight_time"][-1] < t < after["flight_time"][0]
        ]
        assert between
        assert min(between) > 0.9
    assert all(event["gamma"] <= 0.9 for event in cut["events"])


@pytest.mark.parametrize(
    ("query", "rule"),
    [
        ({"modes": "2-2"}, "of one bounce, as 1-1 and 1-2"),
        ({"modes": "1"}, "must be like 1-1,1-2"),
        ({"modes": "1-99"}, "at most 12 periods, not 99"),
        ({"modes": "1-1,1-1"}, "names a mode twice"),
        ({"modes": "1-1,1-2,1-3,1-4,1-5,1-6,1-7"}, "at most 6, not 7"),
        ({"points": 5}, "points: should be greater than or equal to 10"),
        ({"omega": 0}, "omega: should be greater than 0"),
        ({"omega": 1, "xi": 0}, "xi: must be > 0 at omega = 1"),
        ({"colour": "green"}, "colour: unknown parameter"),
    ],
)
def test_bad_queries_name_field_and_rule(service: TestClient, query: dict[str, Any], rule: str):
    assert rule in refused(service, "/v1/orbits", 422, **SPRING | query)


def test_long_branches_are_refused_before_they_are_computed(service: TestClient):
    assert "the limit is 2,000" in refused(service, "/v1/orbits", 413, omega=0.01, xi=0.05)
    query = {"xi": 0.05, "omega_start": 0.01, "omega_stop": 0.5, "modes": "1-1"}
    assert "the limit is 2,000" in refused(service, "/v1/curves", 413, **query)


def test_orbits_are_kept(service: TestClient):
    orbits.orbits.cache_clear()
    first = service.get("/v1/orbits", params=SPRING).content
    assert service.get("/v1/orbits", params=SPRING | {"energy": "true"}).content != first
    assert orbits.orbits.cache_info().misses == 1


def _curves(service: TestClient, **query: Any) -> Any:
    """The answer, once the workers have it."""
    wait_for(lambda: service.get("/v1/curves", params=query).status_code != 202)
    return get(service, "/v1/curves", **query)


def test_curves_over_omega_have_their_codimension_2_points(service: TestClient, client: Client):
    query = {"xi": 0.05, "omega_start": 0.6, "omega_stop": 0.68, "modes": "1-1", "kinds": "fold"}
    answer = _curves(service, **query)
    assert (answer["xi"], answer["along"]) == (0.05, "omega")
    known = curves(Parameter.OMEGA, 0.05, 0.6, 0.68, 1, ("fold",))  # type: ignore[arg-type]
    below = [curve for curve in known.curves if curve.gamma.max() <= 8.0]
    assert len(below) == len(known.curves) == len(answer["curves"]) > 0
    for view, curve in zip(answer["curves"], known.curves, strict=True):
        assert view["kind"] == "fold"
        assert view["omega"] == curve.omega.tolist()
        assert view["gamma"] == curve.gamma.tolist()
    assert [point["kind"] for point in answer["points"]] == known.points.kind.tolist()

    dataset = client.curves(omega=(0.6, 0.68), xi=0.05, modes="1-1", kinds="fold", progress=False)
    assert dataset.gamma.dims == ("curve", "point")
    assert float(dataset.xi) == 0.05
    assert dataset.kind.values.tolist() == ["fold"] * len(known.curves)
    for row, curve in zip(dataset.omega.values, known.curves, strict=True):
        assert row[: len(curve.omega)].tolist() == curve.omega.tolist()
        assert np.isnan(row[len(curve.omega) :]).all()


def test_a_plane_of_curves_is_one_range_and_one_value(service: TestClient):
    rule = "give xi, omega_start and omega_stop, or omega, xi_start and xi_stop"
    assert rule in refused(service, "/v1/curves", 422)
    assert rule in refused(service, "/v1/curves", 422, xi=0.05, omega=0.5)
    backwards = {"xi": 0.05, "omega_start": 0.6, "omega_stop": 0.5}
    assert "omega_stop: must be above omega_start" in refused(service, "/v1/curves", 422, **backwards)
    query = {"omega": 0.6, "xi_start": 0.05, "xi_stop": 0.06, "kinds": "bend"}
    assert "not 'bend'" in refused(service, "/v1/curves", 422, **query)


def test_the_client_has_labelled_datasets(client: Client):
    thresholds = client.threshold(0.6, 0.05, delta=1e-5)
    assert float(thresholds.down) == pytest.approx(FOLD_060, abs=1e-9)
    assert str(thresholds.cause.values) == "fold (1,1)"
    assert float(thresholds.lifetime) == pytest.approx(1102, abs=1)
    assert float(client.threshold(math.sqrt(2), 1e-9).threshold) > 1e6

    found = client.orbits(0.6, 0.05, energy=True)
    assert found.gamma.dims == ("branch", "point")
    assert set(found.periods.values.tolist()) == {1, 2}
    end = found.points.values[0]
    assert np.isfinite(found.gamma[0, :end]).all()
    assert np.isnan(found.gamma[0, end:]).all()
    inside = np.abs(found.multiplier.values) < 1
    shown = np.isfinite(found.gamma.values)
    assert (found.stable.values[shown] == inside[shown]).all()
    assert (found.admissible.values[~shown] == 255).all()
    balance = found.plate_contact + found.plate_impact - found.dashpot - found.impact
    admissible = (found.admissible == 0).values
    assert np.nanmax(np.abs(balance.values[admissible])) < 1e-9
    fold = found.event_gamma[(found.event_kind == "fold") & (found.event_periods == 1)]
    assert float(fold.min()) == pytest.approx(FOLD_060, abs=1e-9)
    for name, variable in found.variables.items():
        assert "long_name" in variable.attrs, name
    with pytest.raises(BadRequest, match="one bounce"):
        client.orbits(0.6, 0.05, "2-2")
    with pytest.raises(BadRequest, match="give xi, omega_start"):
        client.curves(omega=0.5, xi=0.05)
