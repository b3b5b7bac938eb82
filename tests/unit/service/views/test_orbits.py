"""Closed-form answers over HTTP and in the client, against the kernel's functions and known numbers."""

import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import served
import xarray
from fastapi.testclient import TestClient
from json_results import from_json
from matplotlib.figure import Figure
from scripted import Held, wait_for
from served import get
from served import service as begun
from studies import spec_of
from tables import for_each

from kernel.cycles.thresholds import closed_form
from kernel.search import Searched
from service.client import Client
from service.pictures import AXES
from service.views import threshold
from service.views.registry import SPRINGS
from service.views.springs import curves as curves_view
from service.views.springs import orbits as orbits_view
from service.views.springs import threshold as spring_threshold
from worker.analysis.prediction import of_contact, predict

FOLD_060 = 0.553244593  # BRANCHES: xi = 0.05, Omega = 0.60
SPRING: dict[str, Any] = {"omega": 0.6, "xi": 0.05}


def refused(client: TestClient, path: str, status: int, **query: Any) -> str:
    answer = client.get(path, params=query)
    assert answer.status_code == status, answer.text
    return str(answer.json()["detail"])


def test_branches_are_the_same_at_once_and_by_the_workers(
    python_client: Client, monkeypatch: pytest.MonkeyPatch
):
    answer = python_client.orbits(**SPRING, gamma_max=1e6, energy=True)
    others = {"flights", "cycle_state", "event_complete"}
    rows = {row.name for row in SPRINGS["orbits"].variables}
    assert set(answer.data_vars) | {"branch_bounces", "branch_periods", "points"} == rows - others
    monkeypatch.setattr(orbits_view, "AT_ONCE_SECONDS", 0.0)
    again = python_client.orbits(**SPRING, gamma_max=1e6, energy=True, progress=False)
    xarray.testing.assert_identical(again, answer)


def test_long_branches_are_refused_and_the_omega_that_is_named_works(client: TestClient):
    for omega in (1e-6, 0.038):
        rule = refused(client, "/v1/orbits", 422, omega=omega, xi=0.05, modes="1-1")
        named = rule.removeprefix("omega: must be at least about ").split()[0]
        query: dict[str, Any] = {"omega": named, "xi": 0.05, "modes": "1-1"}
        assert client.get("/v1/orbits", params=query).status_code in (200, 202)
    query = {"xi": 0.05, "omega_start": 0.01, "omega_stop": 0.5, "modes": "1-1"}
    assert "at most 2,000 points" in refused(client, "/v1/curves", 422, **query)
    query = {"omega": 0.01, "xi_start": 0.05, "xi_stop": 0.06, "modes": "1-1"}
    assert "at most 2,000 points" in refused(client, "/v1/curves", 422, **query)


def test_branches_are_as_smooth_in_a_window(python_client: Client):
    """Beside the fold, from which a chord between the points of the whole branch is far."""
    window = {"start": 0.5532, "stop": 0.5533, "flight_start": 4.17, "flight_stop": 4.2}
    found = python_client.orbits(0.6, 0.05, "1-1", progress=False, **window).isel(branch=0)
    points = found.isel(point=np.flatnonzero((found.gamma < 0.5533) & (found.gamma > 0.5532)))
    assert points.sizes["point"] > 200
    assert points.gamma.values.min() == pytest.approx(FOLD_060, abs=1e-9)
    stable = points.isel(point=np.flatnonzero(points.stable))
    assert np.interp(0.5533, stable.gamma, stable.flight_time) == pytest.approx(4.1882262, abs=1e-4)


def test_events_name_the_piece_of_a_branch_that_they_are_on(python_client: Client):
    answer = python_client.orbits(0.6, 0.05, "1-1", gamma_max=0.9, progress=False)
    assert answer.sizes["branch"] == 2  # which meet above
    assert answer.event_branch.values.tolist() == [1, 1]
    answer = python_client.orbits(0.6, 0.05, "1-1", gamma_max=0.5532446, progress=False)
    assert (answer.event_kind.item(), answer.event_branch.item()) == ("fold", -1)  # all points are above it


