"""The HTTP API, from the submission of a sweep to every format of its diagram."""

import errno
import os
import re
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest
from fastapi.testclient import TestClient
from scripted import Held, sweep, wait_for
from served import FIGURE_2, computing, finished, get, read, service
from tables import for_each

from worker.store import backend


@pytest.fixture(scope="module")
def figure_2(client: TestClient) -> str:
    """Path of the finished job."""
    return finished(client, FIGURE_2)


# Jobs


def test_a_submission_is_accepted_and_returns_the_jobs_location(tmp_path: Path):
    with service(tmp_path, Held()) as client:
        answer = client.post("/v1/jobs", json=FIGURE_2)
        assert answer.status_code == 202
        view = answer.json()
        assert re.fullmatch("[0-9a-f]{32}", view["id"])
        assert answer.headers["Location"] == view["links"]["self"] == f"/v1/jobs/{view['id']}"
        assert answer.headers["Retry-After"] == "0"
        assert (view["name"], view["state"], view["error"]) == ("figure 2, coarse", "queued", None)
        progress = view["progress"]
        assert (progress["cells_done"], progress["cells_total"], progress["percent"]) == (0, 111, 0.0)
        assert view["spec"]["gamma"] == {"start": 0.5, "stop": 6.0, "num": 111, "spacing": "linear"}
        assert client.get(f"{view['links']['self']}/zarr/outcome/c.0.0.0.0").status_code == 404


def test_an_unchanged_job_answers_304(client: TestClient, figure_2: str):
    tag = client.get(figure_2).headers["ETag"]
    for candidates in (tag, f'"other", {tag}', tag.removeprefix("W/"), "*"):
        answer = client.get(figure_2, headers={"If-None-Match": candidates})
        assert (answer.status_code, answer.content, answer.headers["ETag"]) == (304, b"", tag)
    assert client.get(figure_2, headers={"If-None-Match": '"other"'}).status_code == 200


def test_unknown_parameters_are_refused_but_probes_and_links_may_have_some(client: TestClient, figure_2: str):
    diagram = ("GET", f"{figure_2}/diagram")
    for method, path in (("GET", "/v1/software"), diagram, ("POST", f"{figure_2}/pin")):
        answer = client.request(method, path, params={"other": 1})
        (problem,) = answer.json()["errors"]
        assert (answer.status_code, problem["field"], problem["code"]) == (422, "other", "unknown")
    for path in ("/", "/healthz", "/metrics"):
        assert client.get(path, params={"x": 1}).status_code == 200


def test_the_name_of_the_data_folder_need_not_be_utf_8(tmp_path: Path):
    name = os.fsdecode(b"\xff")
    with computing(tmp_path / name) as client:
        where = f"{finished(client, sweep().as_submitted())}/zarr/zarr.json"
        assert f"{quote(os.fsencode(tmp_path))}/%FF/" in client.get(where).headers["Bounce-Store"]
        assert get(client, "/v1/software")["data"] == f"{tmp_path}/\ufffd"


def test_a_file_that_cannot_be_read_is_named_in_the_log_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    def refuse(url: str, key: str) -> bytes:
        raise PermissionError(errno.EACCES, "Permission denied", key)

    with computing(tmp_path) as client:
        here = finished(client, sweep().as_submitted())
        monkeypatch.setattr(backend, "read_key", refuse)
        answer = client.get(f"{here}/zarr/outcome/c.0.0.0.0")
    assert (answer.status_code, "zarr.json" in answer.text) == (503, False)
    assert "Permission denied: 'zarr.json'" in caplog.text
    assert "Traceback" not in caplog.text


# Diagrams


def test_results_before_the_job_is_done_are_incomplete(tmp_path: Path):
    held = Held()
    with service(tmp_path, held, active_jobs=1) as client:
        here = client.post("/v1/jobs", json=sweep().as_submitted()).headers["Location"]
        wait_for(lambda: held.held() == 4)
        held.let_go()
        wait_for(lambda: client.get(here).json()["progress"]["chunks_done"] == 1)
        half = read(client, f"{here}/diagram")
        assert not half.attrs["complete"]
        missing = half.outcome == 0
        assert 0 < missing.sum() < 60
        assert half.flight_time[missing].isnull().all()
        assert client.get(f"{here}/diagram", params={"format": "png"}).headers["Bounce-Complete"] == "false"
        assert get(client, f"{here}/threshold")["attrs"]["complete"] is False
        queued = client.post("/v1/jobs", json=sweep(omega=0.6).as_submitted()).headers["Location"]
        nothing = read(client, f"{queued}/diagram")
        assert not nothing.attrs["complete"]
        assert not nothing.outcome.any()
        assert np.isnan(read(client, f"{queued}/threshold").up).all()


@for_each("path", ["{}/modes?", "{}/threshold?", "{}/trajectory?gamma=2&", "/v1/orbits?omega=0.6&xi=0.1&"])
def test_results_are_drawn(client: TestClient, figure_2: str, path: str):
    answer = client.get(f"{path.format(figure_2)}format=png")
    assert answer.content.startswith(b"\x89PNG\r\n\x1a\n"), answer.text


# Operation


def test_the_page_of_endpoints_loads_nothing_from_other_hosts(client: TestClient):
    answer = client.get("/docs")
    assert answer.headers["Content-Type"].startswith("text/html")
    for path in get(client, "/openapi.json")["paths"]:
        assert path in answer.text
    assert not re.search(r"(src|href)=.?https?:|<script|@import", answer.text)
    assert "style-src 'self'" in answer.headers["Content-Security-Policy"]
    for text in ("POST /v1/jobs", "Fields of SweepSpec", "micro_flight", '"xi": [', "Fields of Ramp"):
        assert text in answer.text
    assert "is the estimated cost. With <code>budget</code> levels" in answer.text
    assert "`" not in answer.text
