"""The interface of executors: what the service relies on when it has chunks computed."""

import math
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Final, Protocol, TypeVar

from worker.studies import Chunk, Spec
from worker.tasks import ChunkReport, Terms

Result = TypeVar("Result")

USUAL: Final = Terms()


@dataclass(frozen=True)
class ClusterState:
    """Whether chunks can be computed; `workers` counts the tasks that run at once."""

    connected: bool  # a scheduler answers
    workers: int
    planned: int | None = None  # workers that the cluster shall have, if that is known
    reason: str = ""  # why there is no scheduler
    refused: tuple[str, ...] = ()  # workers that may not compute: host, address and why

    @property
    def fault(self) -> str | None:
        """Why no chunk is computed now; None if chunks are. Names no address: it is for everybody."""
        if not self.connected:
            return "the Dask scheduler does not answer; jobs wait until it does"
        if self.workers:
            return None
        asked = "" if self.planned is None else f" ({self.planned} asked for)"
        refused = f"; workers refused: {len(self.refused)}" if self.refused else ""
        return f"no workers yet{asked}; jobs wait until there are{refused}"

    @property
    def explanation(self) -> str | None:
        """`fault` with what is known of its cause, for those who may see the service's addresses."""
        if (fault := self.fault) is None:
            return None
        return "; ".join([fault, *([self.reason] if self.reason else []), *self.refused])


@dataclass(frozen=True)
class Compiling:
    """A kernel that a worker compiles before the first chunk of a job, or loads."""

    kernel: str  # its function and the contact model, as "run_lockstep of rigid"
    number: int  # of the kernels that the job needs, from 1
    of: int
    seconds: float  # so far


class Executor(Protocol):
    """Runs tasks on one or more workers and returns their results as futures.

    **Guarantees.** A future ends: with the task's result, with the exception that the task raised, with an
    `ExecutorError` if the worker or the cluster was lost, or cancelled. An executor neither retries a task
    nor keeps its result once the future has ended; the caller submits again. A task whose future failed
    may still have run, and may still be running, so tasks must be idempotent.

    **Cancellation.** Cancelling a future withdraws a task that has not begun. A chunk that has begun ends
    early if the cancel flag of its store is set (`worker.store.set_cancelled`).

    **Thread safety.** All methods may be called from any thread. Callbacks of futures run in a thread of
    the executor and must return quickly.

    **Ownership.** Whoever creates an executor closes it. Nothing may be submitted after `close`.
    """

    def submit(
        self,
        spec: Spec,
        chunk: Chunk,
        store_url: str,
        *,
        seconds: float = math.inf,
        priority: float = 0,
        terms: Terms = USUAL,
    ) -> "Future[ChunkReport]":
        """Compute one chunk: `studies.run_task(spec, chunk, store_url)` on a worker.

        `seconds` limits the wall time of the task, counted from its start; waiting for a worker does not
        count. Of the chunks that wait for a worker, those of higher priority start first.
        Raises ExecutorError if there is no cluster to submit to.
        """

    def call(self, function: Callable[..., Result], *arguments: Any) -> "Future[Result]":
        """Run `function(*arguments)` on a worker, before all chunks that wait; without a time limit.

        Raises ExecutorError if there is no cluster to submit to.
        """

    def ready(self) -> bool:
        """Whether a task submitted now would start on some worker; returns within seconds in any case."""

    def workers(self) -> int:
        """The number of tasks that run at once; 0 without workers. May be a second old."""

    def state(self) -> ClusterState:
        """Whether there is a cluster, and workers; returns within seconds. May be a second old."""

    def compiling(self, store_url: str) -> Compiling | None:
        """What is compiled for the job with this store, on one of the workers; returns at once."""

    def ask_for(self, seconds: float, tasks: int) -> None:
        """Say that `seconds` core-seconds are left to compute, in `tasks` chunks that could run at once.

        A cluster that can grow has as many workers as these need.
        """

    def close(self) -> None:
        """Release workers, connections and threads. Futures that have not ended are cancelled or fail."""
