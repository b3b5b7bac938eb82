"""What computes chunks: the methods that every executor has."""

import math
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, Protocol, TypeVar

from worker.studies import Chunk, Spec
from worker.tasks import ChunkReport

Answer = TypeVar("Answer")


class Executor(Protocol):
    """What computes chunks. Safe to call from any thread."""

    def submit(
        self, spec: Spec, chunk: Chunk, store_url: str, *, seconds: float = math.inf, priority: float = 0
    ) -> "Future[ChunkReport]":
        """Have `run_chunk(spec, chunk, store_url)` done, in at most `seconds` from when it begins.

        Of the chunks that wait, those of higher priority begin first. The future fails with what
        the task raised, or an `ExecutorError`. Cancelling it takes back what has not begun.
        """

    def call(self, function: Callable[..., Answer], *arguments: Any) -> "Future[Answer]":
        """Have `function(*arguments)` done by a worker, before chunks that wait. The future fails as
        those of `submit` do; whoever wants it done again calls again."""

    def ready(self) -> bool:
        """Whether it would begin a chunk now; answers within seconds whatever happens."""

    def workers(self) -> int:
        """How many chunks it computes at once; 0 if there is nobody."""

    def close(self) -> None:
        """Let go of everything it started. Futures still open are cancelled or fail."""