def test_branches_of_a_contact_reach_the_gamma_asked_for(python_client: Client):
    answer = python_client.orbits(0.6, 0.05, "1-1", gamma_max=2.0, model="soft", progress=False)
    assert 2.0 - 1e-12 < float(answer.gamma.max()) <= 2.0


def test_doubled_branches_have_flips_of_their_own(python_client: Client):
    """The flip is that of issue 45; those of other contacts are in kernel/cycles/test_changes.py."""
    answer = python_client.orbits(
        0.5, 0.26, modes="1-1", gamma_max=2.6, model="soft", doubled=True, progress=False
    )
    assert answer.branch_periods.values.tolist() == [1, 2]
    of_doubled = (answer.event_kind == "flip") & (answer.event_periods == 2)
    assert answer.event_gamma.values[of_doubled.values] == pytest.approx([2.504559485239], abs=1e-9)
    assert answer.event_branch.values.tolist() == (answer.event_periods.values - 1).tolist()
    # its two long flights part where it begins, at the flip of the single one
    first, second = answer.flight_time.values[1, : int(answer.points[1]), :2].T
    begins = np.argmin(first - second)
    assert answer.gamma.values[1, begins] == pytest.approx(2.08, abs=0.01)
    assert (first - second).max() > 3.0


@for_each(("query", "down", "status"), [
    ({}, 0.553244593, "closed form"),
    ({"model": "rigid"}, 0.553244593, "closed form"),
    ({"model": "soft"}, 0.553241345562, "continued"),
    ({"model": "rigid", "restitution": 0.3}, 0.559952062803, "continued"),
    ({"model": "soft", "omega": 0.46}, np.nan, "unresolved"),  # a torus
])  # fmt: skip
def test_a_threshold_is_that_of_the_contact(
    python_client: Client, query: dict[str, Any], down: float, status: str
):
    """The folds are those of issue 45."""
    answer = python_client.threshold(**SPRING | query, progress=False)
    assert float(answer.down) == pytest.approx(down, abs=1e-9, nan_ok=True)
    assert answer.status.item() == status
    assert answer.attrs["model"].startswith(query.get("model", "rigid, restitution 0"))


def test_a_search_that_finds_nothing_leaves_the_fold_that_is_known():
    query = spring_threshold.SpringQuery(**SPRING, search=True)
    nothing = Searched(np.nan, "", starts=100)
    answer = spring_threshold.compute_spring(None, query, predict(0.6, 0.05), nothing)
    assert float(answer.down) == pytest.approx(FOLD_060, abs=1e-9)
    assert (answer.cause.item(), answer.status.item()) == ("fold (1,1)", "closed form")
    assert float(answer.missed) == nothing.missed


def test_a_search_leaves_the_note_that_branches_were_cut_off():
    spring = {"omega": 0.9, "xi": 0.06}
    query = spring_threshold.SpringQuery(model="rigid", restitution=0.7, search=True, **spring)
    followed = of_contact(query.contact(), **spring)
    answer = spring_threshold.compute_spring(None, query, followed, Searched(np.nan, "", starts=100))
    assert answer.status.item() == "searched"
    assert answer.reason.item().startswith("branches were cut off at Gamma = 0.6")


@for_each(("query", "rule"), [
    ({"model": "ball"}, "model: must be 'rigid' or 'soft', not text 'ball'"),
    ({"model": "stepped"}, "model: must be 'rigid' or 'soft'"),
    ({"restitution": 0.3}, "model: is required with restitution"),
    ({"model": "rigid", "penetration": 0.01}, "penetration: is of soft, not of rigid"),
    ({"model": "soft", "restitution": 1}, "restitution: must be below 1, not 1"),
    ({"model": "soft", "energy": True}, "energy: is of the closed form"),
    ({"model": "soft", "flight_start": 0.0}, "flight_start: is of the closed form"),
    ({"doubled": True}, "doubled: needs a model"),
    ({"model": "soft", "along": "xi", "gamma": 2, "gamma_max": 8}, "gamma_max: is of branches along gamma"),
    ({"flight_start": 2.0, "flight_stop": 1.0}, "flight_start: must be below flight_stop"),
    ({"start": 0.6, "stop": 0.6}, "start: must be below stop, which is 0.6"),
    ({"model": "soft", "points": 1000, "modes": "1-1,1-2,1-3,1-4,1-5,1-6"}, "up to 72 core-seconds"),
])  # fmt: skip
def test_what_excludes_each_other_or_has_no_cycles_is_refused(
    client: TestClient, query: dict[str, Any], rule: str
):
    assert rule in refused(client, "/v1/orbits", 422, **SPRING, **query)


