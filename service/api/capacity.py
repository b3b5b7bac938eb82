"""Limits concurrent expensive requests; a caller over the limit waits up to 1 s, then gets 429."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from service.errors import Busy


class ConcurrencyLimit:
    """Lets at most `limit` blocks run at a time, in any threads; `activity` names them in the error.

    A caller waits up to `timeout` seconds for a slot, so that short requests pass a burst without a retry.
    """

    def __init__(self, activity: str, limit: int, timeout: float = 1.0) -> None:
        self._activity, self._limit, self._timeout = activity, limit, timeout
        self._slots = threading.BoundedSemaphore(limit)

    @contextmanager
    def slot(self) -> Iterator[None]:
        """Hold a slot during the block. Raises Busy."""
        if not self._slots.acquire(timeout=self._timeout):
            raise Busy(f"too many concurrent {self._activity}: at most {self._limit} at a time")
        try:
            yield
        finally:
            self._slots.release()
