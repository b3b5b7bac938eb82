"""Audits and plans through the service: damage is found, what is computed once stays with the job."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray
from fastapi.testclient import TestClient
from json_results import from_json
from scripted import Held
from served import finished, service
from studies import spec_of

from benchmarks.audit import answered, census, drawn
from kernel.params import Cell, Outcome
from service.local import computed
from service.views import plan
from service.views.audit import AuditQuery, compute, is_compiled
from service.views.plan import settings_of
from service.views.selection import Stored
from worker.analysis import audit
from worker.analysis.audit import FIELDS, PARTS, SETS, look
from worker.analysis.intervals import bounds
from worker.analysis.planning import Setting, Share, candidates, recommended
from worker.spec.contact_models import Soft, Stepped
from worker.spec.errors import SpecTooLarge
from worker.studies import study_of
from worker.study.chunks import check_size
from worker.sweep import SweepSpec
from worker.sweep.levels import WHOLE, cells, level

PLANE = spec_of((0.8, 4, 24), (0.4, 1.0, 16), 0.1)
RAMP = PLANE | {
    "omega": [0.5, 0.6], "xi": 0.05, "protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"},
}  # fmt: skip


def audited(client: TestClient, job: str, **query: Any) -> xarray.Dataset:
    return from_json(waited(client, "GET", f"{job}/audit", params=query).content)


def waited(client: TestClient, method: str, path: str, **request: Any) -> Any:
    """The answer, once workers have computed it."""
    for _ in range(200):
        answer = client.request(method, path, **request)
        if answer.status_code != 202:
            assert answer.status_code == 200, answer.text
            return answer
    raise AssertionError("no answer")


def test_an_audit_finds_cells_that_had_no_time_to_settle(client: TestClient):
    hasty = finished(client, PLANE | {"settle": 5, "observe": 20})
    found = audited(client, hasty, cells=60)
    mode = found.sel(question="mode")
    assert mode.sampled == 60
    assert mode.low > 0.1
    assert mode.low <= mode.share <= mode.high
    assert found.outcomes.values.sum() == 60
    assert found.mode_cells.values.sum() == 60
    assert found.deviation.sel(coverage=0.5) < found.sel(question="flights").largest
    assert np.isnan(found.deviation.sel(coverage=0.99))  # infinite, which JSON does not know
    assert set(found.cell_set.values) <= {"numerics", "besides", "area", "threshold"}
    anywhere = found.isel(cell=found.cell_set.values == "area")
    assert anywhere.cell_gamma.size > 0
    assert all(0.8 < gamma < 4 for gamma in anywhere.cell_gamma.values)  # no corner or edge counts more
    assert "of the cells have another outcome or mode" in found.attrs["sentence"]
    area = found.sel(question="area")
    said = f"nearest cell ({int(area.changed)} of {int(area.sampled)} drawn)"
    assert said in found.attrs["sentence"]


def test_a_sentence_counts_flights_that_do_not_repeat(client: TestClient):
    """All cells are aperiodic, and as they begin: nothing but the distribution of flights is wrong."""
    model = {"kind": "rigid", "restitution": 0.999}
    begins = {"gamma": [2.0, 3.0, 4.0], "xi": 0.01, "settle": 0, "observe": 30, "keep": 4000, "model": model}
    found = audited(client, finished(client, PLANE | begins))
    others = found.sel(question="distribution")
    assert others.sampled == 48  # all of them
    assert others.share > 0.1
    said = "0 % flights that repeat and deviate by more than 0.001 rad"
    assert f"{said}, {int(100.0 * float(others.low))} to" in found.attrs["sentence"]
    assert "% others whose distribution does" in found.attrs["sentence"]
    assert (found.cell_set == "numerics").sum() == others.changed  # listed


def test_the_contact_of_a_hasty_choice_is_asked_for_beside_the_numerics(client: TestClient):
    """A stepped contact approximates the exact one, of which `model` is asked."""
    stepped = {"kind": "stepped", "steps_per_contact": 5, "penetration": 1e-2, "restitution": 0.1}
    job = finished(client, PLANE | {"gamma": [1.6, 2.3], "omega": [0.5, 0.6], "model": stepped, "settle": 50})
    found = audited(client, job, tolerance=1e-6)
    assert found.against.values.tolist() == ["numerics", "model"]
    flights = found.sel(question="flights").changed
    assert flights.sel(against="model") > flights.sel(against="numerics")


def test_an_audit_is_compiled_where_the_kernels_of_both_questions_are(monkeypatch):
    stepped = SweepSpec.parse(PLANE | {"model": {"kind": "stepped", "steps_per_contact": 5}})
    study: Any = SimpleNamespace(spec=stepped, submitted=stepped)
    for kinds in ({Soft}, {type(None)}, {Soft, type(None)}):
        monkeypatch.setattr(audit, "is_compiled", lambda _, contact, kinds=kinds: type(contact) in kinds)
        assert is_compiled(study) is (len(kinds) == 2)


def test_cells_of_a_ramp_are_computed_again_from_where_they_began(client: TestClient):
    found = audited(client, finished(client, RAMP), cells=40)
    assert found.sel(question="threshold").sampled > 0
    assert found.sel(question="rest").changed == 0
    assert found.sel(question="area").sampled == 0


def test_certified_cells_are_not_drawn_and_the_bounds_of_the_others_are_scaled(client: TestClient):
    job = finished(client, spec_of((0.8, 4, 12), (0.4, 1.0, 8), 0.1))
    modes = from_json(client.get(f"{job}/modes", params={"color": "multiplier"}).content)
    rest = int(modes.flight_error.isnull().sum())
    found = audited(client, job, cells=rest - 5)
    mode = found.sel(question="mode")
    assert 5 < rest < found.cells == 96
    assert mode.sampled == rest - 5
    assert float(found.certified) == pytest.approx(1 - rest / 96)
    assert found.outcomes.sel(outcome="periodic").sum() == 0
    low, high = bounds(int(mode.changed), int(mode.changed + mode.undecided), rest - 5, rest)
    assert (mode.low, mode.high) == pytest.approx((low * rest / 96, high * rest / 96))
    assert "of the cells are certified" in found.attrs["sentence"]


def test_flights_are_judged_by_the_tolerance_that_a_choice_kept(client: TestClient):
    auto = {"kind": "auto", "tolerance": 0.1}
    job = finished(client, PLANE | {"gamma": [1.2, 1.6, 2.3], "omega": [0.5, 0.6], "model": auto})
    found = audited(client, job)
    assert found.attrs["tolerance"] == 0.1
    assert "deviate by more than 0.1 rad" in found.attrs["sentence"]
    assert audited(client, job, tolerance=1e-6).attrs["tolerance"] == 1e-6


def test_certificates_looser_than_the_tolerance_do_not_count(client: TestClient):
    job = finished(client, PLANE | {"gamma": [1.2, 1.6, 2.3], "omega": [0.5, 0.6]})
    assert audited(client, job).certified > 0
    found = audited(client, job, tolerance=1e-15)
    assert found.certified == 0
    assert found.sel(question="mode").sampled == found.cells


def test_flights_are_judged_where_less_than_a_cycle_is_kept(client: TestClient):
    """Also where nothing is kept but the last hops of a chatter, which do not count."""
    longer = {"gamma": [0.7, 1.2, 1.6, 2.0, 2.3, 2.5], "omega": [0.5, 0.6, 0.7], "xi": 0.26, "keep": 1}
    soft = {"kind": "soft", "penetration": 1e-2, "restitution": 0.2}
    found = audited(client, finished(client, PLANE | longer | {"model": soft}), cells=10)
    assert found.sel(question="integrator").changed == 0
    fixed = {"settle": 300, "model": {"kind": "rigid", "restitution": 0.8}, "keep": 16}
    found = audited(client, finished(client, PLANE | longer | fixed), cells=18)
    assert found.sel(question="flights").changed <= found.sel(question="mode").changed


def test_no_share_of_cells_within_a_deviation_has_those_that_may_deviate_by_anything(client: TestClient):
    """Most hasty cells are stored as aperiodic, with too few flights to compare with those of a cycle."""
    found = audited(client, finished(client, PLANE | {"settle": 20, "observe": 30, "keep": 4}), cells=100)
    flights = found.sel(question="flights")
    assert flights.undecided > 10
    assert flights.covered < 1.0 - flights.undecided / flights.sampled
    for undecided, of_95 in ((0, 58.0), (1, np.inf)):  # the rule of three: 59 of 59 cells
        first = {"deviation": [*range(59)], "undecided": [i < undecided for i in range(59)]}
        assert of_59_cells(first, cells=10_000).deviation.values[2:].tolist() == [of_95, np.inf]


def of_59_cells(fields: dict[str, list[Any]], **sizes: float) -> xarray.Dataset:
    """The audit of a sweep of which 59 cells, drawn at random, were found unchanged but for these fields."""
    periodic = {"outcome": [Outcome.PERIODIC] * 59, "true_outcome": [Outcome.PERIODIC] * 59}
    none = {"thresholds": 0, "certified": 0, "certified_error": 0.0, "repeating": 0}
    part = dict.fromkeys(FIELDS, [0] * 59) | periodic | fields | none | sizes
    spec = SweepSpec(**PLANE)
    return compute(Stored(spec, "none", submitted=spec), AuditQuery(), part)


def test_the_benchmark_draws_audits_from_all_cells():
    study, found = census(SweepSpec(**PLANE | {"gamma": [1.2, 1.6, 2.3], "omega": [0.5, 0.6]}), points=2)
    said = answered(study, drawn(found, 1, np.random.default_rng(0)))
    assert (said["mode"].sampled, answered(study, found)["mode"].high) == (1, 0.0)


def test_a_sentence_says_no_more_than_is_known_of_all_cells():
    """Some are not certified, and those filled in have no flights."""
    sizes = {"cells": 10_000_000, "certified": 9_999_000, "certified_error": 1.0}
    said = of_59_cells({}, **sizes).attrs["sentence"]
    assert said.startswith("99.9 % of the cells are certified")
    assert "99 % of the cells, if they have flights that repeat, deviate by at most 1.1 rad" in said


def test_a_distribution_is_told_by_enough_flights(client: TestClient):
    """Of 8 flights any two windows of one chaotic cell differ."""
    chaotic = {"gamma": [2.5, 3.0, 3.5, 4.0], "omega": [0.4, 0.5, 0.6], "xi": 0.05}
    numbers = {}
    for keep in (8, 64):
        found = audited(client, finished(client, PLANE | chaotic | {"keep": keep}), cells=12)
        numbers[keep] = found.sel(question="distribution")
    assert (numbers[8].changed, numbers[64].undecided) == (0, 0)
    assert numbers[8].undecided >= 6
    assert numbers[8].high > numbers[64].high


@pytest.mark.parametrize("micro_flight", [0.05, 9.0])
def test_time_steps_do_not_follow_the_cells_of_another_contact(tmp_path, micro_flight):
    """As if the kernel had another law of contact than its document says; also with short flights alone."""
    soft = {"kind": "soft", "penetration": 1e-2, "restitution": 0.1}
    cells = {"gamma": [1.2, 1.6, 2.3], "omega": [0.5, 0.6], "micro_flight": micro_flight}
    spec = SweepSpec(**PLANE | cells | {"model": soft})
    deep = spec.model_copy(update={"model": Soft(penetration=5e-2, restitution=0.1)})
    with computed(spec, tmp_path, progress=False) as done:
        url = done.job.store_url
        parts = [look(deep, url, None, 5, 6, 0, 1e-3, part) for part in range(PARTS)]
    deviations = [
        deviation
        for part in parts
        for name, deviation in zip(part["set"], part["deviation"], strict=True)
        if SETS[name] == "integrator"
    ]
    assert deviations
    assert all(deviation > 1e-3 or deviation == -1.0 for deviation in deviations)


def test_time_steps_that_come_to_rest_differ_from_a_part_of_a_cycle(tmp_path, monkeypatch):
    soft = {"kind": "soft", "penetration": 1e-2, "restitution": 0.2}
    cells = {"gamma": 1.2, "omega": [0.5, 0.6, 0.7], "xi": 0.26, "keep": 1}
    spec = SweepSpec(**PLANE | cells | {"model": soft})
    begin = audit._scalar_run

    def begin_at_rest(model, cells, starts, **window):
        resting = isinstance(model, Stepped)
        return begin(model, [Cell(0.1, 0.5, 0.26)] if resting else cells, starts, **window)

    monkeypatch.setattr(audit, "_scalar_run", begin_at_rest)
    monkeypatch.setattr(audit, "Start", lambda *_: None)
    with computed(spec, tmp_path, progress=False) as done:
        parts = [look(spec, done.job.store_url, None, 4, 4, 0, 1e-3, part) for part in range(PARTS)]
    names = ("set", "bounces", "deviation")
    rows = [row for part in parts for row in zip(*(part[name] for name in names), strict=True)]
    of_part = [deviation for number, n, deviation in rows if SETS[number] == "integrator" and n > 1]
    assert of_part
    assert set(of_part) == {-1.0}


def test_an_audit_stays_with_its_job_and_describes_its_files(client: TestClient):
    job = finished(client, PLANE | {"settle": 50, "observe": 20})
    query = {"cells": 20, "seed": 7}
    first = waited(client, "GET", f"{job}/audit", params=query).json()
    assert client.get(f"{job}/audit", params=query).json() == first
    assert client.post(f"{job}/audit", params=query).json() == first
    export = client.get(f"{job}/export?format=nc")
    assert first["attrs"]["sentence"].encode() in export.content


def test_a_job_that_is_not_done_has_no_audit(tmp_path):
    with service(tmp_path, Held()) as held:
        job = held.post("/v1/jobs", json=PLANE).json()["id"]
        answer = held.get(f"/v1/jobs/{job}/audit")
        assert answer.status_code == 422
        assert "is not done" in answer.text


def test_a_plan_tells_what_a_budget_buys(client: TestClient):
    spec = spec_of((0.8, 4, 48), (0.4, 1.0, 32), 0.3)
    found = from_json(waited(client, "POST", "/v1/plans?budget=1m", json=spec).content)
    rows = {name: found[name].values.tolist() for name in found.data_vars}
    assert sum(rows["recommended"]) == 1
    assert rows["share"][rows["recommended"].index(True)] == min(rows["share"])  # all fit into the budget
    assert all(
        low <= share <= high
        for low, share, high in zip(rows["low"], rows["share"], rows["high"], strict=True)
    )
    whole, draft = rows["effort"].index("standard"), len(rows["effort"]) - 1
    assert rows["effort"][draft] == "draft"
    assert rows["share"][draft] > rows["share"][whole]
    assert rows["seconds"][draft] < rows["seconds"][whole]


def test_a_plan_of_an_adaptive_map_costs_what_its_levels_cost():
    """A coarser map computes a larger share of its cells, and has fewer chunks than there are workers."""
    spec = SweepSpec(**spec_of((0.9, 6, 401), (0.2, 1.2, 401), 0.26, refine={"by": "mode"}))

    def cost(spec: SweepSpec) -> Any:
        return study_of(spec).estimate(spec, study_of(spec).plan(spec))

    settings = settings_of(spec, lambda _: 3.0, 64, study_of(spec).plan)
    for setting in settings:
        assert setting.seconds == cost(level(setting.spec, setting.steps)).at(3.0).seconds_on(64)
    shares = [Share(100, 0.0, 0.0, 0.03)] * len(settings)
    assert plan.compute(settings, plan.PlanQuery(), (shares, 0)).attrs["note"].startswith("cells that a map")


def test_a_plan_compares_only_what_the_service_would_accept():
    spec = SweepSpec(**spec_of((0.8, 4, 48), (0.4, 1.0, 32), 0.3))

    def settings(most: int) -> list[Setting]:
        def check(part: SweepSpec) -> Any:
            plan = study_of(part).plan(part)
            check_size(study_of(part).estimate(part, plan), max_cells=most)
            return plan

        return settings_of(spec, lambda _: 3.0, 2, check)

    compared = [cells(setting.spec, setting.steps) for setting in settings(500)]
    assert 0 < max(compared) <= 500
    with pytest.raises(SpecTooLarge, match=r"asks for 1,536 cells; at most 2 are"):
        settings(2)


def test_a_recommended_setting_keeps_to_budget_and_tolerance_together():
    settings = [Setting(None, WHOLE, seconds, 1, "draft") for seconds in (9.0, 5.0, 1.0)]
    shares = [Share(100, share, 0.0, share) for share in (0.01, 0.02, 0.3)]
    limits = [(6.0, 0.05), (6.0, None), (None, 0.5), (6.0, 0.001), (0.5, 0.05)]
    assert [candidates(settings, shares, *each) for each in limits] == [[1], [2, 1], [2, 1, 0], [2, 1], [2]]
    many = [Setting(None, WHOLE, seconds, 1, "draft") for seconds in range(7)]
    highs = (0.04, 0.03, 0.04, 0.03, 0.01, 0.02, 0.3)
    assert candidates(many, [Share(100, 0.0, 0.0, high) for high in highs], None, 0.05) == [0, 1, 2, 4]
    tolerances = (0.5, 0.05, 0.001, None)
    assert [recommended([2, 1, 0], shares, tolerance) for tolerance in tolerances] == [2, 1, 0, 0]


def test_a_plan_that_would_take_long_or_is_of_a_ramp_is_refused_before_it_begins(client: TestClient):
    fine = {"kind": "stepped"}
    for spec, status, said in ((PLANE | {"model": fine}, 413, "core-seconds"), (RAMP, 422, "protocol.kind")):
        answer = client.post("/v1/plans", json=spec)
        assert (answer.status_code, said in answer.text) == (status, True)
