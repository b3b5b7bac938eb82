"""Whether the scheduler answers, asked seldom enough that asking costs nothing."""

import threading
import time

from worker.executors.base import Executor


class Health:
    """Remembers the executor's answer for `seconds`, whoever asks and however often."""

    def __init__(self, executor: Executor, seconds: float = 1.0) -> None:
        self._executor, self._seconds = executor, seconds
        self._lock = threading.Lock()
        self._asked = float("-inf")
        self._answer = False

    def ready(self) -> bool:
        """Whether the executor can compute now, or could less than `seconds` ago."""
        with self._lock:
            if time.monotonic() - self._asked > self._seconds:
                self._answer = self._executor.ready()
                self._asked = time.monotonic()
            return self._answer
