"""Runs a chunk in a worker process of a cluster under a watchdog that can end the process.

A compiled kernel cannot be interrupted. If a chunk exceeds its time or memory, or ignores the cancel flag,
the watchdog reports why and ends the process; the process's nanny starts another.
"""

import contextlib
import faulthandler
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from io import UnsupportedOperation
from typing import Any, Final

from distributed import get_worker

from kernel.numerics.cache import compilations
from kernel.stopping import Stopped, stopped_if
from worker import store
from worker.spec.specification import Specification
from worker.studies import run_task
from worker.study import Chunk, ChunkCancelled, ChunkOptions, ChunkPaused, ChunkReport, TaskError
from worker.study.chunks import with_options
from worker.work import compile_for

#: The topic under which workers log events: `{"key", "worker"}` when a task begins, with "why" when the
#: watchdog terminates the worker over it; `{"compiling", "store"}` twice a second while a kernel is compiled,
#: and with None afterwards.
TOPIC: Final = "bouncing-spring"

#: The interval of the checks, and that of the cancel flag, which may be in a distant bucket.
CHECK_SECONDS: Final = 0.1
FLAG_SECONDS: Final = 0.5
#: A chunk checks the cancel flag itself, four times a second; one still running this long after the flag was
#: seen ignores it. With the two above it ends within 2 s.
CANCEL_GRACE_SECONDS: Final = 1.0
#: The share of its memory limit that a worker may use. At 0.95 its nanny kills it without a reason.
MEMORY_SHARE: Final = 0.9
#: Seconds for the last event to reach the scheduler before the process ends.
REPORT_SECONDS: Final = 0.2
#: If no thread can run Python any more, the process ends this long after the chunk's time limit.
HARD_LIMIT_SECONDS: Final = 5.0
#: The longest timer that faulthandler accepts.
LONGEST_SECONDS: Final = 1e6


def run_watched(
    spec: Specification, chunk: Chunk, store_url: str, options: ChunkOptions
) -> ChunkReport | TaskError:
    """`studies.run_task` under a watchdog.

    Ends the process if the chunk takes longer than `options.seconds`, exceeds the worker's memory limit, or
    ignores the cancel flag. Returns ChunkCancelled and ChunkPaused instead of raising them, because
    distributed logs what a task raises as an error.
    """
    worker = get_worker()
    event = {"key": worker.get_current_task(), "worker": worker.address}
    worker.log_event(TOPIC, event)

    def terminate(why: str) -> None:
        worker.log_event(TOPIC, event | {"why": why})
        time.sleep(REPORT_SECONDS)
        os._exit(1)

    try:
        _compile(spec, store_url, worker)  # does not count as the chunk's time
        with Watchdog(worker, store_url, options.seconds, terminate), with_options(options):
            return run_task(spec, chunk, store_url)
    except (ChunkCancelled, ChunkPaused) as stopped:
        return stopped


def call_while_wanted(function: Callable[..., Any], *arguments: Any) -> Any:
    """`function(*arguments)`; None if its task is cancelled, which stops it between two steps."""
    worker = get_worker()
    task = worker.state.tasks[worker.get_current_task()]
    with contextlib.suppress(Stopped), stopped_if(lambda: bool(task.state == "cancelled")):
        return function(*arguments)


def _compile(spec: Specification, store_url: str, worker: Any) -> None:
    """Compile or load the kernels of the study. Raises ChunkCancelled if its job is cancelled meanwhile.

    Compilation can take a minute and cannot be interrupted: after a cancel its thread continues, for later
    chunks. Events report the kernel being compiled and the store.
    """
    thread = ThreadPoolExecutor(1, "compile")
    compiled = thread.submit(compile_for, spec)
    thread.shutdown(wait=False)
    said: tuple[Any, ...] = ()
    while not wait([compiled], FLAG_SECONDS).done:
        for said in compilations():
            worker.log_event(TOPIC, {"compiling": said, "store": store_url})
        with contextlib.suppress(OSError):  # a bucket out of reach is no reason to stop
            if store.is_cancelled(store_url):
                raise ChunkCancelled(f"cancelled: {store_url}")
    if said:
        worker.log_event(TOPIC, {"compiling": None, "store": store_url})
    compiled.result()


class Watchdog:
    """A thread that checks a worker within the block and calls `terminate` with a reason."""

    def __init__(self, worker: Any, store_url: str, seconds: float, terminate: Callable[[str], None]) -> None:
        self._worker, self._url, self._seconds, self._terminate = worker, store_url, seconds, terminate
        self._over = threading.Event()
        self._began = time.monotonic()
        self._flag_seen: float | None = None  # when the cancel flag was first seen
        self._flag_checked = self._began
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)

    def __enter__(self) -> None:
        with contextlib.suppress(AttributeError, RuntimeError, UnsupportedOperation, ValueError):  # no stderr
            seconds = min(self._seconds + HARD_LIMIT_SECONDS, LONGEST_SECONDS)
            faulthandler.dump_traceback_later(seconds, exit=True)
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._over.set()
        faulthandler.cancel_dump_traceback_later()

    def _watch(self) -> None:
        while not self._over.wait(CHECK_SECONDS):
            why = self._reason_to_terminate(time.monotonic())
            if why and not self._over.is_set():
                self._terminate(why)

    def _reason_to_terminate(self, now: float) -> str | None:
        if now - self._began > self._seconds:
            return f"it took longer than {self._seconds:g} s; its worker process was terminated"
        limit = self._worker.memory_manager.memory_limit
        used = self._worker.monitor.get_process_memory()
        if limit and used > MEMORY_SHARE * limit:
            return (
                f"its worker process used {used >> 20} MB of memory of a limit of {limit >> 20} MB "
                "and was terminated"
            )
        if self._ignores_cancel(now):
            return "it was cancelled and did not stop; its worker process was terminated"
        return None

    def _ignores_cancel(self, now: float) -> bool:
        """Whether the cancel flag has been set for longer than a chunk needs to see it."""
        if now - self._flag_checked > FLAG_SECONDS:
            self._flag_checked = now
            with contextlib.suppress(Exception):  # e.g. a bucket out of reach: no reason to end
                self._flag_seen = (self._flag_seen or now) if store.is_cancelled(self._url) else None
        return self._flag_seen is not None and now - self._flag_seen > CANCEL_GRACE_SECONDS
