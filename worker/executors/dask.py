"""Computes chunks on a Dask cluster: an existing one, or worker processes on this machine."""

import asyncio
import math
import pickle
import time
from collections.abc import Callable, Hashable
from concurrent.futures import CancelledError, Future, InvalidStateError
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final
from uuid import uuid4

from distributed import KilledWorker
from distributed.protocol.pickle import dumps

from kernel.numerics.cache import Compilation
from worker.executors.base import (
    ClusterLost,
    ClusterState,
    ExecutorError,
    Result,
    WorkerDied,
    WorkerLeft,
    WorkerLost,
    WorkerRefused,
)
from worker.executors.clusters import CreatedCluster, LocalWorkers, SchedulerFile, Target
from worker.executors.connection import SchedulerConnection
from worker.executors.plugins import NOT_JUDGED, WorkerAdmission, facts, refusal, run_if_admitted
from worker.executors.roster import Roster
from worker.spec.specification import Specification
from worker.study import Chunk, ChunkOptions, ChunkReport, TaskError
from worker.study.chunks import USUAL
from worker.watchdog import call_while_wanted, run_watched

#: A worker that compiles reports it every half second; after this much silence it is done or gone.
COMPILING_SECONDS: Final = 2.0
#: Seconds between two looks whether a worker is judged.
JUDGED_SECONDS: Final = 0.2
#: How long a count of the workers stays valid.
COUNT_SECONDS: Final = 1.0
#: Above the priority of any chunk: a request waits for the result.
CALL_PRIORITY: Final = 1_000_000.0


@dataclass(eq=False)
class _Task:
    """A task on the cluster, and what workers reported about it."""

    client: Any
    key: str  # Dask's
    chunk: Hashable = None  # its store and number; None for a call, whose beginning workers do not report
    others: tuple[str, ...] = ()  # the only workers that may run it: a chunk failed on the others
    worker: str | None = None  # the address of the last worker that began it
    future: Any = None  # Dask's, once submitted
    running: Any = None  # `_run`: event loops keep no reference
    result: Future[Any] = field(default_factory=Future)


class _Call:
    """A function and its arguments, which unpickle as a call of `run_if_admitted`.

    Sent as bytes: scheduler and worker need nothing of this project until a worker runs it, and a worker that
    cannot unpickle a message ends.
    """

    def __init__(self, release: str, *call: Any) -> None:
        self._release, self._call = release, call

    def __reduce__(self) -> Any:
        return run_if_admitted, (self._release, dumps(self._call))  # type: ignore[no-untyped-call]


async def _withdraw(task: _Task) -> None:
    """Cancel an answered task in the client's event loop: the scheduler may start it on another worker."""
    if task.future is not None and not task.future.done():
        with suppress(Exception):  # the client closes, and its tasks with it
            await task.future.cancel()


