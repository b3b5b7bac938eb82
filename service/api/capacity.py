"""Limits on concurrent requests that hold resources for long: exports, trajectories, event streams."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from service.errors import Busy


class ConcurrencyLimit:
    """At most `limit` blocks run at a time; a caller over the limit waits up to `timeout` s, then gets 429.

    With a timeout of a second, short requests pass a burst without a retry. In the event loop, where waiting
    would stop every other request, the timeout must be 0. `activity` names the blocks in the error, `advice`
    tells what to do instead. Thread-safe.
    """

    def __init__(self, activity: str, limit: int, timeout: float = 1.0, advice: str = "") -> None:
        self._limit, self._timeout = limit, timeout
        self._message = f"too many concurrent {activity}: at most {limit} at a time"
        if advice:
            self._message += f"; {advice}"
        self._slots = threading.BoundedSemaphore(limit)

    @contextmanager
    def slot(self) -> Iterator[None]:
        """Hold a slot during the block. Raises Busy."""
        acquired = self._slots.acquire(blocking=self._timeout > 0, timeout=self._timeout or None)
        if not acquired:
            raise Busy(self._message)
        try:
            yield
        finally:
            self._slots.release()
