"""Multistability as a job: attractors matched over a plane, over HTTP, in the client and as pictures."""

import csv
import io
from collections.abc import Iterator
from io import BytesIO
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from matplotlib import image
from served import computing, get

from service.api import schemas
from service.client import BadRequest, Client, Job
from service.results.multistability import _joined

SPEC: dict[str, Any] = {
    "name": "Fig. 2", "gamma": [3.56, 3.58, 3.6, 3.62, 3.64], "omega": [0.5, 0.502], "xi": 0.26,
    "model": {"kind": "rigid"}, "protocol": {"kind": "multistability"}, "settle": 300, "observe": 60,
}  # fmt: skip
#: Two attractors in every cell; one grazes, which changes its mode: tests/worker/test_multistability.py.
MODES = [["aperiodic", "(3,4)", "(3,4)", "(4,4)", "(2,2)"], ["(1,2)"] * 5]


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    with computing(tmp_path_factory.mktemp("data")) as client:
        yield client


@pytest.fixture(scope="module")
def client(service: TestClient) -> Client:
    return Client("http://localhost", http=service)


@pytest.fixture(scope="module")
def job(client: Client) -> Job:
    return client.submit(SPEC).wait(progress=False)


def test_one_attractor_has_one_id_in_all_cells(service: TestClient, job: Job):
    answer = get(service, f"/v1/jobs/{job.id}/multistability")
    assert set(answer) == set(schemas.MultistabilityView.model_fields)
    assert answer["complete"]
    assert answer["count"] == [[2] * 5] * 2
    assert (answer["several"], answer["several_by_drops"]) == (1.0, 1.0)
    assert [(a["id"], a["cells"]) for a in answer["attractors"]] == [(1, 10), (2, 10)]
    assert {tuple(sorted(place["id"] for place in cell)) for line in answer["cells"] for cell in line} == {
        (1, 2)
    }
    line = answer["cells"][0]
    labels = [[next(p["label"] for p in cell if p["id"] == number) for cell in line] for number in (1, 2)]
    assert sorted(labels) == sorted(MODES)


def test_changes_of_mode_are_events(service: TestClient, job: Job):
    answer = get(service, f"/v1/jobs/{job.id}/multistability", omega=0.5)
    assert answer["omega"] == [0.5]
    assert len(answer["count"]) == 1
    assert {event["kind"] for event in answer["events"]} == {"mode"}
    changes = [(e["gamma_below"], e["gamma_above"], e["below"], e["above"]) for e in answer["events"]]
    expected = MODES[0]
    assert changes == [
        (3.56, 3.58, expected[0], expected[1]),
        (3.6, 3.62, expected[2], expected[3]),
        (3.62, 3.64, expected[3], expected[4]),
    ]


def test_a_birth_is_told_with_the_attractor_that_it_leads_to(service: TestClient, client: Client):
    """(1,1) at omega 0.6, xi 0.05 begins in a fold at gamma 0.5532; below, its springs come to rest."""
    gamma = [0.52, 0.54, 0.56, 0.58]
    job = client.submit(SPEC | {"gamma": gamma, "omega": 0.6, "xi": 0.05, "settle": 1500}).wait(
        progress=False
    )
    answer = get(service, f"/v1/jobs/{job.id}/multistability")
    assert answer["count"] == [[1, 1, 2, 2]]
    (event,) = answer["events"]
    rest = next(a["id"] for a in answer["attractors"] if a["label"] == "rest")
    assert event == {
        "kind": "birth", "attractor": 3 - rest, "omega": 0.6, "gamma_below": 0.54, "gamma_above": 0.56,
        "below": None, "above": "(1,1)", "leads_to": rest,
    }  # fmt: skip


def test_in_the_client(job: Job):
    found = job.multistability()
    assert found["count"].dims == ("omega", "gamma")
    assert (found["count"].values == 2).all()
    assert found.id.dims == ("omega", "gamma", "place")
    assert (np.sort(found.id.values, axis=-1) == [1, 2]).all()
    assert found.cells.values.tolist() == [10, 10]
    assert found.attrs["several"] == found.attrs["complete"] == 1.0
    stored = job.open().load()
    assert (stored.attractor_count.squeeze().values == 2).all()
    assert job.multistability(omega=0.5).sizes["omega"] == 1


