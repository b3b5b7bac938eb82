"""Basins as a job: over HTTP, in the client, as a picture, and on the command line."""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from matplotlib import image
from served import computing, get, occupied

from service.api import schemas
from service.client import BadRequest, Client, Job

SPEC: dict[str, Any] = {
    "name": "drops", "gamma": [0.6, 1.27], "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"},
    "protocol": {"kind": "basin", "rows": 16, "columns": 24}, "settle": 200, "exponents": 1,
}  # fmt: skip
#: The two cycles (1,1) at Gamma = 1.27, Omega = 0.5, xi = 0.26: tests/unit/worker/test_basins.py.
FLIGHTS = [4.631301, 3.374643]


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


def test_the_basin_of_a_cell(service: TestClient, job: Job):
    answer = get(service, f"/v1/jobs/{job.id}/basins", gamma=1.25)
    assert set(answer) == set(schemas.BasinView.model_fields)
    assert (answer["gamma"], answer["omega"], answer["xi"]) == (1.27, 0.5, 0.26)
    assert [a["id"] for a in answer["attractors"]] == [1, 2]
    assert [round(a["longest_flight"], 6) for a in answer["attractors"]] == FLIGHTS
    assert {a["label"] for a in answer["attractors"]} == {"(1,1)"}
    assert all(set(a) == set(schemas.AttractorView.model_fields) for a in answer["attractors"])
    assert all(a["lifetime"] is None and a["lyapunov"][0] < -0.1 for a in answer["attractors"])
    ids = np.array(answer["map"])
    assert ids.shape == (16, 24) == (len(answer["rows"]), len(answer["columns"]))
    assert [float((ids == a["id"]).mean()) for a in answer["attractors"]] == [
        a["fraction"] for a in answer["attractors"]
    ]
    assert answer["complete"]
    assert answer["undecided"] == 0.0
    assert 0.0 < answer["basin_entropy"] <= answer["boundary_entropy"] < np.log(2.0)


def test_a_cell_that_is_not_computed_yet_is_not_complete(tmp_path: Path):
    with occupied(tmp_path) as service:
        job = service.post("/v1/jobs", json=SPEC).json()
        answer = get(service, f"/v1/jobs/{job['id']}/basins", gamma=1.25)
        assert (answer["complete"], answer["attractors"]) == (False, [])


def test_rest_is_an_attractor(service: TestClient, job: Job):
    answer = get(service, f"/v1/jobs/{job.id}/basins", gamma=0.6)
    assert [(a["label"], a["outcome"], a["fraction"]) for a in answer["attractors"]] == [("rest", 3, 1.0)]
    assert answer["attractors"][0]["flight_time"] == []
    assert answer["boundary_entropy"] == 0.0


def test_in_the_client(client: Client, job: Job):
    found = job.basins(1.27)
    assert found.attractor.dims == ("row", "column")
    assert found.label.values.tolist() == ["(1,1)", "(1,1)"]
    assert np.round(found.longest_flight.values, 6).tolist() == FLIGHTS
    assert np.isinf(found.lifetime.values).all()
    assert found.attrs["complete"] == 1
    np.testing.assert_allclose(found.row.values, (np.arange(16) + 0.5) * 10.0 / 16)
    stored = job.open().load()
    assert stored.attractor.dims == ("xi", "omega", "gamma", "row", "column")
    assert (stored.attractor.sel(gamma=1.27).squeeze().values == found.attractor.values).all()
    assert stored.fraction.sel(gamma=1.27, id=1).item() == found.fraction.values[0]
    assert client.submit(SPEC | {"name": "the same"}).id == job.id


@pytest.mark.parametrize("format", ["png", "svg"])
def test_as_a_picture(job: Job, format: Any):
    picture = job.basin_picture(format, gamma=1.27)
    assert picture == job.basin_picture(format, gamma=1.27)
    if format == "png":
        pixels = image.imread(BytesIO(picture))
        colours = {tuple(row) for row in (pixels[..., :3] * 255).round().astype(int).reshape(-1, 3)}
        assert {(0, 0x72, 0xB2), (0xE6, 0x9F, 0)} <= colours
    else:
        assert b"(1,1)" in picture or b"<path" in picture


def test_what_is_refused(service: TestClient, client: Client, job: Job):
    with pytest.raises(BadRequest, match="gamma: is required"):
        job.basins()
    with pytest.raises(BadRequest, match="gamma: must be within"):
        job.basins(5.0)
    sweep = client.submit({"gamma": 1.2, "omega": 0.5, "xi": 0.26, "settle": 1, "observe": 1}).wait(
        progress=False
    )
    with pytest.raises(BadRequest, match="must be a job with the protocol basin; that of this job is rest"):
        sweep.basins()
    answer = service.get(f"/v1/jobs/{job.id}/diagram", params={"along": "gamma"})
    assert answer.status_code == 422
    assert "must be a sweep; the protocol of this job is basin" in answer.json()["detail"]
    answer = service.post("/v1/jobs", json=SPEC | {"protocol": {"kind": "basin", "rows": 10**6}})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "protocol.rows"
