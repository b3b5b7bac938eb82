"""Workers with a lifetime of three times their start."""

import os
import time
from pathlib import Path

import pytest
from blame import blamed, noting_errors
from dask_processes import dask_processes
from paths import CACHE
from scripted import wait_for
from served import running

from worker.executors.dask import Dask
from worker.kernel_cache import use_cache

PATIENCE = 240.0

#: The shortest lifetime of a worker (s), and how many times as long as its start it is at least.
LIFETIME, STARTS = 5.0, 3.0


@pytest.fixture
def errors(monkeypatch: pytest.MonkeyPatch) -> list[BaseException]:
    """What chunks came back with, of all jobs of the test."""
    use_cache(CACHE)
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
                ended = service.jobs_until(
                    lambda: processes.has_logged("worker-lifetime-reached"),
                    chunks=100,
                    seconds=0.3,
                    patience=600,
                )
        finally:
            executor.close()
    assert all(job.chunks_done == job.chunks_total for job in ended)
    assert blamed(errors) == []