@pytest.mark.parametrize("omega", [None, 0.5])
def test_as_a_picture(job: Job, omega: float | None):
    picture = job.multistability_picture(omega=omega)
    assert picture == job.multistability_picture(omega=omega)
    pixels = image.imread(BytesIO(picture))
    colours = {tuple(row) for row in (pixels[..., :3] * 255).round().astype(int).reshape(-1, 3)}
    assert (0, 0x72, 0xB2) in colours


def test_what_is_refused(service: TestClient, client: Client, job: Job):
    with pytest.raises(BadRequest, match="xi: must be within"):
        job.multistability(0.5)
    with pytest.raises(BadRequest, match="omega: must be within"):
        job.multistability(omega=0.7)
    with pytest.raises(
        BadRequest, match="must be a job with the protocol basin; that of this job is multist"
    ):
        job.basins()
    answer = service.get(f"/v1/jobs/{job.id}/threshold")
    assert answer.status_code == 422
    assert "must be a sweep; the protocol of this job is multistability" in answer.json()["detail"]
    for query, rule in (
        ({"along": "omega", "gamma": 3.6}, "along: must be gamma"),
        ({"omega": 0.5, "every": 2}, "every: is not for a job of multistability"),
        ({"along": "gamma"}, "omega: is required"),
    ):
        answer = service.get(f"/v1/jobs/{job.id}/diagram", params=query)
        assert answer.status_code == 422
        assert rule in answer.json()["detail"]


def test_the_diagram_shows_all_coexisting_attractors(service: TestClient, job: Job):
    line = get(service, f"/v1/jobs/{job.id}/diagram", omega=0.5)
    assert line == get(service, f"/v1/jobs/{job.id}/multistability", omega=0.5)
    for cell in line["cells"][0]:
        longest = {place["label"]: max(place["flight_time"]) for place in cell}
        assert longest["(1,2)"] == pytest.approx(11.24, abs=0.1)
        assert all(max(p["flight_time"]) == pytest.approx(p["longest_flight"], abs=0.2) for p in cell)
    found = job.diagram(omega=0.5)
    assert found.flight_time.dims == ("omega", "gamma", "place", "flight")
    first = found.flight_time.isel(omega=0, gamma=0, place=0).dropna("flight").values.tolist()
    assert first == line["cells"][0][0][0]["flight_time"]
    table = service.get(f"/v1/jobs/{job.id}/diagram", params={"omega": 0.5, "format": "csv"}).text
    rows = list(csv.DictReader(io.StringIO(table)))
    assert len(rows) == sum(len(p["flight_time"]) for cell in line["cells"][0] for p in cell)
    assert [float(row["flight_time_rad"]) for row in rows[: len(first)]] == first
    assert {row["attractor"] for row in rows} == {"1", "2"}
    plane = job.multistability_picture("csv").decode()
    assert len(plane.splitlines()) == 1 + 2 * 5 * 2
    assert job.picture(omega=0.5) == job.multistability_picture(omega=0.5)


def test_the_motion_on_an_attractor(service: TestClient, job: Job):
    cell = get(service, f"/v1/jobs/{job.id}/diagram", omega=0.5)["cells"][0][2]
    for number, place in enumerate(cell, 1):
        query = {"gamma": 3.6, "omega": 0.5, "periods": 16, "attractor": number}
        motion = get(service, f"/v1/jobs/{job.id}/trajectory", **query)
        flights = [time for time in motion["flights"]["flight_time"] if time > 0.05]
        assert max(flights) == pytest.approx(place["longest_flight"], abs=1e-6)
    for attractor, rule in ((3, "attractor: must be from 1 to 2"), (0, "attractor")):
        query = {"gamma": 3.6, "omega": 0.5, "attractor": attractor}
        answer = service.get(f"/v1/jobs/{job.id}/trajectory", params=query)
        assert answer.status_code == 422
        assert rule in answer.text


def test_branches_join_by_most_votes_unless_they_share_a_cell():
    """Three lines of two cells: 0 is beside 1 in the first cell; 2 is near both, more often to 1."""
    branch = np.array([[[0, 1], [1, -1]], [[2, -1], [2, -1]], [[3, -1], [4, -1]]])
    owner = _joined(branch, {(0, 2): 1, (1, 2): 2, (2, 3): 1, (2, 4): 1})
    assert owner.tolist() == [0, 1, 1, 1, 1]
    assert _joined(branch, {}).tolist() == [0, 1, 2, 3, 4]
    assert _joined(branch, {(0, 2): 3, (1, 2): 2}).tolist() == [0, 1, 0, 3, 4]
