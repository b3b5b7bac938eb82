"""Closed-form answers over HTTP and in the client, against the kernel's functions and known numbers."""

import itertools
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import served
from fastapi.testclient import TestClient
from matplotlib.figure import Figure
from scripted import Held, wait_for
from served import computing, get
from served import service as begun
from tables import for_each

from kernel.branches.curves import Parameter, curves
from kernel.branches.energy import energy
from kernel.branches.events import Kind, branch_and_events
from service.api import schemas
from service.cli.output import threshold_table
from service.client import BadRequest, Client
from service.client.plots import draw_thresholds
from service.results import orbits, thresholds
from worker.analysis.prediction import prediction_seconds
from worker.spec import SweepSpec

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


@for_each(
    ("query", "rule"),
    [
        ({"modes": "2-2"}, "of one bounce, as 1-1 and 1-2"),
        ({"modes": "1"}, "must be like 1-2 (bounces-periods), not text"),
        ({"modes": "1-99"}, "at most 12 periods, not 99"),
        ({"modes": "1-1,1-1"}, "must not name a mode twice"),
        ({"modes": "1-1,1-2,1-3,1-4,1-5,1-6,1-7"}, "must be 1 to 6 modes, not 7"),
        ({"points": 5}, "points: should be greater than or equal to 10"),
        ({"omega": 0}, "omega: should be greater than 0"),
        ({"omega": 1, "xi": 0}, "xi: must be > 0 at omega = 1"),
        ({"colour": "green"}, "colour: unknown parameter"),
    ],
)
def test_bad_queries_name_field_and_rule(service: TestClient, query: dict[str, Any], rule: str):
    assert rule in refused(service, "/v1/orbits", 422, **SPRING | query)


def test_long_branches_are_refused_before_they_are_computed(service: TestClient):
    assert "the limit is 2,000" in refused(service, "/v1/orbits", 422, omega=0.01, xi=0.05)
    query = {"xi": 0.05, "omega_start": 0.01, "omega_stop": 0.5, "modes": "1-1"}
    assert "the limit is 2,000" in refused(service, "/v1/curves", 422, **query)
    query = {"omega": 0.01, "xi_start": 0.05, "xi_stop": 0.06, "modes": "1-1"}
    assert "the limit is 2,000" in refused(service, "/v1/curves", 422, **query)


def test_curves_are_held_to_a_limit(service: TestClient, monkeypatch: pytest.MonkeyPatch):
    """By their estimate before they are computed, by their points while they are."""
    query = {"xi": 0.05, "omega_start": 0.1, "omega_stop": 0.12, "modes": "1-1,1-2"}
    monkeypatch.setattr(orbits, "MAX_CURVES_SECONDS", 10.0)
    rule = refused(service, "/v1/curves", 422, **query)
    assert rule.startswith("modes: their curves from omega 0.1 on take about 24 core-seconds, the limit for")
    assert rule.endswith("is 10: ask for the first 1, or take a larger omega")
    monkeypatch.setattr("kernel.branches.curves._ALL_POINTS", 100)
    # Another spring than those of other tests, whose curves are kept.
    query = {"xi": 0.051, "omega_start": 0.6, "omega_stop": 0.68, "modes": "1-1", "kinds": "fold"}
    wait_for(lambda: service.get("/v1/curves", params=query).status_code != 202)
    assert "omega_stop: the curves up to 0.68 have more" in refused(service, "/v1/curves", 422, **query)


def test_curves_end_where_a_search_has_no_next_step():
    """Newton's method for a point of codimension 2 may meet a singular matrix."""
    assert len(curves(Parameter.XI, 0.05, 0.0, 1e6, 1, (Kind.FOLD,), lines=2).curves) > 0


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
    assert f"xi: {rule}" in refused(service, "/v1/curves", 422, xi=0.05, omega_start=0.5)
    assert f"omega: {rule}" in refused(service, "/v1/curves", 422, omega=0.5)
    backwards = {"xi": 0.05, "omega_start": 0.6, "omega_stop": 0.5}
    for stop in (0.5, 0.6):
        backwards["omega_stop"] = stop
        assert "omega_stop: must be above omega_start" in refused(service, "/v1/curves", 422, **backwards)
    query = {"omega": 0.6, "xi_start": 0.05, "xi_stop": 0.06, "kinds": "bend"}
    assert "not 'bend'" in refused(service, "/v1/curves", 422, **query)


