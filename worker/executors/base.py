"""The interface of executors, which compute chunks for the service, and their errors."""

import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from kernel.numerics.cache import Compilation
from worker.spec.specification import Specification
from worker.study import Chunk, ChunkOptions, ChunkReport
from worker.study.chunks import USUAL

Result = TypeVar("Result")


class ExecutorError(Exception):
    """A task has no result, although it raised nothing itself."""


class WorkerDied(ExecutorError):
    """The worker process died while it ran this task; the message gives the reason, if known."""


class WorkerLost(ExecutorError):
    """The worker process died while this task waited there: another task is to blame."""


class WorkerLeft(ExecutorError):
    """The worker was told to leave before the task was done."""


class WorkerRefused(ExecutorError):
    """The worker may not compute: it differs from the service, or does not see the stores."""


class ReportMismatch(ExecutorError):
    """The worker reported another chunk than the one it was given, or other cells."""


class ClusterLost(ExecutorError):
    """The scheduler cannot be reached; all its tasks are lost."""


@dataclass(frozen=True)
class ClusterState:
    """Whether chunks can be computed."""

    connected: bool  # a scheduler answers
    workers: int  # tasks that run at once
    planned: int | None = None  # size that the cluster should have, if known
    reason: str = ""  # why there is no scheduler
    refused: tuple[str, ...] = ()  # workers that may not compute: host, address and why

    @property
    def fault(self) -> str | None:
        """Why no chunk is computed now; None if chunks are. Contains no address, as anyone may read it."""
        if not self.connected:
            return "the Dask scheduler does not answer; jobs wait until it does"
        if self.workers:
            return None
        asked = "" if self.planned is None else f" ({self.planned} asked for)"
        refused = f"; workers refused: {len(self.refused)}" if self.refused else ""
        return f"no workers yet{asked}; jobs wait until there are{refused}"

    @property
    def explanation(self) -> str | None:
        """`fault` with its known cause, for users who may see the service's addresses."""
        if (fault := self.fault) is None:
            return None
        return "; ".join(filter(None, (fault, self.reason, *self.refused)))


class Executor(Protocol):
    """Runs tasks on one or more workers and returns their results as futures.

    **Guarantees.** A future ends: with the task's result, with the exception that the task raised, with an
    `ExecutorError` if the worker or the cluster was lost, or cancelled. An executor neither retries a task
    nor keeps its result once the future has ended; the caller submits again. A task whose future failed
    may still have run, and may still be running, so tasks must be idempotent.

    **Cancellation.** Cancelling a future withdraws a task that has not begun, and stops a call that has
    between two steps (`kernel.stopping`). A chunk that has begun ends early if the cancel flag of
    its store is set (`worker.store.set_cancelled`).

    **Thread safety.** All methods may be called from any thread. Callbacks of futures run in a thread of
    the executor and must return quickly.

    **Ownership.** Whoever creates an executor closes it. Nothing may be submitted after `close`.
    """

    def submit(
        self, spec: Specification, chunk: Chunk, store_url: str, options: ChunkOptions = USUAL
    ) -> "Future[ChunkReport]":
        """Compute one chunk: `studies.run_task(spec, chunk, store_url)` on a worker.

        Raises ExecutorError if there is no cluster to submit to.
        """

    def call(self, function: Callable[..., Result], *arguments: Any) -> "Future[Result]":
        """Run `function(*arguments)` on a worker, before all waiting chunks and without a time limit.

        Raises ExecutorError if there is no cluster to submit to.
        """

    def state(self) -> ClusterState:
        """Whether there is a cluster, and workers; returns within seconds. May be a second old."""

    def compiling(self, store_url: str) -> Compilation | None:
        """The kernel that a worker compiles for the job with this store; does not block."""

    def ask_for(self, seconds: float, tasks: int) -> None:
        """Report the remaining work: `seconds` core-seconds, in `tasks` chunks that could run at once.

        A cluster that can grow adds workers for them.
        """

    def close(self) -> None:
        """Release workers, connections and threads. Futures that have not ended are cancelled or fail."""


def timed(function: Callable[..., Result], *arguments: Any) -> tuple[Result, float]:
    """The result of a call, and the seconds that it took where it was computed."""
    began = time.monotonic()
    return function(*arguments), time.monotonic() - began
