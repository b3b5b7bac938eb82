"""A worker that fails what others compute: retries go elsewhere."""

import errno
import socket
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from chunks import planned
from harm import leave
from scripted import costing, wait_for
from served import running

from service.ledger.model import JobState
from worker import watchdog
from worker.executors.base import WorkerLeft
from worker.executors.dask import Dask
from worker.kernel_cache import use_cache

PATIENCE = 240.0


def break_disk() -> None:
    """Every chunk of this process fails from now on, as on a machine whose disk is broken."""

    def broken(*_: Any) -> None:
        raise OSError(errno.EIO, "Input/output error")

    watchdog.run_task = broken


def test_one_of_two_workers_fails_everything(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    use_cache()
    with closing(Dask(workers=2)) as executor:
        wait_for(lambda: executor.state().workers == 2, seconds=PATIENCE)
        client = executor._connection.client
        bad = sorted(client.scheduler_info()["workers"])[0]
        client.run(break_disk, workers=[bad])
        with running(tmp_path, executor, chunk_tries=2) as service:
            job = service.submit(costing(chunks=60, seconds=0.1))
            ended = service.until(job, JobState.DONE, JobState.FAILED, seconds=PATIENCE)
            assert (ended.state, ended.error) == (JobState.DONE, None)
            assert ended.chunks_done == ended.chunks_total
        failures = [message for message in caplog.messages if "Input/output error" in message]
        assert all(f"worker {bad} on {socket.gethostname()}" in message for message in failures)
        assert 1 <= len(failures) <= ended.chunks_total


def test_a_retry_does_not_wait_for_workers_that_are_gone(tmp_path: Path):
    use_cache()
    with closing(Dask(workers=2)) as executor:
        wait_for(lambda: executor.state().workers == 2, seconds=PATIENCE)
        first, second = sorted(executor._connection.client.scheduler_info()["workers"])
        spec, url = costing(chunks=1), str(tmp_path / "sweep.zarr")
        plan = planned(url, spec)
        executor._roster.failed((url, 0), first)
        executor._connection.client.run(leave, workers=[second], on_error="ignore")
        futures = [executor.submit(spec, plan[0], url)]

        def computed() -> bool:
            """As the service does: asks for the state, and submits again."""
            if executor.state().connected and futures[-1].done():
                if not isinstance(futures[-1].exception(), WorkerLeft):
                    return True
                futures.append(executor.submit(spec, plan[0], url))
            return False

        wait_for(computed, seconds=PATIENCE)
        assert futures[-1].result().index == 0
