"""Small jobs beside endless ones and beside many: the order in which they end, on a real cluster."""

import os
from contextlib import suppress
from pathlib import Path

import pytest
from scripted import Counting, costing, sweep, wait_for
from served import running

from service.errors import IllegalTransition
from service.ledger.model import JobState
from worker import store
from worker.executors.dask import Dask
from worker.executors.inline import Inline
from worker.sweep import SweepSpec

#: Eight cells, each a chunk that takes a worker the better part of a minute.
ENDLESS = {
    "one by one": {"model": {"kind": "soft"}, "exponents": 1, "gamma": {"start": 2.0, "stop": 5.0, "num": 8}},
    "in lanes": {"model": {"kind": "rigid"}, "gamma": {"start": 2.0, "stop": 5.0, "num": 128}},
}


def endless(kind: str) -> SweepSpec:
    return sweep("endless", **ENDLESS[kind], settle=10_000_000, observe=10_000_000)


def pids(executor: Dask) -> set[int]:
    return set(executor._connection.client.run(os.getpid).values())


@pytest.mark.parametrize("kind", ENDLESS)
def test_a_small_job_passes_endless_cells_and_these_can_be_cancelled(
    tmp_path: Path, cluster: Dask, kind: str
):
    """No cell ends before, and no worker process: chunks pause, and look at the cancel flag within a cell."""
    counting = Counting(cluster)
    with running(tmp_path, counting) as service:
        before = pids(cluster)
        job = service.submit(endless(kind))
        wait_for(lambda: counting.submitted >= 5)  # four were in flight: one has paused
        small = service.submit(sweep("small", gamma={"start": 0.5, "stop": 1.2, "num": 100}))
        service.until(small, JobState.DONE)
        assert service.job(job).chunks_done == 0
        service.manager.cancel(job.id)
        service.until(job, JobState.CANCELLED)
        assert service.job(job).chunks_done == 0
        assert pids(cluster) == before


def test_a_small_job_passes_many_of_one_client(tmp_path: Path, cluster: Dask):
    with running(tmp_path, cluster, active_jobs=4) as service:
        many = [service.submit(costing(f"{n}", omega=0.3 + n / 1000, seconds=0.5)) for n in range(40)]
        wait_for(lambda: service.job(many[0]).chunks_done > 0)
        small = service.submit(sweep("small"))
        service.until(small, JobState.DONE)
        assert sum(service.job(job).state is JobState.DONE for job in many) < 20
        for job in many:
            with suppress(IllegalTransition):  # it is done
                service.manager.cancel(job.id)


def test_long_cells_have_the_same_bytes_whoever_computes_their_slices(
    tmp_path: Path, cluster: Dask, inline: Inline
):
    """Each cell takes several slices; the service stops and starts while they are computed."""
    spec = sweep(
        gamma=[2.1, 3.3], omega=0.5, xi=0.05, settle=700_000, observe=700_000,
        protocol={"kind": "ramp", "axis": "gamma", "direction": "up"}, model={"kind": "soft"},
    )  # fmt: skip
    counting = Counting(cluster)
    with running(tmp_path / "cluster", counting) as service:
        job = service.submit(spec)
        wait_for(lambda: counting.submitted >= 3)
    with running(tmp_path / "cluster", counting) as service:
        found = service.until(job, JobState.DONE)
        assert counting.submitted > found.chunks_total + 1
        url = Path(service.settings.store_of(job.store))
        slices = [path for path in url.rglob("*") if path.is_file()]
        assert not [path for path in slices if path.name.startswith(".")]
    with running(tmp_path / "inline", inline) as service:
        whole = service.until(service.submit(spec), JobState.DONE)
        assert whole.id == found.id
        other = service.settings.store_of(whole.store)
        assert [store.read_key(other, str(path.relative_to(url))) for path in slices] == [
            path.read_bytes() for path in slices
        ]