def test_a_range_and_a_value_suffice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    served.impatient(monkeypatch)
    with served.service(tmp_path, Held()) as client:  # whose workers never answer
        for query in ("xi=0.05&omega_start=0.6&omega_stop=0.61", "omega=0.6&xi_start=0.05&xi_stop=0.06"):
            answer = client.get(f"/v1/curves?{query}")
            progress = {"parts_done": 0, "parts_total": 2, "percent": 0.0}
            assert (answer.status_code, answer.headers["Retry-After"]) == (202, "1")
            assert answer.json() == {"state": "running", "progress": progress}


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


# Words continued from the cells of a sweep

FIGURE_2: dict[str, Any] = {
    "gamma": [1.5, 1.8, 2.2, 2.3, 2.4, 2.52], "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"},
    "settle": 400, "observe": 100,
}  # fmt: skip


def _job_orbits(client: Client, spec: dict[str, Any], **query: Any) -> Any:
    job = client.submit(spec).wait(progress=False)
    return job, job.orbits(progress=False, **query)


def test_words_are_continued_from_settled_cells(client: Client):
    job, found = _job_orbits(client, FIGURE_2, energy=True)
    assert found.sizes["cell"] == 0  # every cell lies on a branch that was followed
    assert sorted(found.word.values.tolist()) == ["s", "ss", "ssss"]
    double = found.isel(branch=found.word.values.tolist().index("ss"))
    assert (int(double.bounces), int(double.periods)) == (2, 2)
    on_it = (found.event_branch == found.word.values.tolist().index("ss")) & (found.event_kind == "flip")
    flips = found.event_gamma.values[on_it.values]
    assert sorted(flips) == pytest.approx([2.5045676620, 3.6325483800], abs=1e-9)
    balance = found.plate_contact + found.plate_impact - found.dashpot - found.impact
    assert float(np.abs(balance.where(found.admissible == 0)).max()) < 1e-9
    # it begins at the flip of the single flight, and is not gone through twice
    gamma = double.gamma.values[: int(double.points)]
    assert gamma.min() == pytest.approx(2.07516, abs=0.01)
    assert (np.diff(gamma) > 0).all() or (np.diff(gamma) < 0).all()
    # the branch passes through the sweep's own cells
    diagram = job.diagram()
    near = int(np.nanargmin(np.abs(double.gamma.values - 2.3)))
    settled = np.sort(diagram.flight_time.sel(gamma=2.3).values[-2:])
    assert np.sort(double.flight_time.values[near][:2]) == pytest.approx(settled, abs=0.05)
    assert bool(double.stable[near])
    assert int(double.admissible[near]) == 0
    assert np.isnan(double.flight_time.values[:, 2:]).all()


def test_cells_without_words_are_told(client: Client):
    short = FIGURE_2 | {"gamma": 2.3, "keep": 3}
    _, found = _job_orbits(client, short)
    assert found.sizes["branch"] == 0
    assert found.skipped_gamma.values.tolist() == [2.3]
    assert "do not show two rounds" in str(found.skipped_reason.values[0])


def test_a_job_not_begun_has_no_cells_to_continue(tmp_path: Path):
    with begun(tmp_path, Held(capacity=0)) as service:
        here = service.post("/v1/jobs", json=FIGURE_2).headers["Location"]
        answer = get(service, f"{here}/orbits")
    assert (answer["branches"], answer["events"], answer["skipped"]) == ([], [], [])
    assert not answer["complete"]


def test_the_orbits_of_a_job_name_the_grid(service: TestClient, client: Client):
    job = client.submit(FIGURE_2 | {"omega": [0.5, 0.51], "gamma": 1.5}).wait(progress=False)
    here = f"/v1/jobs/{job.id}/orbits"
    assert "omega: is required: the sweep has 2 values" in refused(service, here, 422)
    assert "direction: must be 'rest'" in refused(service, here, 422, omega=0.5, direction="up")
    wait_for(lambda: service.get(here, params={"omega": 0.507}).status_code != 202)
    answer = get(service, here, omega=0.507)
    assert set(answer) == set(schemas.WordOrbitsView.model_fields)
    assert (answer["omega"], answer["complete"]) == (0.51, True)
    assert set(answer["branches"][0]) == set(schemas.WordView.model_fields) - {"energy"}
    assert set(answer["events"][0]) == set(schemas.WordEventView.model_fields)


