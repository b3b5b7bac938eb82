"""Computes chunks on a Dask cluster: one that is there already, or worker processes of this machine.

Nothing is kept once a chunk's report has been handed over; who wants a chunk done again submits it again.
"""

import asyncio
import math
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from distributed import KilledWorker

from worker.executors.base import Answer
from worker.executors.connection import SchedulerConnection, address_in
from worker.executors.errors import ClusterLost, ExecutorError, WorkerDied, WorkerLost
from worker.executors.local_cluster import LocalWorkers
from worker.executors.worker_plugin import WarmKernels
from worker.studies import Chunk, Spec
from worker.tasks import ChunkCancelled, ChunkReport
from worker.watchdog import run_watched

#: How long the number of workers is believed.
COUNT_SECONDS: Final = 1.0
#: Above that of any chunk: somebody waits for the answer.
CALL_PRIORITY: Final = 1_000_000.0


@dataclass
class _Flight:
    """A chunk on the cluster, and what its workers said of it."""

    ended: "asyncio.Future[str]"  # why a worker ended itself over it
    watched: bool  # a worker says when it begins
    worker: str | None = None  # the address of the last one that began it


class Dask:
    """A Dask cluster: one that is there already, or one of `workers` processes on this machine.

    Give `address` (tcp://host:port, or a cluster object of Dask's) or `scheduler_file` for the former,
    with distributed's own `security` if it asks for TLS; a scheduler that dies is found again when it
    is back. The own cluster listens on loopback only; each of its processes may use `memory` bytes
    (None: its share of the machine's). Returns when the workers that are there have their kernels
    compiled; later ones do that on joining. Raises `ClusterLost` if nobody answers within `timeout`
    seconds.
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
        self._counted = (0.0, 0)
        self._flights: dict[str, _Flight] = {}
        plugin = WarmKernels(str(kernel_cache) if kernel_cache else None)
        if scheduler_file is not None:
            file, wait = Path(scheduler_file), timeout

            def target() -> Any:
                nonlocal wait
                wait, patience = 0.0, wait
                return address_in(file, patience)
        elif address is not None:

            def target() -> Any:
                return address
        else:
            own = self._workers = LocalWorkers(workers, memory)

            def target() -> Any:
                return own.cluster

        try:
            self._connection = SchedulerConnection(
                target, plugin, self._hear, security=security, timeout=timeout
            )
        except BaseException:
            self._close_workers()
            raise

    def submit(
        self, spec: Spec, chunk: Chunk, store_url: str, *, seconds: float = math.inf, priority: float = 0
    ) -> "Future[ChunkReport]":
        client = self._connection.client
        task = client.submit(run_watched, spec, chunk, store_url, seconds, pure=False, priority=priority)
        return asyncio.run_coroutine_threadsafe(self._outcome(task), client.loop.asyncio_loop)

    def call(self, function: Callable[..., Answer], *arguments: Any) -> "Future[Answer]":
        client = self._connection.client
        task = client.submit(function, *arguments, pure=False, priority=CALL_PRIORITY)
        return asyncio.run_coroutine_threadsafe(self._outcome(task, watched=False), client.loop.asyncio_loop)

    def ready(self) -> bool:
        self._counted = (time.monotonic(), self._connection.threads())
        return self._counted[1] > 0

    def workers(self) -> int:
        when, number = self._counted
        if time.monotonic() - when > COUNT_SECONDS:
            self.ready()
            _, number = self._counted
        return number

    def close(self) -> None:
        self._connection.close()
        self._close_workers()

    def _close_workers(self) -> None:
        if self._workers is not None:
            self._workers.close()

    def _hear(self, said: dict[str, Any]) -> None:
        """A worker began a chunk, or ends itself over one."""
        flight = self._flights.get(said["key"])
        if flight is None:
            return
        flight.worker = said["worker"]
        if "why" in said and not flight.ended.done():
            flight.ended.set_result(said["why"])

    async def _outcome(self, task: Any, *, watched: bool = True) -> Any:
        """What a task returns, in the client's event loop; releases the task whatever becomes of it."""
        flight = _Flight(asyncio.get_running_loop().create_future(), watched)
        self._flights[task.key] = flight
        result = asyncio.ensure_future(task.result())
        try:
            await asyncio.wait({result, flight.ended}, return_when=asyncio.FIRST_COMPLETED)
            if not result.done():
                await task.cancel()  # or the scheduler would try it on the next worker
                raise WorkerDied(flight.ended.result())
            answer = result.result()
            if isinstance(answer, ChunkCancelled):
                raise answer
            return answer
        except KilledWorker as error:
            raise _blame(flight, error) from None
        except CancelledError as error:
            raise ClusterLost(f"the cluster dropped the task: {error}") from None
        except asyncio.CancelledError:
            await task.cancel()
            raise
        finally:
            result.cancel()
            del self._flights[task.key]
            task.release()


def _blame(flight: _Flight, error: KilledWorker) -> ExecutorError:
    """Whether the chunk was being computed when its last worker died, or only waited there."""
    if flight.ended.done():
        return WorkerDied(flight.ended.result())
    if not flight.watched or flight.worker == error.last_worker.address:
        return WorkerDied("the worker process that computed it died")
    return WorkerLost("the worker process at which it waited died")
