"""Computes chunks in a thread of this process: for tests, scripts, and machines without worker processes."""

import math
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from worker.executors.base import Result
from worker.studies import Chunk, Spec, run_task
from worker.tasks import ChunkReport


class Inline:
    """An executor with one worker, a thread of this process. Tasks run in the order of submission.

    Ignores `seconds` and `priority`: a thread cannot be interrupted.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="chunks")
        self._open = True

    def submit(
        self, spec: Spec, chunk: Chunk, store_url: str, *, seconds: float = math.inf, priority: float = 0
    ) -> "Future[ChunkReport]":
        return self._thread.submit(run_task, spec, chunk, store_url)

    def call(self, function: Callable[..., Result], *arguments: Any) -> "Future[Result]":
        return self._thread.submit(function, *arguments)

    def ready(self) -> bool:
        return self._open

    def workers(self) -> int:
        return 1 if self._open else 0

    def close(self) -> None:
        self._open = False
        self._thread.shutdown(cancel_futures=True)