def test_curves_of_a_contact_pass_through_its_own_folds_and_flips(python_client: Client):
    """At Omega = 0.6 and 0.66, those of issue 45."""
    answer = python_client.curves(
        xi=0.05, omega_start=0.57, omega_stop=0.66, modes="1-1", model="soft", progress=False
    )
    assert answer.curve_kind.values.tolist() == ["fold", "fold", "flip"]
    middle, end = (int(np.argmin(np.abs(answer.omega.values[0] - value))) for value in (0.6, 0.66))
    expected = [
        [0.915986309968, 0.809085730714],
        [0.553241345562, 0.596890103655],
        [0.724382078263, 2.373172758743],
    ]
    assert answer.gamma.values[:, [middle, end]] == pytest.approx(np.array(expected), abs=1e-9)


def test_curves_of_a_contact_end_before_their_cusp(python_client: Client):
    """Beyond it a multiplier only comes near 1, and a branch has no folds."""
    soft = {"modes": "1-1", "model": "soft", "restitution": 0.1, "xi": 0.3}
    curves = python_client.curves(**soft, omega_start=0.4, omega_stop=1.2, kinds="fold", progress=False)
    for omega, folds in ((0.528, 2), (0.5299, 0)):
        events = python_client.orbits(**soft, omega=omega).event_kind.values.tolist()
        assert events.count("fold") == (curves.omega.max("point") >= omega).sum() == folds


def _points(curves: Any, along: str) -> list[Any]:
    """The parameter and Gamma (2, n) of each curve."""
    points = np.stack([curves[along].values, curves.gamma.values], axis=1)
    return [curve[:, np.isfinite(curve[0])] for curve in points]


@for_each(("spring", "along", "span", "at", "kind", "count"), [
    ({"model": "rigid", "restitution": 0.7, "omega": 0.6, "gamma_max": 4.0}, "xi", (0.05, 0.08), 0.065,
     "fold", 11),
    ({"model": "soft", "restitution": 0.1, "penetration": 0.00156, "xi": 0.11079}, "omega", (0.98, 1.06),
     1.06, "flip", 9),
])  # fmt: skip
def test_curves_of_many_hops_lie_close_together(
    python_client: Client, spring: dict[str, Any], along: str, span: tuple[float, float], at: float,
    kind: str, count: int,
):  # fmt: skip
    """Each event of the branches is on one of its own."""
    ends = {f"{along}_start": span[0], f"{along}_stop": span[1]}
    curves = python_client.curves(**spring, **ends, modes="1-1", progress=False, kinds=kind)
    events = python_client.orbits(**spring, **{along: at}, modes="1-1")
    there = [np.interp(at, *curve) for curve in _points(curves, along)]
    gamma = events.event_gamma.values[events.event_kind.values == kind]
    assert len(gamma) >= count
    assert np.abs(gamma[:, None] - there).min(axis=1).max() < 1e-6


def test_curves_of_folds_beside_grazes_go_on(python_client: Client):
    """Where a contact of no duration, at the graze, also turns the branch. Longer branches are cut off."""
    spring = {"modes": "1-1", "model": "soft", "restitution": 0.7, "penetration": 0.01, "xi": 0.0643}
    query = {"omega_start": 0.95, "omega_stop": 1.0, "kinds": "fold"}
    curves = python_client.curves(**spring, **query, progress=False)
    assert (curves.event_kind == "cut-off").any()
    events = python_client.orbits(**spring, omega=0.98476)
    folds = events.event_gamma.values[events.event_kind.values == "fold"]
    at = [np.interp(0.98476, *curve) for curve in _points(curves, "omega")]
    assert len(folds) == 6
    assert np.abs(folds[:, None] - at).min(axis=1).max() < 1e-5


