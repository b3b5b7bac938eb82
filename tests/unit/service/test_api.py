"""The HTTP API, from the submission of a sweep to every format of its diagram."""

import csv
import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest
from fastapi.testclient import TestClient
from paths import GOLDEN
from scripted import Held, sweep, wait_for
from served import FIGURE_2, computing, finished, get, service

from service.errors import DataFolderBusy

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    with computing(tmp_path_factory.mktemp("data")) as client:
        yield client


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
        assert set(view) == {
            *("id", "name", "state", "progress", "error", "failures"),
            *("created", "started", "finished", "spec", "choice", "links", "compiling"),
            *("kernel_version", "notice", "replaced_by", "owner", "repairing", "pinned", "core_seconds"),
        }
        assert (view["name"], view["state"], view["error"]) == ("figure 2, coarse", "queued", None)
        assert view["progress"] == {
            "chunks_done": 0,
            "chunks_total": view["progress"]["chunks_total"],
            "cells_done": 0,
            "cells_total": 111,
            "cells_settling": 0,
            "cells_computed": None,
            "cells_needed": None,
            "percent": 0.0,
            "eta_seconds": None,
        }
        assert view["spec"]["gamma"] == {"start": 0.5, "stop": 6.0, "num": 111, "spacing": "linear"}


def test_the_same_sweep_however_it_is_written_is_the_same_job(client: TestClient, figure_2: str):
    same = {**FIGURE_2, "name": "", "omega": [0.5], "settle": 200.0, "protocol": {"kind": "rest"}}
    answer = client.post("/v1/jobs", json=same)
    assert (answer.status_code, answer.headers["Location"]) == (200, figure_2)
    assert answer.json()["name"] == "figure 2, coarse"


def test_an_unchanged_job_answers_304(client: TestClient, figure_2: str):
    tag = client.get(figure_2).headers["ETag"]
    for candidates in (tag, f'"other", {tag}', tag.removeprefix("W/"), "*"):
        answer = client.get(figure_2, headers={"If-None-Match": candidates})
        assert (answer.status_code, answer.content, answer.headers["ETag"]) == (304, b"", tag)
    assert client.get(figure_2, headers={"If-None-Match": '"other"'}).status_code == 200


def test_cancel_and_resume(tmp_path: Path):
    held = Held()
    with service(tmp_path, held) as client:
        spec = sweep().as_submitted()
        here = client.post("/v1/jobs", json=spec).headers["Location"]
        wait_for(lambda: held.held() == 4)
        assert client.post(f"{here}/cancel").status_code == 202
        wait_for(held.told_to_stop)
        held.let_go_until(lambda: client.get(here).json()["state"] == "cancelled")
        assert client.post(f"{here}/cancel").status_code == 202  # twice is once
        assert client.post("/v1/jobs", json=spec).status_code == 202
        held.let_go_until(lambda: client.get(here).json()["state"] == "done")
        refused = client.post(f"{here}/cancel")
        assert (refused.status_code, refused.json()["status"]) == (409, 409)


def test_two_services_cannot_use_one_data_folder(tmp_path: Path):
    with service(tmp_path, Held()), pytest.raises(DataFolderBusy), service(tmp_path, Held()):
        pass


# Diagrams


def test_a_diagram_holds_every_cell_and_no_more_than_its_flights(client: TestClient, figure_2: str):
    answer = get(client, f"{figure_2}/diagram", min_flight=0)
    assert (answer["along"], answer["direction"], answer["complete"]) == ("gamma", "rest", True)
    assert answer["fixed"] == {"omega": 0.5, "xi": 0.26}
    assert len(answer["values"]) == 111
    assert [len(cell) for cell in answer["flight_time"]] == [min(n, 64) for n in answer["flights"]]
    assert [len(cell) for cell in answer["takeoff_phase"]] == [min(n, 64) for n in answer["flights"]]


def test_figure_2s_modes(client: TestClient, figure_2: str):
    answer = get(client, f"{figure_2}/diagram")
    index = {round(gamma, 9): i for i, gamma in enumerate(answer["values"])}
    modes = {
        gamma: (answer["bounces"][index[gamma]], answer["periods"][index[gamma]]) for gamma in (1.5, 2.3, 3.6)
    }
    assert modes == {1.5: (1, 1), 2.3: (2, 2), 3.6: (1, 2)}
    assert answer["outcome"][index[5.0]] == 2
    threshold = get(client, "/v1/threshold", omega=0.5, xi=0.26)["data_vars"]["threshold"]["data"]
    for gamma, i in index.items():
        assert (answer["outcome"][i] == 3) == (gamma < threshold)
        assert answer["flights"][i] > 0 or gamma < threshold


@pytest.mark.parametrize("name", ["rigid", "soft"])
def test_diagrams_contain_the_reference_flights(client: TestClient, name: str):
    tolerance = {"rigid": 1e-9, "soft": 1e-8}[name]
    for cell in json.loads((GOLDEN / f"{name}.json").read_text()):
        model = {key: cell[key] for key in ("restitution", "penetration", "adhesive") if key in cell}
        point = {axis: cell[axis] for axis in ("gamma", "omega", "xi")}
        here = finished(client, {**point, "model": {"kind": name, **model}, "settle": 500, "observe": 40})
        flights = get(client, f"{here}/diagram", min_flight=0)["flight_time"][0][-len(cell["flights"]) :]
        assert sorted(flights) == pytest.approx(cell["flights"], abs=tolerance), point


