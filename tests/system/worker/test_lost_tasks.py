"""Tasks on a cluster that end without a result: who is to blame, and where they are tried again."""

import asyncio
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import pytest
from distributed import KilledWorker
from scripted import DEADLINE, wait_for

from worker.executors.dask import Dask, _lacks_project, _Task
from worker.executors.errors import ClusterLost, WorkerDied, WorkerLeft, WorkerLost


class Client:
    """A client, as far as the executor looks at it here."""


@pytest.fixture
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    loop = asyncio.new_event_loop()
    yield loop
    loop.close()


def workers_of(cluster: Dask) -> list[str]:
    wait_for(lambda: cluster.workers() == 2)
    return sorted(cluster._connection.threads_of())


def killed(address: str) -> KilledWorker:
    worker: Any = SimpleNamespace(address=address)
    return KilledWorker("a task", worker, 0)


@pytest.mark.parametrize(
    ("chunk", "began_on", "kind", "message"),
    [
        (("url", 0), "tcp://a", WorkerDied, "the worker process that computed it died"),
        (("url", 0), "tcp://b", WorkerLost, "the worker process at which it waited died"),
        (("url", 0), None, WorkerLost, "the worker process at which it waited died"),
        (None, None, WorkerDied, "the worker process that computed it died"),
    ],
)
def test_the_task_that_a_worker_computed_is_to_blame_for_its_death(
    cluster: Dask, loop: asyncio.AbstractEventLoop, chunk: Any, began_on: str | None, kind: type, message: str
):
    task = _Task(loop.create_future(), chunk, began_on)
    error = cluster._executor_error(task, killed("tcp://a"))
    assert (type(error), str(error)) == (kind, message)


def test_a_worker_that_was_told_to_leave_and_one_that_was_terminated_say_so(
    cluster: Dask, loop: asyncio.AbstractEventLoop
):
    cluster._roster.note({"worker": "tcp://left", "host": "there", "process": 1, "leaving": True})
    task = _Task(loop.create_future(), ("url", 0), "tcp://left")
    error = cluster._executor_error(task, killed("tcp://left"))
    assert isinstance(error, WorkerLeft)
    assert str(error) == "the worker tcp://left on there was told to leave"
    task.termination.set_result("it took too long")
    error = cluster._executor_error(task, killed("tcp://left"))
    assert isinstance(error, WorkerDied)
    assert str(error) == "it took too long"


def test_what_workers_tell_of_a_task_is_kept_with_it(cluster: Dask, loop: asyncio.AbstractEventLoop):
    cluster._tasks["a key"] = task = _Task(loop.create_future(), ("url", 0))
    try:
        cluster._on_event({"key": "another", "worker": "tcp://a"})
        assert task.worker is None
        cluster._on_event({"key": "a key", "worker": "tcp://a"})
        assert (task.worker, task.termination.done()) == ("tcp://a", False)
        for why in ("too long", "too much memory"):
            cluster._on_event({"key": "a key", "worker": "tcp://b", "why": why})
        assert (task.worker, task.termination.result()) == ("tcp://b", "too long")
    finally:
        del cluster._tasks["a key"]


def test_a_chunk_is_tried_again_where_it_has_not_failed(cluster: Dask, loop: asyncio.AbstractEventLoop):
    first, second = workers_of(cluster)
    chunk = ("a store of this test", 5)
    assert cluster._others(chunk) is None
    for worker, others in ((first, [second]), (second, None)):
        error = ValueError("no")
        cluster._on_failed(_Task(loop.create_future(), chunk, worker), error)
        [note] = error.__notes__
        assert note.startswith(f"worker {worker}")
        assert cluster._others(chunk) == others
    cluster._on_computed(_Task(loop.create_future(), chunk, first))
    assert cluster._others(chunk) is None


def test_nobody_is_noted_for_a_call_or_a_task_that_no_worker_began(
    cluster: Dask, loop: asyncio.AbstractEventLoop
):
    for chunk, worker in ((None, "tcp://a"), (("a store of this test", 6), None)):
        error = ValueError("no")
        cluster._on_failed(_Task(loop.create_future(), chunk, worker), error)
        assert not hasattr(error, "__notes__")
    cluster._on_computed(_Task(loop.create_future(), None, "tcp://a"))
    assert cluster._others(None) is None