def test_curves_go_on_where_the_segments_of_a_cycle_change(python_client: Client):
    """Between those at which curves are sought, too: here short contacts come and go."""
    soft = {"model": "soft", "restitution": 0.05, "penetration": 0.01, "adhesive": False}
    spring = soft | {"xi": 0.07, "modes": "1-1"}
    curves = python_client.curves(**spring, omega_start=0.45, omega_stop=0.8, progress=False)
    for omega in (0.59, 0.745):
        events = python_client.orbits(**spring, omega=omega)
        at = [np.interp(omega, *x, left=np.nan, right=np.nan) for x in _points(curves, "omega")]
        for kind in ("fold", "flip"):
            gamma = events.event_gamma.values[events.event_kind.values == kind]
            on_curves = np.sort(np.array(at)[(curves.curve_kind == kind) & ~np.isnan(at)])
            assert on_curves == pytest.approx(np.sort(gamma), abs=2e-3)


def test_curves_are_held_to_a_limit(client: TestClient, monkeypatch: pytest.MonkeyPatch):
    """By their estimate before they are computed, by their points while they are."""
    query = {"xi": 0.05, "omega_start": 0.1, "omega_stop": 0.12, "modes": "1-1,1-2"}
    monkeypatch.setattr(curves_view, "MAX_SECONDS", 10.0)
    rule = refused(client, "/v1/curves", 422, **query)
    assert rule.startswith("modes: their curves from omega 0.1 on take about 24 core-seconds, the limit for")
    assert rule.endswith("is 10: ask for the first 1, or take a larger omega")
    monkeypatch.setattr("kernel.cycles.curves._ALL_POINTS", 100)
    # Another spring than those of other tests, whose curves are kept.
    query = {"xi": 0.051, "omega_start": 0.6, "omega_stop": 0.68, "modes": "1-1", "kinds": "fold"}
    wait_for(lambda: client.get("/v1/curves", params=query).status_code != 202)
    assert "omega_stop: the curves up to 0.68 have more" in refused(client, "/v1/curves", 422, **query)


@for_each(("query", "advice"), [
    ({"restitution": 0.95, "modes": "1-1,1-2"}, "72 .* ask for the first 1, or take a smaller restitution$"),
    ({"restitution": 0.98, "modes": "1-1"}, "90 .* is 60: take a smaller restitution$"),
])  # fmt: skip
def test_curves_of_a_contact_that_hops_for_long_are_held_to_the_limit(
    client: TestClient, query: dict[str, Any], advice: str
):
    """At restitutions of 0.9 and 0.95 curves took up to 18 and 40 core-seconds a mode."""
    span = {"xi": 0.05, "omega_start": 0.55, "omega_stop": 0.7, "model": "rigid"}
    assert re.search(advice, refused(client, "/v1/curves", 422, **span, **query))


# Cycles continued from the cells of a sweep

FIGURE_2: dict[str, Any] = {
    "gamma": [1.5, 1.8, 2.2, 2.3, 2.4, 2.52], "omega": 0.5, "xi": 0.26, "settle": 400, "observe": 100,
}  # fmt: skip


def test_cells_beyond_as_many_branches_as_are_followed_are_named(
    python_client: Client, monkeypatch: pytest.MonkeyPatch
):
    """The shortest cycles are followed: (1,1), twice on one branch, and not its double beyond the flip."""
    monkeypatch.setattr("worker.analysis.cycles.MAX_BRANCHES", 1)
    spec = FIGURE_2 | {"gamma": [1.51, 1.6, 2.3], "model": {"kind": "rigid"}}
    job = python_client.submit(spec).wait(progress=False)
    found = job.orbits(progress=False)
    assert found.sizes["branch"] == 1
    assert found.skipped_gamma.values.tolist() == [2.3]
    assert found.skipped_reason.values.tolist() == ["1 branches were followed before it, the limit"]
    doubled = job.orbits(doubled=True, gamma_max=2.6, progress=False)
    assert doubled.branch_periods.values.tolist() == [1, 2]
    assert doubled.event_gamma.values[-1] == pytest.approx(2.5045676620, abs=1e-9)


