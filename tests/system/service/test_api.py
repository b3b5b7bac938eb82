"""A sweep through REST on two Dask workers."""

from contextlib import closing
from pathlib import Path

import pytest
from scripted import wait_for
from served import FIGURE_2, computing, finished, get, service
from stores import files, store_in

from worker.executors.dask import Dask

#: Whose model is chosen for each sweep.
AUTO = FIGURE_2 | {"model": {"kind": "auto", "tolerance": 1e-3, "restitution": 0.0, "penetration": 1e-6}}


@pytest.mark.essential
def test_the_same_sweep_gives_the_same_bytes_on_a_cluster(tmp_path: Path):
    """The cluster ends with it: idle workers compile what other tests may never need."""
    with (
        closing(Dask(workers=2)) as cluster,
        computing(tmp_path / "inline") as here,
        service(tmp_path / "cluster", cluster) as there,
    ):
        jobs = [get(client, finished(client, AUTO)) for client in (here, there)]
        wait_for(lambda: there.get("/readyz").json() == {"status": "ok"})
    assert jobs[0]["choice"]["reason"] == jobs[1]["choice"]["reason"]
    stores = [store_in(tmp_path / name, jobs[0]["id"]) for name in ("inline", "cluster")]
    assert files(stores[0]) == files(stores[1])
