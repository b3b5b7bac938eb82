"""What a connection connects to: an address, a scheduler file, or a cluster that a function makes."""

import asyncio
import json
import logging
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from worker.executors import clusters
from worker.executors.base import ClusterLost
from worker.executors.clusters import MAKE_SECONDS, UNANSWERED, CreatedCluster, SchedulerFile


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time, which the test sets."""
    now = [1000.0]
    monkeypatch.setattr(clusters, "time", SimpleNamespace(monotonic=lambda: now[0], sleep=lambda _: None))
    return now


class Cluster:
    """As a cluster object of distributed's."""

    def __init__(self, workers: int = 2, status: Any = "running") -> None:
        self.plan = self.worker_spec = range(workers)
        self.workers = range(workers)
        self.status, self.closed, self.scheduler_address = status, 0, "tcp://a:1"

    def close(self) -> None:
        self.closed += 1


def test_a_scheduler_file_is_waited_for_at_first_and_read_each_time(
    tmp_path: Path, now: list[float], monkeypatch: pytest.MonkeyPatch
):
    file, contents = tmp_path / "scheduler.json", iter(['{"address": ', '{"address": "tcp://a:1"}'])

    def sleep(_: float) -> None:
        now[0] += 1.0
        file.write_text(next(contents))

    monkeypatch.setattr(clusters.time, "sleep", sleep)
    target = SchedulerFile(file, timeout=4.5)
    assert target.find() == "tcp://a:1"
    file.write_text(json.dumps({"address": "tcp://b:2"}))
    assert target.find() == "tcp://b:2"
    file.unlink()
    now[0] += 10.0
    with pytest.raises(ClusterLost, match="no scheduler has written its address to"):
        target.find()


def test_a_cluster_is_made_again_when_it_has_ended_or_its_scheduler_does_not_answer(now: list[float]):
    """Several times in a row; those of the cluster before do not count."""
    made: list[Cluster] = []

    def make() -> Cluster:
        made.append(Cluster(len(made) + 1))
        return made[-1]

    target = CreatedCluster(make, "mine")
    target.unanswered()
    assert target.planned() is None
    assert target.find() is target.find() is made[0]
    for _ in range(UNANSWERED - 1):
        target.unanswered()
    assert (target.planned(), made[0].closed) == (1, 0)
    made[0].status = SimpleNamespace(name="closing")
    with pytest.raises(ClusterLost, match=r"no cluster from mine; made again in 10 s"):
        target.find()
    assert made[0].closed == 1
    now[0] += MAKE_SECONDS
    assert target.find() is made[1]
    for _ in range(UNANSWERED - 1):
        target.unanswered()
    assert (target.planned(), made[1].closed) == (2, 0)
    target.unanswered()
    assert made[1].closed == 1
    now[0] += MAKE_SECONDS
    assert target.find() is made[2]
    target.close()
    target.close()
    assert (target.planned(), made[2].closed) == (None, 1)


def test_a_function_that_returns_no_cluster_is_told_so():
    target = CreatedCluster(lambda: None, "mine")
    with pytest.raises(ClusterLost, match="no cluster from mine: TypeError: it returns no Dask cluster, but"):
        target.find()


def test_the_reason_of_a_function_that_fails_is_one_line():
    """Those of batch queues have many."""

    def submit() -> None:
        raise RuntimeError("the queue is closed\nstdout:\n\nstderr:\ncome back")

    with pytest.raises(ClusterLost) as failed:
        CreatedCluster(submit, "mine").find()
    assert str(failed.value) == (
        "no cluster from mine: RuntimeError: the queue is closed stdout: stderr: come back"
    )


@pytest.mark.parametrize(("planned", "present", "is_busy", "lost"), [
    ((0, 1), (0,), False, "1 of 2"),
    ((0, 1), (), True, None),
    ((), (0,), False, None),
    ((1,), (0,), False, "1 of 1"),
])  # fmt: skip
def test_only_workers_that_are_gone_are_called_lost(
    planned: tuple[int, ...],
    present: tuple[int, ...],
    is_busy: bool,
    lost: str | None,
    caplog: pytest.LogCaptureFixture,
):
    """Neither those that the cluster is starting, nor those that it should no longer have."""

    class Growing:
        def __init__(self) -> None:
            self.worker_spec, self.workers = dict.fromkeys(planned), dict.fromkeys(present)
            self._lock = asyncio.Lock()

        def __await__(self) -> Iterator[None]:
            yield from ()

    async def refill() -> None:
        cluster = Growing()
        if is_busy:
            await cluster._lock.acquire()
        await clusters._start_missing(cluster)

    with caplog.at_level(logging.WARNING, clusters.__name__):
        asyncio.run(refill())
    messages = [f"{lost} workers are lost; starting others"] if lost else []
    assert caplog.messages == messages


@pytest.mark.skipif(not hasattr(os, "memfd_create"), reason="needs Linux")
def test_the_certificate_of_local_workers_is_in_no_file_for_a_killed_process_to_leave(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    security = clusters._AtAnyTime.temporary()  # type: ignore[no-untyped-call]
    for role in ("scheduler", "worker", "client"):
        assert security.get_connection_args(role)["ssl_context"] is not None