@for_each(("model", "own", "plate"), [
    ({"kind": "rigid"}, {"start": 1.5, "stop": 2.5}, ""),
    ({"kind": "rigid", "restitution": 0.3}, {"model": "rigid", "restitution": 0.3}, ""),
    ({"kind": "stepped", "penetration": 1e-2}, {"model": "soft", "penetration": 1e-2}, ""),
    ({"kind": "soft", "rest_length": 10}, {"start": 1.5, "stop": 2.5}, ", ideal plate"),
])  # fmt: skip
def test_a_diagram_has_the_branches_of_its_contact_or_names_that_of_others(
    client: TestClient, python_client: Client, model: dict[str, Any], own: dict[str, Any], plate: str
):
    job = python_client.submit(FIGURE_2 | {"gamma": [1.5, 2.5], "model": model}).wait(progress=False)
    found = job.diagram(branches=True, progress=False)
    modes = "1-1,1-2,1-3"
    asked = python_client.orbits(0.5, 0.26, modes, gamma_max=5.0, progress=False, **own)
    assert found.branch_periods.values.tolist() == asked.branch_periods.values.tolist()
    for name in ("gamma", "flight_time", "stable", "violations"):
        np.testing.assert_array_equal(found[f"branch_{name}"], asked[name])
    path, axes = f"/v1/jobs/{job.id}/diagram", job.plot(branches=True)
    assert f">unstable cycle{plate}<" in client.get(path, params={"branches": True, "format": "svg"}).text
    assert f"unstable cycle{plate}" in axes.get_legend_handles_labels()[1]


