"""Computes chunks on a Dask cluster: an existing one, or worker processes of this machine."""

import asyncio
import math
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from distributed import KilledWorker

from worker.executors.base import Result
from worker.executors.connection import SchedulerConnection, read_scheduler_file
from worker.executors.errors import ClusterLost, ExecutorError, WorkerDied, WorkerLost
from worker.executors.local_cluster import LocalWorkers
from worker.executors.worker_plugin import WarmKernels
from worker.studies import Chunk, Spec
from worker.tasks import ChunkReport, TaskError
from worker.watchdog import run_watched

#: How long a count of the workers stays valid.
COUNT_SECONDS: Final = 1.0
#: Above that of any chunk: a request waits for the result.
CALL_PRIORITY: Final = 1_000_000.0


@dataclass
class _Task:
    """A task on the cluster, and what workers reported of it."""

    termination: "asyncio.Future[str]"  # why the watchdog terminated a worker over it
    watched: bool  # whether workers report when they begin it
    worker: str | None = None  # the address of the last worker that began it


class Dask:
    """An executor on a Dask cluster: an existing one, or `workers` processes on this machine.

    For an existing cluster give `address` (tcp://host:port, or a cluster object of Dask's) or
    `scheduler_file`, with distributed's `security` if the scheduler requires TLS. The connection is
    restored when a lost scheduler is back.

    Without either, starts a cluster that listens on loopback only; each of its processes may use `memory`
    bytes (None: an equal share of the machine's).

    Returns when the workers present have compiled their kernels; later workers compile on joining.
    Raises ClusterLost if no scheduler answers within `timeout` seconds.
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
        timeout: float = 30.0,
    ) -> None:
        self._workers: LocalWorkers | None = None
        self._count_time, self._count = -math.inf, 0  # when the workers were last counted
        self._tasks: dict[str, _Task] = {}  # by Dask's key; used in the client's event loop only
        if address is None and scheduler_file is None:
            self._workers = LocalWorkers(workers, memory)
            address = self._workers.cluster
        plugin = WarmKernels(str(kernel_cache) if kernel_cache else None)
        try:
            self._connection = SchedulerConnection(
                _target(address, scheduler_file, timeout),
                plugin,
                self._on_event,
                security=security,
                timeout=timeout,
            )
        except BaseException:
            self._close_workers()
            raise

    def submit(
        self, spec: Spec, chunk: Chunk, store_url: str, *, seconds: float = math.inf, priority: float = 0
    ) -> "Future[ChunkReport]":
        return self._submit(run_watched, spec, chunk, store_url, seconds, priority=priority)

    def call(self, function: Callable[..., Result], *arguments: Any) -> "Future[Result]":
        return self._submit(function, *arguments, priority=CALL_PRIORITY, watched=False)

    def ready(self) -> bool:
        self._count = self._connection.worker_threads()
        self._count_time = time.monotonic()
        return self._count > 0

    def workers(self) -> int:
        if time.monotonic() - self._count_time > COUNT_SECONDS:
            self.ready()
        return self._count

    def close(self) -> None:
        self._connection.close()
        self._close_workers()

    def _close_workers(self) -> None:
        if self._workers is not None:
            self._workers.close()

    def _submit(
        self, function: Callable[..., Any], *arguments: Any, priority: float, watched: bool = True
    ) -> "Future[Any]":
        """Submit to the scheduler. Raises ClusterLost, also if the connection is lost at this moment."""
        client = self._connection.client
        try:
            future = client.submit(function, *arguments, pure=False, priority=priority)
            outcome = self._outcome(future, watched=watched)
            return asyncio.run_coroutine_threadsafe(outcome, client.loop.asyncio_loop)
        except Exception as error:  # distributed raises whatever comes when its client is closing
            if client.status != "running":
                raise ClusterLost(f"the connection to the scheduler was lost: {error}") from error
            raise

    def _on_event(self, event: dict[str, Any]) -> None:
        """A worker began a task, or its watchdog terminates it over one."""
        task = self._tasks.get(event["key"])
        if task is None:
            return
        task.worker = event["worker"]
        if "why" in event and not task.termination.done():
            task.termination.set_result(event["why"])

    async def _outcome(self, future: Any, *, watched: bool = True) -> Any:
        """The result of a task, in the client's event loop; the cluster forgets the task in any case."""
        task = _Task(asyncio.get_running_loop().create_future(), watched)
        self._tasks[future.key] = task
        result = asyncio.ensure_future(future.result())
        try:
            await asyncio.wait({result, task.termination}, return_when=asyncio.FIRST_COMPLETED)
            if not result.done():
                await future.cancel()  # else the scheduler may start it on another worker
                raise WorkerDied(task.termination.result())
            outcome = result.result()
            if isinstance(outcome, TaskError):
                raise outcome
            return outcome
        except KilledWorker as error:
            raise _executor_error(task, error) from None
        except CancelledError as error:
            raise ClusterLost(f"the cluster dropped the task: {error}") from None
        except asyncio.CancelledError:
            await future.cancel()
            raise
        finally:
            result.cancel()
            del self._tasks[future.key]
            future.release()


def _target(address: Any, scheduler_file: str | Path | None, timeout: float) -> Callable[[], Any]:
    """What to connect to, now and after each loss of the scheduler; raises ClusterLost if there is none."""
    if scheduler_file is None:
        return lambda: address
    # Waits for the file at first; when the connection is lost, the deadline has passed.
    return partial(read_scheduler_file, Path(scheduler_file), time.monotonic() + timeout)


def _executor_error(task: _Task, error: KilledWorker) -> ExecutorError:
    """Tell a task that was running when its last worker died from one that only waited there."""
    if task.termination.done():
        return WorkerDied(task.termination.result())
    if not task.watched or task.worker == error.last_worker.address:
        return WorkerDied("the worker process that computed it died")
    return WorkerLost("the worker process at which it waited died")
