"""The interface of executors: what the service relies on when it has chunks computed."""

import math
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, Protocol, TypeVar

from worker.studies import Chunk, Spec
from worker.tasks import ChunkReport

Result = TypeVar("Result")


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
        self, spec: Spec, chunk: Chunk, store_url: str, *, seconds: float = math.inf, priority: float = 0
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

    def close(self) -> None:
        """Release workers, connections and threads. Futures that have not ended are cancelled or fail."""