def test_short_flights_do_not_count_unless_all_are_short(client: TestClient, figure_2: str):
    everything, long = get(client, f"{figure_2}/diagram"), get(client, f"{figure_2}/diagram", min_flight=5.0)
    assert long["flight_time"] == [[t for t in cell if t > 5] or cell for cell in everything["flight_time"]]
    assert (everything["min_flight"], long["min_flight"]) == (0.05, 5.0)
    assert [len(cell) for cell in long["takeoff_phase"]] == [len(cell) for cell in long["flight_time"]]
    assert long["flights"] == everything["flights"]


def test_results_before_the_job_is_done_are_incomplete(tmp_path: Path):
    held = Held()
    with service(tmp_path, held, active_jobs=1) as client:
        here = client.post("/v1/jobs", json=sweep().as_submitted()).headers["Location"]
        wait_for(lambda: held.held() == 4)
        held.let_go()
        wait_for(lambda: client.get(here).json()["progress"]["chunks_done"] == 1)
        half = get(client, f"{here}/diagram")
        assert half["complete"] is False
        assert 0 < half["outcome"].count(0) < 60
        assert all(
            cell == [] for cell, what in zip(half["flight_time"], half["outcome"], strict=True) if not what
        )
        assert client.get(f"{here}/diagram", params={"format": "png"}).headers["Bounce-Complete"] == "false"
        assert get(client, f"{here}/threshold")["attrs"]["complete"] is False
        queued = client.post("/v1/jobs", json=sweep(omega=0.6).as_submitted()).headers["Location"]
        nothing = get(client, f"{queued}/diagram")
        assert (nothing["complete"], nothing["outcome"]) == (False, [0] * 60)
        assert get(client, f"{queued}/threshold")["data_vars"]["up"]["data"] == [None]


def test_a_ramp_in_both_directions_shows_the_first_by_default(client: TestClient):
    ramp = {"kind": "ramp", "axis": "gamma", "direction": "both"}
    spec = {**FIGURE_2, "protocol": ramp, "gamma": {"start": 0.6, "stop": 1.4, "num": 9}, "settle": 20}
    here = finished(client, spec)
    assert get(client, f"{here}/diagram")["direction"] == "up"
    assert get(client, f"{here}/diagram", direction="down")["direction"] == "down"
    table = csv.DictReader(io.StringIO(client.get(f"{here}/diagram", params={"format": "csv"}).text))
    assert {row["direction"] for row in table} == {"up", "down"}


@pytest.mark.parametrize(
    ("format", "media_type"), [("csv", "text/csv"), ("png", "image/png"), ("svg", "image/svg+xml")]
)
def test_formats_of_a_diagram(client: TestClient, figure_2: str, format: str, media_type: str):
    answer = client.get(f"{figure_2}/diagram", params={"format": format})
    assert answer.status_code == 200
    assert answer.headers["Content-Type"].partition(";")[0] == media_type
    assert answer.headers["Bounce-Complete"] == "true"
    if format == "csv":
        assert len(list(csv.reader(io.StringIO(answer.text)))) > 1000
    elif format == "png":
        assert answer.content.startswith(PNG)
    else:
        assert ElementTree.fromstring(answer.text).tag.endswith("svg")


# Thresholds


# Operation


def test_health(tmp_path: Path):
    held = Held(capacity=0)
    with service(tmp_path, held) as client:
        assert get(client, "/healthz") == {"status": "ok"}
        answer = client.get("/readyz")
        assert (answer.status_code, answer.headers["Content-Type"]) == (503, "application/problem+json")
        assert int(answer.headers["Retry-After"]) > 0
        held.capacity = 1
        wait_for(lambda: client.get("/readyz").status_code == 200)


def test_the_api_document_defines_every_schema_it_refers_to(client: TestClient):
    document = get(client, "/openapi.json")
    assert {"/v1/jobs", "/v1/jobs/{job_id}/diagram", "/v1/threshold", "/readyz"} <= set(document["paths"])
    references = set(re.findall(r'"#/components/schemas/([^"]+)"', json.dumps(document)))
    assert references <= set(document["components"]["schemas"])
    assert "SweepSpec" in references


def test_every_endpoint_has_a_summary_and_a_description(client: TestClient):
    paths = get(client, "/openapi.json")["paths"]
    operations = [operation for methods in paths.values() for operation in methods.values()]
    assert len(operations) > 15
    for operation in operations:
        function = operation["summary"].lower().replace(" ", "_")  # FastAPI's default: the function's name
        assert not operation["operationId"].startswith(f"{function}_"), operation["summary"]
        assert operation["description"]


def test_the_page_of_endpoints_loads_nothing_from_other_hosts(client: TestClient):
    answer = client.get("/docs")
    assert answer.headers["Content-Type"].startswith("text/html")
    for path in get(client, "/openapi.json")["paths"]:
        assert path in answer.text
    assert not re.search(r"(src|href)=.?https?:|<script|@import", answer.text)
    assert "style-src 'self'" in answer.headers["Content-Security-Policy"]
    for text in ("POST /v1/jobs", "Fields of SweepSpec", "micro_flight", '"omega": [', "Fields of Ramp"):
        assert text in answer.text
