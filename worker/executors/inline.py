"""Computes chunks in threads of this process: for `service.local`, tests, and scripts."""

from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError, ThreadPoolExecutor
from contextlib import suppress
from typing import Any

from kernel.numerics.cache import Compilation, compilations
from kernel.stopping import check, stopped_if
from worker.executors.base import ClusterState, Result
from worker.spec.specification import Specification
from worker.studies import run_task
from worker.study import Chunk, ChunkOptions, ChunkReport
from worker.study.chunks import USUAL, with_options


class Inline:
    """An executor whose workers are threads of this process. Tasks begin in the order of submission.

    Kernels run without the interpreter's lock. Ignores the `seconds` and `priority` of a chunk: a thread
    cannot be interrupted.
    """

    def __init__(self, workers: int = 1) -> None:
        self._threads = ThreadPoolExecutor(max_workers=workers, thread_name_prefix="chunks")
        self._workers = workers
        self._open = True

    def submit(
        self, spec: Specification, chunk: Chunk, store_url: str, options: ChunkOptions = USUAL
    ) -> "Future[ChunkReport]":
        return self._threads.submit(_run, spec, chunk, store_url, options)

    def call(self, function: Callable[..., Result], *arguments: Any) -> "Future[Result]":
        result: Future[Result] = Future()
        task = self._threads.submit(_call, result, function, arguments)
        task.add_done_callback(lambda task: task.cancelled() and result.cancel())
        return result

    def state(self) -> ClusterState:
        return ClusterState(self._open, self._workers if self._open else 0)

    def compiling(self, store_url: str) -> Compilation | None:
        """The kernel that this process compiles, for any job."""
        return next(iter(compilations()), None)

    def ask_for(self, seconds: float, tasks: int) -> None: ...

    def close(self) -> None:
        self._open = False
        self._threads.shutdown(cancel_futures=True)


def _call(result: "Future[Result]", function: Callable[..., Result], arguments: tuple[Any, ...]) -> None:
    """End the future with the function's result or error, unless it is cancelled meanwhile."""
    with suppress(InvalidStateError), stopped_if(result.cancelled):
        try:
            check()
            result.set_result(function(*arguments))
        except BaseException as error:  # noqa: BLE001 - the caller gets the error
            result.set_exception(error)


def _run(spec: Specification, chunk: Chunk, store_url: str, options: ChunkOptions) -> ChunkReport:
    with with_options(options):
        return run_task(spec, chunk, store_url)
