"""Computes chunks on a Dask cluster: an existing one, or worker processes on this machine."""

import asyncio
import logging
import math
import time
from collections.abc import Callable, Hashable
from concurrent.futures import CancelledError, Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from weakref import WeakSet

from distributed import KilledWorker
from distributed.protocol.pickle import dumps

from worker.executors.admission import Probe, Requirements, facts, refusal
from worker.executors.base import USUAL, ClusterState, Compiling, Result
from worker.executors.bundles import Bundles, Call
from worker.executors.connection import SchedulerConnection
from worker.executors.errors import (
    ClusterLost,
    ExecutorError,
    WorkerDied,
    WorkerLeft,
    WorkerLost,
    WorkerRefused,
)
from worker.executors.local_cluster import LocalWorkers
from worker.executors.quarantine import MARKS, REST_SECONDS, Quarantine
from worker.executors.roster import Roster
from worker.executors.sent_plugin import PluginLoader
from worker.executors.sent_specs import SpecReferences, run_sent
from worker.executors.targets import CreatedCluster, Fixed, SchedulerFile, Target
from worker.executors.worker_plugin import PreparedWorker, rest
from worker.studies import Chunk, Spec
from worker.tasks import ChunkOptions, ChunkReport, TaskError
from worker.watchdog import call_while_wanted

log = logging.getLogger(__name__)

#: A worker that compiles reports it every half second; after this much silence it is done or gone.
COMPILING_SECONDS: Final = 2.0
#: How long a count of the workers stays valid.
COUNT_SECONDS: Final = 1.0
#: Seconds between checks for the workers to which a failed chunk is bound.
OTHERS_SECONDS: Final = 2.0
#: Above the priority of any chunk: a request waits for the result.
CALL_PRIORITY: Final = 1_000_000.0


@dataclass
class _Task:
    """A task on the cluster, and what workers reported about it."""

    termination: "asyncio.Future[str]"  # why the watchdog terminated a worker over it
    chunk: Hashable  # its store and number; None for a call, whose beginning workers do not report
    worker: str | None = None  # the address of the last worker that began it


