"""A worker that fails what others compute: retries go elsewhere, and it gets nothing for a while."""

import errno
import socket
from pathlib import Path
from typing import Any

import pytest
from harm import leave
from paths import CACHE
from running import costing, running
from scripted import wait_for

from service.jobs.model import JobState
from worker import store, watchdog
from worker.executors import dask
from worker.executors.dask import Dask
from worker.executors.errors import WorkerLeft
from worker.executors.quarantine import MARKS, Quarantine
from worker.kernel_cache import use_cache
from worker.plan import make_plan
from worker.schema import layout

PATIENCE = 240.0


def break_disk() -> None:
    """Every chunk of this process fails from now on, as on a machine whose disk is broken."""

    def broken(*_: Any) -> None:
        raise OSError(errno.EIO, "Input/output error")

    watchdog.run_task = broken


def test_one_of_two_workers_fails_everything(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
):
    use_cache(CACHE)
    monkeypatch.setattr(dask, "REST_SECONDS", 5.0)
    executor = Dask(workers=2, kernel_cache=CACHE)
    try:
        wait_for(lambda: executor.workers() == 2, seconds=PATIENCE)
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
        assert MARKS <= len(failures) < ended.chunks_total
        rested = [message for message in caplog.messages if "gets none for 5 s" in message]
        assert rested
        assert all(f"worker {bad} on " in message for message in rested)
    finally:
        executor.close()


def test_a_retry_does_not_wait_for_workers_that_are_gone(tmp_path: Path):
    use_cache(CACHE)
    executor = Dask(workers=2, kernel_cache=CACHE)
    try:
        wait_for(lambda: executor.workers() == 2, seconds=PATIENCE)
        first, second = sorted(executor._connection.client.scheduler_info()["workers"])
        spec, url = costing(chunks=1), str(tmp_path / "sweep.zarr")
        plan = make_plan(spec)
        store.create(url, layout(spec, plan.chunk_shape))
        executor._quarantine.failed((url, 0), first)
        executor._connection.client.run(leave, workers=[second], on_error="ignore")
        try:
            report = executor.submit(spec, plan[0], url).result(PATIENCE)
        except WorkerLeft:
            report = executor.submit(spec, plan[0], url).result(PATIENCE)
        assert report.index == 0
    finally:
        executor.close()


def test_a_chunk_that_fails_everywhere_is_a_mark_against_nobody():
    quarantine = Quarantine()
    for worker in ("a", "b", "c"):
        quarantine.failed("chunk", worker)
    assert quarantine.failed_on("chunk") == {"a", "b", "c"}
    assert quarantine.failed_on("other") == frozenset()


def test_marks_in_a_row_lead_to_a_rest():
    quarantine = Quarantine()
    for chunk in range(MARKS):
        quarantine.failed(chunk, "bad")
    assert [quarantine.computed(chunk, "good") for chunk in range(MARKS)] == [[], [], ["bad"]]
    assert quarantine.failed_on(0) == frozenset()


def test_a_chunk_computed_clears_the_marks():
    quarantine = Quarantine()
    for chunk in range(2 * MARKS):
        quarantine.failed(chunk, "unlucky")
        assert quarantine.computed(chunk, "good") == []
        assert quarantine.computed("another", "unlucky") == []
