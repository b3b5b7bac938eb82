"""Workers with a lifetime of three times their start."""

import os
import time
from pathlib import Path

import pytest
from blame import blamed, noting_errors
from dask_processes import dask_processes
from paths import CACHE
from running import costing, running
from scripted import wait_for

from service.jobs.model import JobState
from worker.executors.dask import Dask
from worker.kernel_cache import warm

PATIENCE = 240.0

#: The shortest lifetime of a worker (s), and how many times as long as its start it is at least.
LIFETIME, STARTS = 5.0, 3.0


@pytest.fixture
def errors(monkeypatch: pytest.MonkeyPatch) -> list[BaseException]:
    """What chunks came back with, of all jobs of the test."""
    warm(CACHE)
    return noting_errors(monkeypatch)


@pytest.mark.timeout(700)
def test_workers_with_a_short_lifetime_finish_a_job(tmp_path: Path, errors: list[BaseException]):
    with dask_processes(tmp_path / "dask") as processes:
        executor = Dask(processes.address, timeout=60)
        try:
            began = time.monotonic()
            first = processes.worker()
            executor.call(os.getpid).result(PATIENCE)
            lifetime = max(LIFETIME, STARTS * (time.monotonic() - began))
            first.terminate()
            wait_for(lambda: executor.workers() == 0, seconds=60)
            for _ in range(2):
                processes.worker("--lifetime", f"{lifetime:.0f}s", "--lifetime-restart")
            with running(tmp_path / "data", executor) as service:
                job = service.submit(costing(chunks=100, seconds=0.3))
                wait_for(
                    lambda: service.job(job).state is JobState.DONE,
                    lambda: f"{service.job(job)}\n{processes.log()}",
                    600,
                )
                ended = service.job(job)
        finally:
            executor.close()
        assert "worker-lifetime-reached" in processes.log()
    assert ended.chunks_done == ended.chunks_total
    assert blamed(errors) == []