# Predictions beside the thresholds of a sweep

RAMP: dict[str, Any] = {
    "gamma": {"start": 0.5, "stop": 0.9, "num": 101}, "omega": [0.6, 0.9], "xi": 0.05,
    "protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"}, "model": {"kind": "rigid"},
    "settle": 60, "observe": 20, "keep": 4,
}  # fmt: skip


def test_thresholds_of_a_sweep_stand_beside_the_predictions(client: Client):
    job = client.submit(RAMP).wait(progress=False)
    found = job.threshold()
    assert float(found.predicted_down[0]) == pytest.approx(FOLD_060, abs=1e-9)
    assert float(found.predicted_jump[0]) == pytest.approx(JUMP_060, abs=1e-6)
    assert found.cause.values.tolist()[0] == "fold (1,1)"
    assert found.attrs["prediction"].startswith("rigid, restitution 0: the contact of the sweep")
    for down, predicted, difference in zip(
        found.down.values, found.predicted_down.values, found.difference.values, strict=True
    ):
        agrees = -1e-9 <= down - predicted <= 0.004 + 1e-9
        assert (str(difference) == "") == (agrees or not np.isfinite(down - predicted))


def test_words_of_the_cells_leave_unresolved_what_they_do_not_show(service: TestClient, client: Client):
    """At Omega = 0.46 a torus may live near a fold that no cycle of the cells leads to."""
    weak = RAMP | {
        "gamma": {"start": 0.8, "stop": 0.95, "num": 16}, "omega": 0.46,
        "protocol": {"kind": "ramp", "axis": "gamma", "direction": "down"}, "settle": 200, "observe": 60,
        "keep": 16,
    }  # fmt: skip
    job = client.submit(weak).wait(progress=False)
    found = job.threshold(predict="words", progress=False)
    assert found.cause.values.tolist() == ["unresolved"]
    assert np.isnan(found.predicted_down.values[0])
    assert "others may reach lower" in found.attrs["prediction"]
    soft = client.submit(weak | {"model": {"kind": "soft"}, "gamma": [1.0, 1.1]}).wait(progress=False)
    where = f"/v1/jobs/{soft.id}/threshold"
    assert "the sweep's contact is soft" in refused(service, where, 422, predict="words")


def test_a_damping_that_was_not_searched_is_said_to_be(service: TestClient, client: Client):
    """In the answer of a spring, and in the table, the picture and the answer of a sweep, with words too."""
    spring = get(service, "/v1/threshold", omega=0.52, xi=0.02)
    assert (spring["down"], spring["cause"]) == (None, "not searched")
    assert (spring["lifetime"], spring["energy"]) == (None, None)
    assert "from xi = 0.04 on" in spring["reason"]
    assert "Eq. 25, Gamma = 0.843762" in spring["reason"]
    weak = RAMP | {"gamma": [0.7, 0.9], "omega": [0.3191, 0.52], "xi": 0.02}
    job = client.submit(weak).wait(progress=False)
    for predict in ("some", "all", "words"):
        found = job.threshold(predict=predict, progress=False)
        assert found.cause.values.tolist() == ["not searched"] * 2
        assert np.isnan(found.predicted_down.values).all()
    lines = threshold_table(found, found, weak).splitlines()
    assert [line.endswith("  not searched") for line in lines[2:4]] == [True, True]
    ax = Figure().subplots()
    draw_thresholds(ax, found)
    assert "closed form, not searched: 2 of 2" in [str(line.get_label()) for line in ax.lines]


