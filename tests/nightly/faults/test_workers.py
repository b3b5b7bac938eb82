"""Workers on a machine with nothing else to do: times, and a kernel that is compiled."""

import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from harm import fragile_cluster, pids, wait_until_ready
from scripted import costing, wait_for
from served import running

from service.ledger.model import JobState
from worker.executors.dask import Dask

PATIENCE = 180.0


@pytest.fixture(scope="module")
def fragile() -> Iterator[Dask]:
    with fragile_cluster() as executor:
        yield executor


def test_cancelling_does_not_wait_for_compilation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The kernel of exponents is not compiled at the start of a worker, and takes many seconds."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    with closing(Dask(workers=1, memory=2 << 30)) as executor:
        wait_for(lambda: executor.state().workers == 1, seconds=PATIENCE)
        worker = pids(executor, 1)
        with running(tmp_path, executor) as service:
            sweep = costing(exponents=3, protocol={"kind": "ramp", "axis": "gamma", "direction": "up"})
            job = service.submit(sweep)
            service.until(job, JobState.RUNNING)
            time.sleep(1.0)
            began = time.monotonic()
            service.manager.cancel(job.id)
            ended = service.until(job, JobState.CANCELLED)
            assert time.monotonic() - began < 5
            assert ended.chunks_done == 0
        assert pids(executor, 1) == worker  # which goes on compiling


def test_a_chunk_that_holds_the_interpreter_is_ended_too(tmp_path: Path, fragile: Dask):
    wait_until_ready(fragile)
    with running(tmp_path, fragile, chunk_seconds=2.0, chunk_tries=1) as service:
        job = service.until(service.submit(costing("freeze:1")), JobState.FAILED)
        assert job.chunks_done == job.chunks_total - 1