def test_a_ramp_along_omega_has_the_cycles_of_its_cells(client: TestClient, python_client: Client):
    ramp = {"protocol": {"kind": "ramp", "axis": "omega", "direction": "both"}, "model": {"kind": "rigid"}}
    spec = FIGURE_2 | ramp | {"gamma": 0.88, "omega": {"start": 0.54, "stop": 0.63, "num": 10}, "xi": 0.05}
    job = python_client.submit(spec).wait(progress=False)
    found = job.orbits(along="omega", progress=False)
    folds = found.event_omega.values[found.event_kind.values == "fold"]
    assert len(folds) == 2
    for omega in folds:  # in closed form, along gamma
        there = python_client.orbits(float(omega), 0.05)
        along_gamma = there.event_gamma.values[there.event_kind.values == "fold"]
        assert np.abs(along_gamma - 0.88).min() < 1e-9
    doubled = found.branch_periods.values.tolist().index(2)  # settled to on the way down alone
    assert job.orbits(along="omega", direction="up", progress=False).branch_periods.values.tolist() == [1]
    drawn = job.diagram(along="omega", branches=True, progress=False)
    for name in ("omega", "stable"):
        np.testing.assert_array_equal(drawn[f"branch_{name}"], found[name])
    points = int(found.points[doubled])
    longest = found.flight_time.values[doubled, :points, 0]
    np.testing.assert_array_equal(drawn.branch_flight_time.values[doubled, :points], longest)
    assert "stable cycle" in job.plot(along="omega", branches=True).get_legend_handles_labels()[1]
    fold = int(np.nanargmin(np.abs(found.omega.values[0] - folds[0])))
    for cycle in (found.isel(branch=doubled, point=points // 2), found.isel(branch=0, point=fold)):
        start = {"periods": int(cycle.branch_periods), "state": cycle.cycle_state.values.tolist()}
        cell = {"gamma": float(cycle.gamma), "omega": float(cycle.omega), "xi": 0.05}
        moves = {**cell, "model": {"kind": "rigid"}, "periods": 6, "start": start}
        path = from_json(client.post("/v1/trajectories", json=moves).content)
        assert path.cycle_multipliers.values == pytest.approx(cycle.multipliers.values, abs=1e-6)
        bounces = int(path.cycle_bounces)
        flights = path.flight_time.values[path.flight_time.values > 0.05][:bounces]
        assert sorted(flights)[::-1] == pytest.approx(cycle.flight_time.values[:bounces], abs=1e-9)


def test_branches_along_xi_end_without_damping(python_client: Client):
    axes = {"gamma": 1.2, "omega": 0.6, "xi": {"start": 0, "stop": 0.2, "num": 6}}
    job = python_client.submit(FIGURE_2 | axes | {"model": {"kind": "rigid"}}).wait(progress=False)
    found = job.orbits(along="xi", progress=False)
    assert np.nanmin(found.xi) == 0.0 < np.nanmax(found.xi)
    query: dict[str, Any] = {"modes": "1-1", "along": "xi", "gamma": 2.0, "model": "soft"}
    undamped = python_client.orbits(0.5, 0.0, **query, progress=False)
    assert np.nanmin(undamped.xi) == 0.0
    orbits_view.draw(undamped, figure := Figure())
    assert figure.axes[0].get_xlabel() == AXES["xi"]
    along_gamma = python_client.orbits(0.5, 0.0, "1-1", model="soft", progress=False)
    order = np.argsort(along_gamma.flight_time.values, axis=None)
    times, gammas = (x.values.ravel()[order] for x in (along_gamma.flight_time, along_gamma.gamma))
    assert np.interp(undamped.flight_time.values[0, 0], times, gammas) == pytest.approx(2.0, abs=0.02)


@for_each(("model", "rule"), [
    ({"kind": "ball"}, "model: cycles are followed of rigid, soft and stepped contacts; the sweep's is ball"),
    ({"kind": "soft", "rest_length": 10}, "with a rest_length every cell has its own"),
])  # fmt: skip
def test_contacts_of_a_job_without_cycles_are_refused(
    client: TestClient, python_client: Client, model: dict[str, Any], rule: str
):
    job = python_client.submit(FIGURE_2 | {"gamma": 1.5, "model": model}).wait(progress=False)
    assert rule in refused(client, f"/v1/jobs/{job.id}/orbits", 422)


def test_the_orbits_of_a_job_name_the_grid(client: TestClient, python_client: Client):
    job = python_client.submit(
        FIGURE_2 | {"omega": [0.5, 0.51], "gamma": 1.5, "model": {"kind": "rigid"}}
    ).wait(progress=False)
    here = f"/v1/jobs/{job.id}/orbits"
    assert "omega: is required: the sweep has 2 values" in refused(client, here, 422)
    assert "direction: must be 'rest'" in refused(client, here, 422, omega=0.5, direction="up")
    assert "gamma_max: is of branches along gamma" in refused(client, here, 422, along="omega", gamma_max=3)
    found = job.orbits(0.507, progress=False)
    assert (float(found.omega), found.attrs["complete"]) == (0.51, 1)


def test_a_study_of_orbits_has_those_of_its_springs(python_client: Client):
    spec = {"protocol": {"kind": "orbits"}, "omega": [0.5, 0.6], "xi": 0.05, "points": 1000}
    job = python_client.submit(spec).wait(progress=False)
    stored, fresh = job.orbits(omega=0.6, progress=False), python_client.orbits(**SPRING, points=1000)
    shared = [name for name in fresh.variables if name in stored.variables]
    assert len(shared) == len(fresh.variables) - 1 == len(stored.variables)  # multipliers of events
    xarray.testing.assert_identical(stored[shared].drop_attrs(), fresh[shared].drop_attrs())
    assert float(job.orbits(0.6, gamma_max=1.0, progress=False).gamma.max()) <= 1.0
    assert job.plot(omega=0.6, ax=Figure().subplots()).get_ylabel() == "flight time (rad)"
    for name, value in (("direction", "up"), ("along", "xi")):
        assert f"{name}: is of the cells of a sweep" in refused(
            job._transport._http, f"/v1/jobs/{job.id}/orbits", 422, omega=0.6, **{name: value}
        )


# Predictions beside the thresholds of a sweep

RAMP = spec_of((0.5, 0.9, 101), [0.6, 0.9], 0.05, "both", (60, 20, 4))


def test_a_ramp_that_begins_below_the_jump_follows_the_cycle_that_shrinks_to_rest(python_client: Client):
    short = RAMP | {"gamma": {"start": 0.7, "stop": 1.05, "num": 71}, "omega": [0.561], "xi": 0.042}
    found = python_client.submit(short).wait(progress=False).threshold()
    assert float(found.down[0]) == pytest.approx(float(found.analytic[0]), abs=0.006)
    assert str(found.difference.values[0]).startswith("the ramp begins below the jump at 1.068")


def test_a_grid_of_springs_is_that_of_the_rule_and_drawn_as_lines_or_a_map(python_client: Client):
    one, few, many = Figure(), Figure(), Figure()
    lines = python_client.thresholds([0.6, 0.62], "0.05,0.1", progress=False)
    spring_threshold.draw_grid(lines, few)
    assert lines.down.values[0] == pytest.approx([FOLD_060, 0.507033469], abs=1e-9)
    assert np.isnan(lines.missed.values).all()
    assert "rotation" not in lines
    drawn = [line.get_ydata() for line in few.axes[0].lines if line.get_label().startswith("$")]
    np.testing.assert_array_equal(drawn, lines.down)
    spring_threshold.draw_grid(lines.isel(omega=[0]), one)
    assert one.axes[0].lines[3].get_marker() == "_"  # Eq. 25, which as a line would not be seen
    plane = python_client.thresholds("0.6,0.62", "0.1:0.2:6", progress=False)
    spring_threshold.draw_grid(plane, many)
    np.testing.assert_array_equal(many.axes[0].collections[0].get_array(), plane.down)


@for_each(("query", "rule"), [
    ({"xi": "0,26"}, "xi: write a decimal point, as 0.26, or a space between two values"),
    ({"omega": "0.6,x"}, "omega: must be numbers, as 0.45,0.46, or start:stop:number"),
    ({"omega": "1_0"}, "omega: must be numbers, as 0.45,0.46, or start:stop:number"),
    ({"xi": "\u0661"}, "xi: must be numbers, as 0.45,0.46, or start:stop:number"),
    ({"xi": "0.1," * 9_000}, "xi: is too long a list: write evenly spaced values as start:stop:number"),
    ({"omega": "0.6,0.5"}, "omega: must increase, but 0.6 is followed by 0.5; sort and drop repeats"),
    ({"omega": "0.4:0.5:1"}, "omega.num: must be at least 2 to reach from start to stop"),
    ({"omega": "0.5:0.6:99999"}, "omega: must be fewer: 4,000 springs take 4,000 core-seconds"),
    ({"omega": "0.5:0.6:267", "search": True}, "omega: must be fewer: 266 springs take"),
    ({"xi": "-1"}, "xi: must be"),
    ({"restitution": 0.3}, "model: is required with restitution"),
    ({"effort": 50}, "effort: is of a search"),
])  # fmt: skip
def test_grids_of_springs_are_checked(client: TestClient, query: dict[str, Any], rule: str):
    assert rule in refused(client, "/v1/thresholds", 422, **{"omega": "0.6", "xi": "0.05"} | query)


def test_cycles_of_a_sweeps_cells_answer_where_the_branches_do_not(
    python_client: Client, monkeypatch: pytest.MonkeyPatch
):
    """As if no branch were searched: the cells are on the cycle that ends at the fold of zs (2,2)."""
    monkeypatch.setattr("worker.analysis.prediction.MAX_GRID", 100)
    monkeypatch.setattr("kernel.cycles.thresholds.PERIODS", 1)
    for module in ("kernel.cycles.thresholds", "worker.analysis.prediction"):  # or others see its answer
        monkeypatch.setattr(f"{module}.closed_form", closed_form.__wrapped__)
    on_the_cycle = RAMP["protocol"] | {"direction": "down", "start": {"periods": 2}}
    few = {"gamma": [2.3, 2.305], "omega": 1.26, "protocol": on_the_cycle, "settle": 400, "keep": 16}
    job = python_client.submit(RAMP | few).wait(progress=False)
    assert job.threshold(predict="all", progress=False).cause.item() == "unresolved"
    found = job.threshold(predict="cells", progress=False)
    assert found.cause.item() == "fold of word zs (2,2)"
    assert float(found.predicted_down[0]) == pytest.approx(2.2723905523, abs=1e-9)


def test_a_soft_sweep_is_predicted_from_its_own_cells(python_client: Client):
    """The last cell that bounces on the way down and the fold of its cycle are within a step."""
    soft = RAMP | {"gamma": {"start": 0.5, "stop": 0.7, "num": 101}, "omega": 0.6, "model": {"kind": "soft"}}
    soft["protocol"] = soft["protocol"] | {"direction": "down", "start": {"periods": 1}}
    job = python_client.submit(soft | {"settle": "auto", "observe": 100}).wait(progress=False)
    found = job.threshold(predict="cells", progress=False)
    assert float(found.predicted_down[0]) == pytest.approx(0.553241345562, abs=1e-9)
    assert found.cause.item() == "fold (1,1)"
    assert 0.0 < float(found.down[0]) - float(found.predicted_down[0]) < 0.002
    assert found.attrs["prediction"].startswith("soft, restitution 0.01, penetration 0.001, adhesive: cycles")


@for_each(("steps", "side"), [
    ({"scheme": "euler", "steps_per_contact": 8}, "above"),
    ({"events": "plain", "steps_per_contact": 6}, "below"),  # which does not contradict the soft contact
])  # fmt: skip
def test_a_stepped_sweep_is_predicted_by_the_cycles_of_its_soft_contact(
    python_client: Client, steps: dict[str, Any], side: str
):
    model = {"kind": "stepped", "penetration": 0.1} | steps
    down = RAMP["protocol"] | {"direction": "down", "start": {"periods": 1}}
    few = {"gamma": {"start": 0.5, "stop": 0.7, "num": 201}, "omega": 0.6, "model": model, "protocol": down}
    job = python_client.submit(RAMP | few).wait(progress=False)
    found = job.threshold(predict="cells", tolerance=1e-4, progress=False)
    assert found.attrs["prediction"].startswith("soft, restitution 0.01, penetration 0.1, adhesive: cycles")
    assert found.cause.item() == "fold (1,1)"
    assert found.difference.item().endswith(f"{side} the prediction, which has no time steps")


def test_every_omega_is_predicted_when_asked_for(
    client: TestClient, python_client: Client, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(threshold, "MAX_PREDICTED", 20)
    many = RAMP | {"gamma": [0.5, 0.6], "omega": {"start": 0.6, "stop": 0.65, "num": 21}}
    job = python_client.submit(many).wait(progress=False)
    some, all_ = job.threshold(), job.threshold(predict="all", progress=False)
    assert set(some.cause.values.tolist()) == {"not predicted: ask for all above 20 values of omega"}
    assert np.isfinite(all_.predicted_down.values).all()
    assert float(all_.predicted_down[0]) == pytest.approx(FOLD_060, abs=1e-9)
    assert set(job.threshold(predict="none").cause.values.tolist()) == {"not predicted"}
    where = f"/v1/jobs/{job.id}/threshold"
    assert "must be 'none', 'some', 'all', 'cells' or 'search'" in refused(
        client, where, 422, predict="every"
    )
    words = many | {"omega": {"start": 0.6, "stop": 0.65, "num": 401}}
    large = python_client.submit(words).wait(progress=False)
    where = f"/v1/jobs/{large.id}/threshold"
    assert "enough for 400 values" in refused(client, where, 422, predict="cells")


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
            assert "jobs wait until" in answer.json()["notice"]
        left_out = get(held, f"{large}/threshold")["data_vars"]["cause"]["data"]
        assert left_out[0].startswith("not predicted: 200 values of omega take about")
        rule = refused(held, f"{large}/threshold", 422, predict="all")
        assert "the limit for one answer is 200: enough for" in rule
        assert time.process_time() - began < 2.0  # none of the springs was computed here: 150 s
