"""Room: a chunk computed under watch, in a worker process of a cluster.

A kernel that never comes back cannot be interrupted, only its process ended: by the watch, which
first says why. The process's nanny, or whoever started it, puts a new one in its place.
"""

import contextlib
import faulthandler
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import UnsupportedOperation
from typing import Any, Final

from distributed import get_worker

from worker import store
from worker.studies import Chunk, Spec, run_task
from worker.tasks import ChunkCancelled, ChunkReport

#: Under this name a cluster's workers say what becomes of chunks.
TOPIC: Final = "bouncing-spring"

#: How often the watch looks up, and how often at the cancel mark, which may be far away.
LOOK_SECONDS: Final = 0.1
MARK_SECONDS: Final = 1.0
#: A chunk sees the cancel mark by itself; so long after, it does not any more.
CANCEL_GRACE: Final = 2.0
#: Of its memory limit that a worker may use; at 0.95 its nanny would end it without a word.
MEMORY_SHARE: Final = 0.9
#: For the last words to reach the scheduler.
WORDS_SECONDS: Final = 0.2
#: If even the watch hangs, the process ends so long after the chunk's time is up.
LAST_RESORT: Final = 5.0
LONGEST: Final = 1e6


def run_watched(spec: Spec, chunk: Chunk, store_url: str, seconds: float) -> ChunkReport | ChunkCancelled:
    """As `studies.run_task`, but in a process that ends itself where the task cannot be stopped otherwise.

    That is if it takes longer than `seconds`, grows beyond the worker's memory limit, or ignores the cancel
    flag. `ChunkCancelled` is returned, not raised: the worker logs what is raised as an error.
    """
    worker = get_worker()
    said = {"key": worker.get_current_task(), "worker": worker.address}
    worker.log_event(TOPIC, said)

    def end(why: str) -> None:
        worker.log_event(TOPIC, said | {"why": why})
        time.sleep(WORDS_SECONDS)
        os._exit(1)

    with _last_resort(seconds + LAST_RESORT), Watchdog(worker, store_url, seconds, end):
        try:
            return run_task(spec, chunk, store_url)
        except ChunkCancelled as cancelled:
            return cancelled


class Watchdog:
    """A thread that looks after another one for as long as the block lasts."""

    def __init__(self, worker: Any, store_url: str, seconds: float, end: Callable[[str], None]) -> None:
        self._worker, self._url, self._seconds, self._end = worker, store_url, seconds, end
        self._over = threading.Event()
        self._began = time.monotonic()
        self._marked: float | None = None  # when the cancel mark was first seen
        self._looked = self._began  # at the mark
        self._thread = threading.Thread(target=self._work, name="watch", daemon=True)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._over.set()

    def _work(self) -> None:
        while not self._over.wait(LOOK_SECONDS):
            why = self._trouble(time.monotonic())
            if why and not self._over.is_set():
                self._end(why)

    def _trouble(self, now: float) -> str | None:
        if now - self._began > self._seconds:
            return f"it took longer than {self._seconds:g} s, and its worker was ended"
        limit = self._worker.memory_manager.memory_limit
        used = self._worker.monitor.get_process_memory()
        if limit and used > MEMORY_SHARE * limit:
            return f"its worker used {used >> 20} MB of memory, {limit >> 20} MB are allowed, and was ended"
        if self._cancelled(now):
            return "it was cancelled and did not stop, and its worker was ended"
        return None

    def _cancelled(self, now: float) -> bool:
        """Whether the cancel mark has been there for so long that it should have been heeded."""
        if now - self._looked > MARK_SECONDS:
            self._looked = now
            with contextlib.suppress(Exception):  # a bucket out of reach, a folder gone: no reason to end
                self._marked = (self._marked or now) if store.is_cancelled(self._url) else None
        return self._marked is not None and now - self._marked > CANCEL_GRACE


@contextmanager
def _last_resort(seconds: float) -> Iterator[None]:
    """End the process after so long even if no thread of it can run Python any more."""
    with contextlib.suppress(AttributeError, RuntimeError, UnsupportedOperation, ValueError):  # no stderr
        faulthandler.dump_traceback_later(min(seconds, LONGEST), exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
