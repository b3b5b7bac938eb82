"""Limits concurrent expensive requests; a caller over the limit waits up to 1 s, then gets 429."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from service.errors import Busy


class ConcurrencyLimit:
    """At most `places` at a time; who waits longer than `seconds` is told to come back."""

    def __init__(self, what: str, places: int, seconds: float = 1.0) -> None:
        self._what, self._places, self._seconds = what, places, seconds
        self._free = threading.BoundedSemaphore(places)

    @contextmanager
    def turn(self) -> Iterator[None]:
        """For as long as the block. Raises Busy."""
        if not self._free.acquire(timeout=self._seconds):
            raise Busy(f"{self._places} {self._what} are being made already, at most so many at a time")
        try:
            yield
        finally:
            self._free.release()