def test_every_omega_is_predicted_when_asked_for(
    service: TestClient, client: Client, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(thresholds, "MAX_PREDICTED", 20)
    many = RAMP | {"gamma": [0.5, 0.6], "omega": {"start": 0.6, "stop": 0.65, "num": 21}}
    job = client.submit(many).wait(progress=False)
    some, all_ = job.threshold(), job.threshold(predict="all", progress=False)
    assert set(some.cause.values.tolist()) == {"not predicted: ask for all above 20 values of omega"}
    assert np.isfinite(all_.predicted_down.values).all()
    assert float(all_.predicted_down[0]) == pytest.approx(FOLD_060, abs=1e-9)
    assert set(job.threshold(predict="none").cause.values.tolist()) == {"not predicted"}
    where = f"/v1/jobs/{job.id}/threshold"
    assert "should be 'none', 'some', 'all' or 'words'" in refused(service, where, 422, predict="every")
    words = many | {"omega": {"start": 0.6, "stop": 0.65, "num": 401}}
    large = client.submit(words).wait(progress=False)
    where = f"/v1/jobs/{large.id}/threshold"
    assert "enough for 400 values" in refused(service, where, 422, predict="words")


def test_closed_forms_that_take_long_are_left_to_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A strong dashpot: rounding grazes all along a branch, and each spring takes about a second."""
    strong = {"gamma": [0.5, 0.6], "xi": 10.0, "model": {"kind": "rigid"}}
    few = strong | {"omega": [1e-6, 2e-6]}
    many = strong | {"omega": {"start": 1e-6, "stop": 2e-6, "num": 200}}
    served.impatient(monkeypatch)
    with begun(tmp_path, Held(capacity=0)) as held:
        here, large = (held.post("/v1/jobs", json=spec).headers["Location"] for spec in (few, many))
        began = time.process_time()
        for path in (f"{here}/threshold", "/v1/threshold?omega=1e-6&xi=10"):
            answer = held.get(path)
            assert (answer.status_code, answer.headers["Retry-After"]) == (202, "1"), path
        left_out = get(held, f"{large}/threshold")
        assert left_out["cause"][0].startswith("not predicted: 200 values of omega take about")
        rule = refused(held, f"{large}/threshold", 422, predict="all")
        assert "the limit for one answer is 200: enough for" in rule
        assert time.process_time() - began < 2.0  # none of the springs was computed here: 150 s


def explained(down: float, predicted: float, cause: str, tolerance: float | None = None) -> str:
    """What is said of a threshold on the way down that is not the predicted one, at omega 0.6, xi 0.05."""
    none = np.array([np.nan])
    found = thresholds.Thresholds(
        xi=0.05, omega=np.array([0.6]), analytic=none, up=none, down=np.array([down]),
        up_status=["not ramped"], down_status=["found"], predicted_jump=none, predicted_down=none,
        cause=[""], difference=[""], prediction="", complete=True, tolerance=tolerance,
    )  # fmt: skip
    known = orbits.thresholds(0.6, 0.05)._replace(down=predicted, cause=cause)
    return thresholds._compared(SweepSpec.parse(RAMP), found, [known], words=False).difference[0]


def test_a_difference_from_the_prediction_is_explained():
    """The grid goes from 0.5 in steps of 0.004."""
    fold = orbits.thresholds(0.6, 0.05)
    assert explained(fold.down + 0.001, fold.down, fold.cause) == ""
    ghost = explained(fold.down - 1e-5, fold.down, fold.cause)
    assert ghost.startswith("bouncing lives about 1,1")
    assert "1e-05 below the fold, longer than the window of 80" in ghost
    early = explained(0.62, fold.down, fold.cause)
    assert "the ramp lost the cycle 0.0668 above the fold: its steps of 0.004 excite the spring" in early
    other = explained(fold.down - 0.03, fold.down, fold.cause)
    assert other == "another cycle than those of one bounce lives 0.03 below the prediction"


def test_a_threshold_within_a_step_above_the_prediction_agrees_with_it():
    for tolerance, step in ((None, 0.004), (1e-4, 1e-4)):
        assert explained(0.62, 0.62, "Eq. 25", tolerance) == ""
        assert explained(0.62, 0.62 - step, "Eq. 25", tolerance) == ""
        assert explained(0.62 - 1e-10, 0.62, "Eq. 25", tolerance) == ""
        late = explained(0.62, 0.62 - 1.01 * step, "Eq. 25", tolerance)
        assert late.startswith(f"the sweep stops bouncing {1.01 * step:.3g} above Eq. 25")
    assert explained(0.5, 0.5, "Eq. 25") == ""  # the first value of the grid has no step below it
    assert "above Eq. 25" in explained(0.5, 0.499, "Eq. 25")
    for missing in ((np.nan, 0.5), (0.5, np.nan)):
        assert explained(*missing, "unresolved") == ""


def test_as_many_springs_are_predicted_at_once_as_may_be(
    service: TestClient, client: Client, monkeypatch: pytest.MonkeyPatch
):
    job = client.submit(RAMP | {"gamma": [0.5, 0.6]}).wait(progress=False)
    monkeypatch.setattr(thresholds, "MAX_PREDICTED", 2)
    predicted = job.threshold()
    assert np.isfinite(predicted.predicted_down.values).all()
    monkeypatch.setattr(thresholds, "MAX_PREDICTED", 1)
    assert set(job.threshold().cause.values.tolist()) == {
        "not predicted: ask for all above 1 values of omega"
    }
    alone = sum(prediction_seconds(omega, 0.05) for omega in predicted.omega.values.tolist())
    for name, seconds, call in (
        ("some", alone, 9.0), ("all", alone, 9.0), ("all", alone, 1e-9),
        ("words", alone + 2 * thresholds.WORDS_SECONDS, 1e-9),
    ):  # fmt: skip
        monkeypatch.setattr(thresholds, "MAX_PREDICTED", 2)
        monkeypatch.setattr(thresholds, "CALL_SECONDS", call)  # all in one call, or each in its own
        monkeypatch.setattr(thresholds, "AT_ONCE_SECONDS", 0.0)
        monkeypatch.setattr(thresholds, "MAX_PREDICTION_SECONDS", seconds)
        every = job.threshold(predict=name, progress=False)  # type: ignore[arg-type]
        assert every.cause.values.tolist() == predicted.cause.values.tolist()
        np.testing.assert_array_equal(every.predicted_down, predicted.predicted_down)
    monkeypatch.setattr(thresholds, "MAX_PREDICTION_SECONDS", 0.99 * alone)
    with pytest.raises(BadRequest, match=r"predict: 2 values of omega take .*: enough for 1 values"):
        job.threshold(predict="all", progress=False)
    left_out = job.threshold()  # what the grid says is read nevertheless
    assert all("enough for 1 values" in str(cause) for cause in left_out.cause.values)
    np.testing.assert_array_equal(left_out.down, predicted.down)


def test_another_contact_is_told_from_the_one_predicted(client: Client):
    job = client.submit(RAMP | {"model": {"kind": "soft"}, "omega": 0.9, "gamma": [0.5, 0.6]})
    assert "not the contact of the sweep, which is soft" in job.wait(progress=False).threshold().prediction


def test_the_motion_of_a_cycle_has_its_energy(client: Client):
    cell = {"gamma": 1.5, "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"}, "settle": 300}
    motion = client.trajectory(cell)
    # BRANCHES: Γ = 1.5 of Fig. 2
    for name, value in {"plate_contact": 5.360202674, "plate_impact": 2.322874748, "dashpot": 4.026176359,
                        "impact": 3.656901063}.items():  # fmt: skip
        assert float(motion[name]) == pytest.approx(value, abs=1e-8)
    assert "plate_contact" not in client.trajectory(cell | {"gamma": 2.3})  # (2,2)
    assert "plate_contact" not in client.trajectory(cell | {"model": {"kind": "soft"}})


# The study

GRID: dict[str, Any] = {
    "name": "folds", "protocol": {"kind": "orbits"}, "omega": {"start": 0.55, "stop": 0.65, "num": 3},
    "xi": [0.05, 0.1], "points": 40,
}  # fmt: skip


def test_a_grid_of_springs_is_a_job(service: TestClient, client: Client):
    estimate = client.estimate(GRID)
    assert (estimate.cells, estimate.chunks > 1) == (6, True)
    job = client.submit(GRID).wait(progress=False)
    assert job.progress.cells_done == 6
    assert job.spec["modes"] == ["1-1", "1-2"]
    stored = job.open().load()
    assert stored.gamma.dims == ("xi", "omega", "branch", "point")
    assert stored.event_gamma.dims == ("xi", "omega", "event")
    cell = stored.sel(xi=0.05).sel(omega=0.6, method="nearest")
    fold = (cell.event_kind.values == 1) & (cell.event_periods.values == 1)
    assert cell.event_gamma.values[fold].min() == pytest.approx(FOLD_060, abs=1e-9)
    assert "must be a sweep; the protocol of this job is orbits" in refused(
        service, f"/v1/jobs/{job.id}/diagram", 422
    )
    assert client.submit(GRID | {"name": "the same"}).id == job.id