@pytest.mark.parametrize(
    ("error", "lacks"),
    [
        (ModuleNotFoundError("no", name="worker"), True),
        (ModuleNotFoundError("no", name="worker.tasks"), True),
        (ModuleNotFoundError("no", name="numba"), False),
        (ModuleNotFoundError("no"), False),
        (ImportError("no", name="worker"), False),
    ],
)
def test_a_worker_without_this_project_is_told_from_other_errors(error: Exception, lacks: bool):
    assert _lacks_project(error) is lacks


def test_the_workers_that_are_there_are_counted(cluster: Dask):
    first, second = workers_of(cluster)
    assert cluster.ready()
    state = cluster.state()
    assert (state.connected, state.workers, state.planned, state.fault) == (True, 2, 2, None)
    assert cluster.state() is state  # counted not long ago
    cluster._roster.note(
        {"worker": first, "host": socket.gethostname(), "process": 1, "refused": "of this test"}
    )
    try:
        assert cluster.ready()
        assert cluster.workers() == 1
        assert [reason.endswith("of this test") for reason in cluster.state().refused] == [True]
        chunk = ("a store of this test", 7)
        cluster._quarantine.failed(chunk, second)
        assert cluster._others(chunk) is None  # the other is of no use
        cluster._roster.note({"worker": second, "host": "", "process": 1, "refused": "of this test"})
        assert not cluster.ready()
        assert (cluster.workers(), cluster.state().connected) == (0, True)
    finally:
        cluster._roster.keep(set())
    assert cluster.ready()
    assert cluster.workers() == 2
    assert cluster._connection.threads_of([first]) == {first: 1}


def test_workers_are_gone_when_none_of_them_is_there(cluster: Dask):
    first, _ = workers_of(cluster)
    gone = cluster._connection.client.sync
    assert gone(cluster._are_gone, ["tcp://127.0.0.1:9"])
    assert not gone(cluster._are_gone, [first, "tcp://127.0.0.1:9"])


def test_what_a_lost_client_has_not_told_is_lost(cluster: Dask):
    """A client that does not exist, and whose tasks never end."""
    lost, tasks = Client(), [Future[int]() for _ in range(3)]
    ended, cancelled, waiting = (cluster._until_lost(lost, task) for task in tasks)
    tasks[0].set_result(5)
    assert cancelled.cancel()
    assert tasks[1].cancelled()
    assert cluster._unfinished[lost] == {waiting}  # nothing is kept of the others
    cluster._on_lost(lost)
    assert ended.result(0) == 5
    with pytest.raises(ClusterLost, match="the connection to the scheduler was lost"):
        waiting.result(0)
    with pytest.raises(ClusterLost):
        cluster._until_lost(lost, Future()).result(0)
    tasks[2].set_result(6)  # too late
    assert waiting.exception() is not None


def test_what_is_left_to_compute_is_told_when_it_changes(cluster: Dask, monkeypatch: pytest.MonkeyPatch):
    connection, told = cluster._connection, []
    client = connection.client

    async def tell(*what: Any) -> None:
        told.append(what)

    async def nothing() -> None: ...

    monkeypatch.setattr(connection, "_asked", None)
    monkeypatch.setattr(connection, "_tell", tell)
    for seconds, tasks in ((3.5, 2), (3.5, 2), (3.5, 1), (4.5, 1), (3.5, 2)):
        cluster.ask_for(seconds, tasks)
    connection.ask_for(0.0, 0)
    with monkeypatch.context() as patched:
        patched.setattr(connection, "_takes_demand", False)
        cluster.ask_for(7.0, 7)
    client.sync(nothing)
    expected = [(3.5, 2), (3.5, 1), (4.5, 1), (3.5, 2), (0.0, 0)]
    assert told == [(client, seconds, tasks) for seconds, tasks in expected]


def test_a_scheduler_that_replaced_the_last_one_gets_nothing_until_it_is_prepared(
    cluster: Dask, monkeypatch: pytest.MonkeyPatch
):
    connection, looked = cluster._connection, threading.Event()
    scheduler = connection._scheduler_id
    assert cluster.ready()
    with monkeypatch.context() as patched:
        patched.setattr(connection, "_reconnect_if_lost", looked.set)  # not yet
        assert looked.wait(DEADLINE)
        connection._scheduler_id = ""
        with pytest.raises(ClusterLost, match=r"^not connected to a scheduler: running$"):
            cluster.call(len, "abc")
        connection._scheduler_id = "another"
        assert not cluster.ready()
        assert "does not answer" in str(cluster.state().fault)
    wait_for(lambda: connection._scheduler_id == scheduler)
    wait_for(cluster.ready)
    assert cluster.call(len, "abc").result(DEADLINE) == 3
