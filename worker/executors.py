"""Room: where chunks are computed: in this process, or on a Dask cluster.

Every executor answers the same four calls. Nothing is kept once a chunk's report has been
handed over; who wants a chunk done again submits it again.

    ExecutorError       why a chunk came back without a report, though its task did not fail
    ├── WorkerDied      the processes that tried it died
    └── ClusterLost     the scheduler is gone, or was never there
"""

import asyncio
import json
import time
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, Protocol

from distributed import Client, KilledWorker, LocalCluster

from worker.plan import Chunk
from worker.plugin import WarmKernels
from worker.spec import SweepSpec
from worker.tasks import ChunkReport, run_chunk

#: A frozen scheduler never answers and never fails: after so long it counts as not there.
PING_SECONDS: Final = 2.0
#: How long the number of workers is believed.
COUNT_SECONDS: Final = 1.0


class ExecutorError(Exception):
    """Why a chunk came back without a report, though its task did not fail."""


class WorkerDied(ExecutorError):
    """The worker processes that tried this chunk died, of it or of a neighbour."""


class ClusterLost(ExecutorError):
    """The scheduler cannot be reached; whatever it had is lost."""


class Executor(Protocol):
    """What computes chunks. Safe to call from any thread."""

    def submit(self, spec: SweepSpec, chunk: Chunk, store_url: str) -> "Future[ChunkReport]":
        """Have `run_chunk(spec, chunk, store_url)` done. The future fails with what the task
        raised, or an `ExecutorError`. Cancelling it takes back what has not begun."""

    def ready(self) -> bool:
        """Whether it would begin a chunk now; answers within seconds whatever happens."""

    def workers(self) -> int:
        """How many chunks it computes at once; 0 if there is nobody."""

    def close(self) -> None:
        """Let go of everything it started. Futures still open are cancelled or fail."""


class Inline:
    """One chunk after another in a thread of this process."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="chunks")
        self._open = True

    def submit(self, spec: SweepSpec, chunk: Chunk, store_url: str) -> "Future[ChunkReport]":
        return self._thread.submit(run_chunk, spec, chunk, store_url)

    def ready(self) -> bool:
        return self._open

    def workers(self) -> int:
        return 1 if self._open else 0

    def close(self) -> None:
        self._open = False
        self._thread.shutdown(cancel_futures=True)


class Dask:
    """A Dask cluster: one that is there already, or one of `workers` processes on this machine.

    Give `address` (tcp://host:port) or `scheduler_file` for the former. Returns when the
    workers that are there have their kernels compiled; later ones do that on joining. The
    own cluster listens on loopback only. Raises `ClusterLost` if nobody answers within
    `timeout` seconds.
    """

    def __init__(
        self,
        address: str | None = None,
        *,
        scheduler_file: str | Path | None = None,
        workers: int = 2,
        kernel_cache: str | Path | None = None,
        timeout: float = 30.0,
    ) -> None:
        self._cluster = None
        if address is None and scheduler_file is None:
            self._cluster = _local_cluster(workers)
        self._counted = (0.0, 0)
        self._client = self._connect(address, scheduler_file, timeout)
        try:
            self._client.register_plugin(WarmKernels(str(kernel_cache) if kernel_cache else None))
        except BaseException:
            self.close()
            raise

    def submit(self, spec: SweepSpec, chunk: Chunk, store_url: str) -> "Future[ChunkReport]":
        if self._client.status != "running":
            raise ClusterLost(f"not connected to a scheduler: {self._client.status}")
        task = self._client.submit(run_chunk, spec, chunk, store_url, pure=False)
        return asyncio.run_coroutine_threadsafe(_outcome(task), self._client.loop.asyncio_loop)

    def ready(self) -> bool:
        self._counted = (time.monotonic(), self._ping())
        return self._counted[1] > 0

    def workers(self) -> int:
        when, number = self._counted
        if time.monotonic() - when > COUNT_SECONDS:
            self.ready()
            _, number = self._counted
        return number

    def close(self) -> None:
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def _connect(self, address: str | None, scheduler_file: str | Path | None, timeout: float) -> Any:
        if scheduler_file is not None:
            address = _address_in(Path(scheduler_file), timeout)
        try:
            return Client(self._cluster or address, timeout=timeout, set_as_default=False)  # type: ignore[no-untyped-call]
        except (OSError, ValueError) as error:  # a time-out is an OSError
            raise ClusterLost(f"no scheduler answers at {address}: {error}") from error

    def _ping(self) -> int:
        """The scheduler's own count of threads, 0 if it does not answer in time."""
        if self._client.status != "running":
            return 0
        try:
            found = self._client.sync(
                self._client.scheduler.identity, n_workers=0, callback_timeout=PING_SECONDS
            )
        except (OSError, TimeoutError):
            return 0
        return int(found["total_threads"])


async def _outcome(task: Any) -> ChunkReport:
    """A task's report, in the client's event loop; releases the task whatever becomes of it."""
    try:
        report: ChunkReport = await task.result()
        return report
    except KilledWorker as error:
        raise WorkerDied(str(error)) from None
    except CancelledError as error:
        raise ClusterLost(f"the cluster dropped the task: {error}") from None
    except asyncio.CancelledError:
        await task.cancel()
        raise
    finally:
        task.release()


def _address_in(file: Path, timeout: float) -> str:
    """The address a scheduler wrote; waits for the file, which distributed itself would do for ever."""
    deadline = time.monotonic() + timeout
    while True:
        try:
            return str(json.loads(file.read_text())["address"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            if time.monotonic() > deadline:
                raise ClusterLost(f"no scheduler has written its address to {file}: {error}") from error
        time.sleep(0.1)


def _local_cluster(workers: int) -> Any:
    loopback = "127.0.0.1"
    return LocalCluster(  # type: ignore[no-untyped-call]
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        host=loopback,
        dashboard_address=f"{loopback}:0",
    )
