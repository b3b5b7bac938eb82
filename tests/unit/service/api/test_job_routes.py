"""Endpoints of jobs: idempotency keys, budgets, estimates, links, ETags."""

import json
import threading
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from scripted import Held, sweep, wait_for
from served import computing, finished, get, service
from tables import for_each

from service.views import difference

SWEEP: dict[str, Any] = {**sweep().as_submitted(), "name": "small"}


# Idempotency keys


def test_a_key_must_be_ascii_without_spaces(tmp_path: Path):
    with service(tmp_path, Held()) as client:
        for key in ("", "two words", "x" * 256, "tab\t"):
            answer = client.post("/v1/jobs", json=SWEEP, headers={"Idempotency-Key": key})
            assert answer.status_code == 422, key
            assert answer.json()["errors"][0]["field"] == "idempotency-key"
            assert "pattern" not in answer.json()["detail"]
        answer = client.post(
            "/v1/jobs", json=SWEEP, headers=[("Idempotency-Key", "a"), ("Idempotency-Key", "b")]
        )
        assert (answer.status_code, answer.json()["detail"]) == (422, "idempotency-key: is given 2 times")


# Budgets


def test_budgets_of_one_sweep_have_one_job_and_are_told_apart(tmp_path: Path):
    with service(tmp_path, Held()) as client:
        answers = [client.post(f"/v1/jobs?budget={seconds}", json=SWEEP) for seconds in ("10m", 300)]
        assert [answer.status_code for answer in answers] == [202, 200]
        begun = [answer.json() for answer in answers]
        assert (
            {job["id"] for job in begun} == {job["budget"]["computing"] for job in begun} == {begun[0]["id"]}
        )
        own = [get(client, f"/v1/jobs/{job['id']}", budget=job["budget"]["id"])["budget"] for job in begun]
    assert [budget["id"] for budget in own] == [job["budget"]["id"] for job in begun]
    assert own[0]["seconds_left"] > 300 >= own[1]["seconds_left"]


def view_of(client: TestClient, job: dict[str, Any]) -> dict[str, Any]:
    return get(client, f"/v1/jobs/{job['id']}")


def budget(client: TestClient, spec: dict[str, Any], seconds: float) -> dict[str, Any]:
    """The first level of a budget that is over."""
    first = client.post(f"/v1/jobs?budget={seconds}", json=spec).json()
    wait_for(lambda: view_of(client, first)["budget"]["over"])
    return view_of(client, first)


def test_a_budget_ends_with_a_job_that_is_the_sweep_itself_where_all_of_it_fits(tmp_path: Path):
    spec = SWEEP | {"gamma": {"start": 1.1, "stop": 2.1, "num": 30}, "name": "within a budget"}
    with computing(tmp_path) as client:
        answer = budget(client, spec, 120.0)["budget"]["answer"]
        assert answer == client.post("/v1/jobs", json=spec).json()["id"]
        done = get(client, f"/v1/jobs/{answer}")
        assert (done["state"], done["budget"]["computing"]) == ("done", None)
        assert "of the cells" in done["budget"]["doing"]
        refused = client.post("/v1/jobs?budget=1e-6", json=spec | {"xi": 0.11})
        assert refused.status_code == 422
        assert "was over before the first level of" in refused.text
        states = {job["state"] for job in get(client, "/v1/jobs?search=within")["jobs"]}
    assert states == {"done"}  # nothing began


def test_a_budget_goes_on_where_its_levels_cannot_be_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    never, compared = threading.Event(), list[Any]()
    monkeypatch.setattr(difference, "changed", lambda *studies: compared.append(studies) or never.wait())
    spec = SWEEP | {"gamma": {"start": 1.1, "stop": 2.1, "num": 30}}
    with computing(tmp_path) as client:
        answer = budget(client, spec, 20.0)["budget"]["answer"]
        assert answer == client.post("/v1/jobs", json=spec).json()["id"]
    assert compared


@for_each("how", ["submitted", "resumed"])
def test_a_budget_leaves_what_somebody_else_wants(tmp_path: Path, how: str):
    small = {"gamma": [1.1, 1.2], "omega": 0.5, "xi": 0.1}
    with service(tmp_path / how, Held(), active_jobs=1) as client:
        running = client.post("/v1/jobs", json=SWEEP).json()
        wait_for(lambda: view_of(client, running)["state"] == "running")
        if how == "submitted":
            queued = client.post("/v1/jobs", json=small).json()
        else:
            wait_for(lambda: budget(client, small, 0.4)["state"] == "cancelled")  # it had begun
            queued = get(client, "/v1/jobs?state=cancelled")["jobs"][0]
            client.post(f"/v1/jobs/{queued['id']}/resume")
        assert "was over before" in budget(client, small, 0.4)["budget"]["error"]
        assert view_of(client, queued)["state"] == "queued"


# Links


def test_links_name_every_resource_and_no_path_of_the_machine(tmp_path: Path):
    with computing(tmp_path) as client:
        view = get(client, finished(client, SWEEP))
        assert str(tmp_path) not in json.dumps(view)
        assert set(view["links"]) >= {"diagram", "threshold", "modes", "events", "export", "zarr", "resume"}
        for name in ("self", "diagram", "threshold", "modes", "events"):
            assert client.get(view["links"][name]).status_code == 200, name
        assert client.get(f"{view['links']['export']}?format=nc").status_code == 200
        assert client.get(f"{view['links']['zarr']}/zarr.json").status_code == 200


# Conditional requests


PARTS = ("diagram", "diagram?format=csv", "threshold", "zarr/zarr.json")


def test_results_of_a_done_job_answer_304(tmp_path: Path):
    with computing(tmp_path) as client:
        here = finished(client, SWEEP)
        tags = {}
        for part in PARTS:
            first = client.get(f"{here}/{part}")
            tags[part] = tag = first.headers["ETag"]
            assert (first.status_code, tag[0]) == (200, '"'), part
            assert client.get(f"{here}/{part}").content == first.content, part  # as a strong tag requires
            again = client.get(f"{here}/{part}", headers={"If-None-Match": f'"other", {tag}'})
            assert (again.status_code, again.content, again.headers["ETag"]) == (304, b"", tag), part
            other = client.get(f"{here}/{part}", headers={"If-None-Match": '"other"'})
            assert other.content == first.content, part
        client.post(f"{here}/rename", json={"name": "another"})  # which pictures show
        for part, tag in tags.items():
            assert client.get(f"{here}/{part}", headers={"If-None-Match": tag}).status_code == 200, part
        assert client.delete(here).status_code == 204
        for part, tag in tags.items():
            status = client.get(f"{here}/{part}", headers={"If-None-Match": tag}).status_code
            assert status == (410 if part.startswith("zarr") else 404), part
        finished(client, SWEEP)
        for part, tag in tags.items():  # accepted again, perhaps with another name
            assert client.get(f"{here}/{part}").headers["ETag"] != tag, part
