"""A model chosen on a cluster."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from scripted import wait_for
from served import service

from worker.executors.dask import Dask
from worker.executors.inline import Inline

SWEEP: dict[str, Any] = {
    "name": "auto",
    "gamma": {"start": 0.5, "stop": 5.0, "num": 46},
    "omega": 0.5,
    "xi": 0.26,
    "model": {"kind": "auto", "tolerance": 1e-3, "restitution": 0.0, "penetration": 1e-6},
    "keep": 8,
}


def ended(client: TestClient, spec: dict[str, Any] = SWEEP) -> dict[str, Any]:
    """The job, finished."""
    here = client.post("/v1/jobs", json=spec).headers["Location"]
    wait_for(lambda: client.get(here).json()["state"] not in ("queued", "running"))
    return client.get(here).json()


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[TestClient, dict[str, Any], Path]]:
    folder = tmp_path_factory.mktemp("auto")
    with closing(Inline()) as executor, service(folder, executor) as client:
        yield client, ended(client), folder


def files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_the_same_sweep_gives_the_same_bytes_on_a_cluster(done, tmp_path: Path, cluster: Dask):
    _, job, folder = done
    with service(tmp_path, cluster) as client:
        assert ended(client)["choice"]["reason"] == job["choice"]["reason"]
    path = Path("stores") / f"{job['id']}.zarr"
    assert files(tmp_path / path) == files(folder / path)
