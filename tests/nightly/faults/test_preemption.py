"""Workers with a lifetime of three times their start."""

import os
import time
from contextlib import closing
from pathlib import Path

import pytest
from blame import blamed, noting_errors
from dask_processes import dask_processes
from scripted import wait_for
from served import running

from worker.executors.dask import Dask
from worker.kernel_cache import use_cache

PATIENCE = 240.0

#: The shortest lifetime of a worker (s), and how many times as long as its start it is at least.
LIFETIME, STARTS = 5.0, 3.0


@pytest.mark.timeout(700)
def test_workers_with_a_short_lifetime_finish_a_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    use_cache()
    errors = noting_errors(monkeypatch)  # of all its chunks
    with (
        dask_processes(tmp_path / "dask") as processes,
        closing(Dask(processes.address, timeout=60)) as executor,
    ):
        began = time.monotonic()
        first = processes.worker()
        executor.call(os.getpid).result(PATIENCE)
        lifetime = max(LIFETIME, STARTS * (time.monotonic() - began))
        first.terminate()
        wait_for(lambda: executor.state().workers == 0, seconds=60)
        for _ in range(2):
            processes.worker("--lifetime", f"{lifetime:.0f}s", "--lifetime-restart")
        reached = "worker-lifetime-reached"
        with running(tmp_path / "data", executor) as service:
            ended = service.jobs_until(
                lambda: processes.has_logged(reached), chunks=100, seconds=0.3, patience=600
            )
    assert all(job.chunks_done == job.chunks_total for job in ended)
    assert blamed(errors) == []
