"""Sweeps through REST on two Dask workers."""

import os
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import psutil
import pytest
from paths import CACHE
from scripted import wait_for
from served import FIGURE_2, computing, finished, get, service
from stores import files, store_in

from worker.executors.dask import Dask


@pytest.fixture(scope="module")
def cluster() -> Iterator[Dask]:
    """Ends with this module: idle workers compile what other tests may never need."""
    with closing(Dask(workers=2, kernel_cache=CACHE)) as executor:
        yield executor


#: Whose model is chosen for each sweep.
AUTO = FIGURE_2 | {"model": {"kind": "auto", "tolerance": 1e-3, "restitution": 0.0, "penetration": 1e-6}}


@pytest.mark.essential
def test_the_same_sweep_gives_the_same_bytes_on_a_cluster(tmp_path: Path, cluster: Dask):
    with computing(tmp_path / "inline") as here, service(tmp_path / "cluster", cluster) as there:
        jobs = [get(client, finished(client, AUTO)) for client in (here, there)]
        wait_for(lambda: there.get("/readyz").json() == {"status": "ok"})
    assert jobs[0]["choice"]["reason"] == jobs[1]["choice"]["reason"]
    stores = [store_in(tmp_path / name, jobs[0]["id"]) for name in ("inline", "cluster")]
    assert files(stores[0]) == files(stores[1])


def test_figure_2_takes_less_than_five_core_seconds_on_a_warm_cluster(tmp_path: Path, cluster: Dask):
    """CPU time of the workers; for wall-clock time on a quiet machine, run `python -m benchmarks.small`."""
    pids = cluster._connection.client.run(os.getpid).values()

    def spent() -> float:
        return sum(sum(psutil.Process(pid).cpu_times()[:2]) for pid in pids)

    with service(tmp_path, cluster) as client:
        finished(client, {**FIGURE_2, "gamma": 1.5})
        for kind in ("rigid", "soft"):
            gamma = {"start": 1.0, "stop": 6.0, "num": 1000}
            before = spent()
            finished(client, {**FIGURE_2, "gamma": gamma, "model": {"kind": kind}})
            assert spent() - before < 5