class Dask:
    """An executor on a Dask cluster: an existing one, or `workers` processes on this machine.

    For an existing cluster give `address` (tcp://host:port, a cluster object of Dask's, or a
    `CreatedCluster`, which `close` closes) or `scheduler_file`, with distributed's `security` if the
    scheduler requires TLS. The connection is restored when a lost scheduler is back.

    Without either, starts a cluster that listens on loopback only; each of its processes may use `memory`
    bytes (None: an equal share of the machine's).

    Workers that differ from this process in what stored bytes depend on, or cannot see the `stores` (address
    of their folder or bucket, content of its mark), get no chunk: see `worker.executors.plugins`.

    Returns when the workers present have been judged; later workers are judged on joining.
    Raises ClusterLost if no scheduler answers within `timeout` seconds, or no worker of its own can compute.
    """

    def __init__(
        self,
        address: Any = None,
        *,
        scheduler_file: str | Path | None = None,
        security: Any = None,
        workers: int = 2,
        memory: int | None = None,
        stores: tuple[str, str] | None = None,
        timeout: float = 30.0,
    ) -> None:
        self._count_time = -math.inf  # when the workers were last counted
        self._present: dict[str, int] = {}  # threads of each worker then, by address
        self._state = ClusterState(connected=False, workers=0)
        self._tasks: dict[str, _Task] = {}  # unfinished, by Dask's key
        self._compiling: dict[str, tuple[float, Compilation]] = {}  # by store, and when heard
        self._roster = Roster()
        is_own = address is None and scheduler_file is None
        if is_own:
            self._target: Target = LocalWorkers(workers, memory)
        elif scheduler_file is not None:
            self._target = SchedulerFile(Path(scheduler_file), timeout)
        else:
            self._target = address if isinstance(address, CreatedCluster) else Target(address)
        with ExitStack() as stack:
            stack.callback(self._target.close)
            plugin = WorkerAdmission(facts(), None if is_own else stores)
            self._release = plugin.release
            self._connection = SchedulerConnection(
                self._target, plugin, self._on_event, self._on_lost, security=security, timeout=timeout
            )
            stack.callback(self._connection.close)
            if is_own and (why := self._why_none_computes(10 * timeout)):  # no other workers will join
                raise ClusterLost(f"no worker can compute: {why}")
            stack.pop_all()

    def submit(
        self, spec: Specification, chunk: Chunk, store_url: str, options: ChunkOptions = USUAL
    ) -> "Future[ChunkReport]":
        identity = (store_url, chunk.index)
        call = _Call(self._release, run_watched, spec, chunk, store_url, options)
        return self._submit(call, options.priority, identity, self._others(identity))

    def call(self, function: Callable[..., Result], *arguments: Any) -> "Future[Result]":
        return self._submit(_Call(self._release, call_while_wanted, function, *arguments), CALL_PRIORITY)

    def state(self) -> ClusterState:
        if time.monotonic() - self._count_time > COUNT_SECONDS:
            self._count()
        return self._state

    def compiling(self, store_url: str) -> Compilation | None:
        heard, compilation = self._compiling.get(store_url, (-math.inf, None))
        if time.monotonic() - heard > COMPILING_SECONDS:
            self._compiling.pop(store_url, None)
            return None
        return compilation

    def ask_for(self, seconds: float, tasks: int) -> None:
        self._connection.ask_for(seconds, tasks)

    def close(self) -> None:
        self._connection.close()
        for task in list(self._tasks.values()):
            self._fail(task, ClusterLost("the connection to the scheduler was closed"))
        self._target.close()

    def _count(self) -> None:
        """Count the workers, and fail chunks that wait for workers which are gone."""
        threads = self._connection.worker_threads()
        present = threads or {}
        if threads is not None:  # a scheduler that is too busy to answer keeps its workers
            self._present = threads
        if present:
            self._roster.keep(present)
        refused = dict(self._roster.refused)
        useful = sum(count for worker, count in present.items() if worker not in refused)
        planned, fault = self._target.planned(), self._connection.fault
        self._state = ClusterState(threads is not None, useful, planned, fault, tuple(refused.values()))
        self._count_time = time.monotonic()
        for task in list(self._tasks.values()) if threads is not None else ():
            if task.others and task.worker is None and not present.keys() & task.others:
                self._fail(task, WorkerLeft("the workers on which it had not failed are gone"))

    def _why_none_computes(self, seconds: float) -> str:
        """Why all workers are refused, once they are judged or after `seconds`; empty if one is not refused.

        On a busy machine the judgement takes longer than the time-out of a connection.
        """
        deadline = time.monotonic() + seconds
        while True:
            reasons: list[str] = list(self._connection.client.run(refusal, on_error="ignore").values())
            if not reasons or not all(reasons):
                return ""
            if NOT_JUDGED not in reasons or time.monotonic() > deadline:
                return reasons[0]
            time.sleep(JUDGED_SECONDS)

    def _others(self, chunk: Hashable) -> tuple[str, ...]:
        """Workers where a failed chunk has not failed yet; empty for all, or if there are none."""
        if not (failed_on := self._roster.failed_on.get(chunk)):
            return ()
        return tuple(sorted(self._present.keys() - failed_on - self._roster.refused.keys()))

    def _submit(
        self, call: _Call, priority: float, chunk: Hashable = None, others: tuple[str, ...] = ()
    ) -> "Future[Any]":
        """Submit to the scheduler. Raises ClusterLost.

        A task is withdrawn if it is cancelled, its worker is terminated, or its client is lost. While a
        client loses its connection, its messages disappear without an error, and its event loop may end
        before the task does.
        """
        task = _Task(self._connection.client, f"{run_if_admitted.__name__}-{uuid4().hex}", chunk, others)
        run = self._run(task, pickle.dumps(call), priority)
        try:
            task.running = asyncio.run_coroutine_threadsafe(run, task.client.loop.asyncio_loop)
        except Exception as error:  # the loop is closed
            run.close()
            raise ClusterLost(f"the connection to the scheduler was lost: {error}") from error
        self._tasks[task.key] = task

        def on_done(_: "Future[Any]") -> None:
            del self._tasks[task.key]
            task.client.loop.add_callback(_withdraw, task)

        task.result.add_done_callback(on_done)
        if task.client.status != "running":  # since just now
            self._on_lost(task.client)
        return task.result

    async def _run(self, task: _Task, call: bytes, priority: float) -> None:
        """Have a task computed, in the client's event loop; the cluster then forgets it.

        Must not be cancelled: distributed fetches the results of several tasks at once, and after a cancelled
        fetch no task gets its result. `_withdraw` ends it.
        """
        try:
            task.future = task.client.submit(
                pickle.loads, call, key=task.key, priority=priority, workers=task.others or None
            )
            outcome = await task.future.result()
            if isinstance(outcome, ClusterLost):
                self._roster.note(outcome.event)  # type: ignore[attr-defined]
            if isinstance(outcome, TaskError | ExecutorError):
                raise outcome
            with suppress(InvalidStateError):  # it was cancelled, or lost
                task.result.set_result(outcome)
        except (Exception, asyncio.CancelledError) as error:  # noqa: BLE001 - it raises anything as it closes
            self._fail(task, error)
        finally:
            if task.future is not None:
                task.future.release()

    def _on_lost(self, client: Any) -> None:
        """Fail the unfinished tasks of a client that was closed because its connection was lost."""
        for task in list(self._tasks.values()):
            if task.client is client:
                self._fail(task, ClusterLost("the connection to the scheduler was lost"))

    def _on_event(self, event: dict[str, Any]) -> None:
        """A worker reports on itself, compiles, began a task, or is terminated by its watchdog over one."""
        if "host" in event:
            self._roster.note(event)
        elif "compiling" in event:
            self._compiling.pop(event["store"], None)  # another worker that still compiles it says so soon
            if event["compiling"] is not None:
                self._compiling[event["store"]] = time.monotonic(), Compilation(*event["compiling"])
        elif task := self._tasks.get(event["key"]):
            task.worker = event["worker"]
            if "why" in event:
                self._fail(task, WorkerDied(event["why"]))

    def _fail(self, task: _Task, error: BaseException) -> None:
        """End a task with an error; one that blames a worker names it, and the retry goes elsewhere."""
        if isinstance(error, KilledWorker):
            error = self._death(task, error.last_worker.address)
        elif isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] == "worker":
            error = WorkerRefused(f"the worker cannot load bouncing-spring: {error}")  # not judged yet
        elif isinstance(error, CancelledError | asyncio.CancelledError):
            error = ClusterLost(f"the cluster dropped the task: {error}")
        elif task.client.status != "running" and not isinstance(error, TaskError | ExecutorError):
            error = ClusterLost(f"the connection to the scheduler was lost: {error}")
        blames = isinstance(error, WorkerDied) or not isinstance(error, TaskError | ExecutorError)
        if blames and task.chunk is not None and task.worker is not None and not task.result.done():
            error.add_note(f"worker {self._roster.describe(task.worker)}")
            self._roster.failed(task.chunk, task.worker)
        with suppress(InvalidStateError):
            task.result.set_exception(error)

    def _death(self, task: _Task, address: str) -> ExecutorError:
        """Distinguish a task that was running when its last worker died from one waiting there."""
        if address in self._roster.leaving:
            return WorkerLeft(f"the worker {self._roster.describe(address)} was told to leave")
        if task.chunk is None or task.worker == address:
            return WorkerDied("the worker process that computed it died")
        return WorkerLost("the worker process at which it waited died")