class Dask:
    """An executor on a Dask cluster: an existing one, or `workers` processes on this machine.

    For an existing cluster give `address` (tcp://host:port, a cluster object of Dask's, or a
    `CreatedCluster`, which `close` closes) or `scheduler_file`, with distributed's `security` if the
    scheduler requires TLS. The connection is restored when a lost scheduler is back.

    Without either, starts a cluster that listens on loopback only; each of its processes may use `memory`
    bytes (None: an equal share of the machine's).

    Workers that differ from this process in what stored bytes depend on, or cannot see the folder or bucket
    `stores`, get no chunk: see `worker.executors.admission`.

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
        kernel_cache: str | Path | None = None,
        stores: Probe | None = None,
        timeout: float = 30.0,
    ) -> None:
        self._workers: LocalWorkers | None = None
        self._count_time = -math.inf  # when the workers were last counted
        self._state = ClusterState(connected=False, workers=0)
        self._tasks: dict[str, _Task] = {}  # by Dask's key; used in the client's event loop only
        self._unfinished: dict[Any, set[Future[Any]]] = {}  # by client
        self._lost: WeakSet[Any] = WeakSet()  # clients
        self._compiling: dict[str, tuple[float, str, float]] = {}  # by store: when heard, kernel, began
        self._target: Target = Fixed(None)
        self._roster, self._quarantine = Roster(), Quarantine()
        self._bundles, self._specs = Bundles(), SpecReferences()
        try:
            if address is None and scheduler_file is None:
                self._workers = LocalWorkers(workers, memory)
                address = self._workers.cluster
            probe = None if self._workers is not None else stores
            plugin = PreparedWorker(Requirements(facts(), probe), str(kernel_cache) if kernel_cache else None)
            self._target = _target(address, scheduler_file, timeout)
            self._connection = SchedulerConnection(
                self._target,
                PluginLoader(dumps(plugin)),  # type: ignore[no-untyped-call]
                self._on_event,
                self._roster.note,
                self._on_lost,
                security=security,
                timeout=timeout,
            )
            if self._workers is not None:
                self._check_own_workers()
        except BaseException:
            self._close_workers(at_once=True)
            raise

    def _check_own_workers(self) -> None:
        """Raise ClusterLost if the workers started here cannot compute: no others will join."""
        try:
            reasons = self._connection.client.run(refusal, on_error="ignore")
            if reasons and all(reasons.values()):
                raise ClusterLost(f"no worker can compute: {next(iter(reasons.values()))}")
        except BaseException:
            self._connection.close()
            raise

    def submit(
        self,
        spec: Spec,
        chunk: Chunk,
        store_url: str,
        *,
        seconds: float = math.inf,
        priority: float = 0,
        options: ChunkOptions = USUAL,
    ) -> "Future[ChunkReport]":
        sent, identity = self._specs.sent(spec, store_url), (store_url, chunk.index)
        return self._submit(
            run_sent, sent, chunk, store_url, seconds, options, priority=priority, identity=identity
        )

    def call(self, function: Callable[..., Result], *arguments: Any) -> "Future[Result]":
        return self._submit(call_while_wanted, function, *arguments, priority=CALL_PRIORITY)

    def ready(self) -> bool:
        self._count()
        return self._state.workers > 0

    def workers(self) -> int:
        return self.state().workers

    def state(self) -> ClusterState:
        if time.monotonic() - self._count_time > COUNT_SECONDS:
            self._count()
        return self._state

    def ask_for(self, seconds: float, tasks: int) -> None:
        self._connection.ask_for(seconds, tasks)

    def _count(self) -> None:
        threads = self._connection.worker_threads()
        useless = 0
        if threads and (refused := [worker.worker for worker in self._roster.refused]):
            present = self._connection.threads_of(refused)
            self._roster.keep(set(present))
            useless = sum(present.values())
        self._state = ClusterState(
            threads is not None,
            max((threads or 0) - useless, 0),
            self._target.planned(),
            self._connection.fault,
            tuple(map(str, self._roster.refused)),
        )
        self._count_time = time.monotonic()

    def close(self) -> None:
        self._connection.close()
        self._close_workers()

    def _close_workers(self, *, at_once: bool = False) -> None:
        self._target.close()
        if self._workers is not None:
            self._workers.close(at_once=at_once)

    def _submit(
        self, function: Callable[..., Any], *arguments: Any, priority: float, identity: Hashable = None
    ) -> "Future[Any]":
        """Submit to the scheduler, together with other tasks of the moment. Raises ClusterLost."""
        client = self._connection.client
        others = self._others(identity)
        call = Call((function, *arguments), priority, tuple(others or ()))
        outcome = self._submitted(client, call, identity, others)
        try:
            task = asyncio.run_coroutine_threadsafe(outcome, client.loop.asyncio_loop)
        except Exception as error:  # the loop is closed
            outcome.close()
            raise ClusterLost(f"the connection to the scheduler was lost: {error}") from error
        return self._until_lost(client, task)

    def _until_lost(self, client: Any, task: "Future[Any]") -> "Future[Any]":
        """The outcome of a task in the client's event loop, or ClusterLost once the client is lost.

        While its connection is being lost, a client's messages disappear without an error, and its event loop
        may end before the task does.
        """
        result: Future[Any] = Future()
        unfinished = self._unfinished.setdefault(client, set())
        unfinished.add(result)

        def on_task_done(task: "Future[Any]") -> None:
            with suppress(InvalidStateError):  # it was cancelled, or lost
                if task.cancelled():
                    result.cancel()
                elif error := task.exception():
                    result.set_exception(error)
                else:
                    result.set_result(task.result())

        def on_result_done(result: "Future[Any]") -> None:
            unfinished.discard(result)
            if result.cancelled():
                task.cancel()

        result.add_done_callback(on_result_done)
        task.add_done_callback(on_task_done)
        if client in self._lost:  # just now
            self._on_lost(client)
        return result

    def _on_lost(self, client: Any) -> None:
        """Fail the unfinished tasks of a client that was closed because its connection was lost."""
        self._lost.add(client)
        for result in list(self._unfinished.pop(client, ())):
            with suppress(InvalidStateError):
                result.set_exception(ClusterLost("the connection to the scheduler was lost"))

    async def _submitted(self, client: Any, call: Call, identity: Hashable, others: list[str] | None) -> Any:
        """The result of a task, in the client's event loop. Raises ClusterLost if it is gone."""
        try:
            future = await self._bundles.add(client, call)
        except Exception as error:  # distributed raises anything while its client closes
            if client.status != "running":
                raise ClusterLost(f"the connection to the scheduler was lost: {error}") from error
            raise
        return await self._outcome(future, identity, others)

    def compiling(self, store_url: str) -> Compiling | None:
        heard, kernel, began = self._compiling.get(store_url, (-math.inf, "", 0.0))
        if time.monotonic() - heard > COMPILING_SECONDS:
            self._compiling.pop(store_url, None)
            return None
        return Compiling(kernel, 1, 1, max(time.time() - began, 0.0))

    def _others(self, identity: Hashable) -> list[str] | None:
        """Workers where a failed chunk has not failed yet; None for all, or if there are none."""
        failed_on = self._quarantine.failed_on(identity)
        if not failed_on:
            return None
        useless = {worker.worker for worker in self._roster.refused}
        return sorted(self._connection.threads_of().keys() - failed_on - useless) or None

    def _on_event(self, event: dict[str, Any]) -> None:
        """A worker began a task, compiles for one, or is terminated by its watchdog over one."""
        if "compiling" in event:
            self._compiling[event["store"]] = time.monotonic(), event["compiling"], event["began"]
            return
        task = self._tasks.get(event["key"])
        if task is None:
            return
        task.worker = event["worker"]
        if "why" in event and not task.termination.done():
            task.termination.set_result(event["why"])

    async def _outcome(self, future: Any, identity: Hashable, others: list[str] | None) -> Any:
        """The result of a task, in the client's event loop; the cluster then forgets the task.

        `others`: the only workers that may run it.
        """
        task = _Task(asyncio.get_running_loop().create_future(), identity)
        self._tasks[future.key] = task
        result = asyncio.ensure_future(future.result())
        try:
            while not result.done() and not task.termination.done():
                await asyncio.wait(
                    {result, task.termination},
                    timeout=None if others is None else OTHERS_SECONDS,
                    return_when=asyncio.FIRST_COMPLETED,
                )
                waits = not result.done() and task.worker is None
                if waits and others is not None and await self._are_gone(others):
                    await future.cancel()
                    raise WorkerLeft("the workers on which it had not failed are gone")
            if not result.done():
                await future.cancel()  # else the scheduler may start it on another worker
                raise WorkerDied(task.termination.result())
            outcome = result.result()
            if isinstance(outcome, TaskError | WorkerRefused):
                raise outcome
            self._on_computed(task)
            return outcome
        except KilledWorker as error:
            lost = self._executor_error(task, error)
            if isinstance(lost, WorkerDied):
                self._on_failed(task, lost)
            raise lost from None
        except CancelledError as error:
            raise ClusterLost(f"the cluster dropped the task: {error}") from None
        except asyncio.CancelledError:
            await future.cancel()
            raise
        except (TaskError, WorkerLeft, WorkerRefused):
            raise
        except Exception as error:
            if _lacks_project(error):
                raise WorkerRefused(f"the worker cannot load bouncing-spring: {error}") from None
            self._on_failed(task, error)
            raise
        finally:
            result.cancel()
            del self._tasks[future.key]
            future.release()

    async def _are_gone(self, workers: list[str]) -> bool:
        """Whether none of these exists; distributed would keep their tasks indefinitely."""
        try:
            return not await self._connection.client.scheduler.ncores(workers=workers)
        except (OSError, ClusterLost):
            return False

    def _on_failed(self, task: _Task, error: Exception) -> None:
        """A chunk failed or killed its worker: name the worker in the error and retry elsewhere."""
        if task.chunk is not None and task.worker is not None:
            error.add_note(f"worker {self._roster.describe(task.worker)}")
            self._quarantine.failed(task.chunk, task.worker)

    def _on_computed(self, task: _Task) -> None:
        """A chunk was computed: rest workers that failed several which others computed."""
        if task.chunk is None:
            return
        for worker in self._quarantine.computed(task.chunk, task.worker):
            log.warning(
                "worker %s failed %d chunks in a row that others computed: it gets none for %g s",
                self._roster.describe(worker), MARKS, REST_SECONDS,
            )  # fmt: skip
            self._connection.run_on(worker, rest, REST_SECONDS)

    def _executor_error(self, task: _Task, error: KilledWorker) -> ExecutorError:
        """Distinguish a task that was running when its last worker died from one waiting there."""
        address = error.last_worker.address
        if task.termination.done():
            return WorkerDied(task.termination.result())
        if self._roster.is_leaving(address):
            return WorkerLeft(f"the worker {self._roster.describe(address)} was told to leave")
        if task.chunk is None or task.worker == address:
            return WorkerDied("the worker process that computed it died")
        return WorkerLost("the worker process at which it waited died")


def _lacks_project(error: Exception) -> bool:
    """Whether a worker without this project was given the task, before it was refused."""
    return isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] == "worker"


def _target(address: Any, scheduler_file: str | Path | None, timeout: float) -> Target:
    """What to connect to, now and after each loss of the scheduler."""
    if scheduler_file is not None:
        return SchedulerFile(Path(scheduler_file), timeout)
    return address if isinstance(address, CreatedCluster) else Fixed(address)
