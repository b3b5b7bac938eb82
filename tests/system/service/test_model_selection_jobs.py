"""A model chosen on a cluster."""

from pathlib import Path
from typing import Any

from fastapi.testclient import TestClient
from served import computing, finished, get, service

from worker.executors.dask import Dask

SWEEP: dict[str, Any] = {
    "name": "auto",
    "gamma": {"start": 0.5, "stop": 5.0, "num": 46},
    "omega": 0.5,
    "xi": 0.26,
    "model": {"kind": "auto", "tolerance": 1e-3, "restitution": 0.0, "penetration": 1e-6},
    "keep": 8,
}


def ended(client: TestClient) -> dict[str, Any]:
    """The job, finished."""
    return dict(get(client, finished(client, SWEEP)))


def files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_the_same_sweep_gives_the_same_bytes_on_a_cluster(tmp_path: Path, cluster: Dask):
    with computing(tmp_path / "inline") as client:
        job = ended(client)
    with service(tmp_path / "cluster", cluster) as client:
        assert ended(client)["choice"]["reason"] == job["choice"]["reason"]
    path = Path("stores") / f"{job['id']}.zarr"
    assert files(tmp_path / "cluster" / path) == files(tmp_path / "inline" / path)
