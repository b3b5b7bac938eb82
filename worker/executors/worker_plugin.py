"""The plugin that prepares a Dask worker for tasks, or refuses it, and ends its process quickly.

Imports no kernel: a worker unpickles the plugin before it is known whether it can import one.
"""

import asyncio
import logging
import os
import signal
import sys
import threading
import time
from typing import Any, Final

from distributed import Status, WorkerPlugin

from worker.executors.admission import Requirements, refusal
from worker.executors.sent_plugin import JUDGE_SECONDS, log_event, refuse, set_available
from worker.kernel_cache import use_cache
from worker.precompile import Precompiling

#: Seconds for the last event to reach the scheduler before the process ends, and the longest that chunks may
#: take to pause before that.
REPORT_SECONDS, PAUSE_SECONDS = 0.2, 1.0


#: A worker that has been idle for this long compiles the kernels that nobody has asked for yet.
IDLE_SECONDS: Final = 60.0


class PreparedWorker(WorkerPlugin):
    """Judges every worker that starts or joins, before it takes a task.

    `root` is the folder of the kernel caches; None: the default of `worker.kernel_cache`. A refused worker
    stays, and the scheduler gives it no task until it meets the requirements.
    """

    def __init__(self, requirements: Requirements, root: str | None = None) -> None:
        self._requirements, self._root = requirements, root
        self._removed = False
        self._began = 0.0  # time.monotonic() when the last task began
        self._precompiling: Precompiling | None = None

    async def setup(self, worker: Any) -> None:
        """Called by distributed in the worker's process."""
        _quiet_when_closing(worker)
        await self._judge(worker)
        if worker.nanny is not None and threading.current_thread() is threading.main_thread():
            # Batch queues end all processes of a job at once: this one too, and not through its nanny.
            asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, self._leave, worker)

        asyncio.get_running_loop().call_later(IDLE_SECONDS, self._use_idle_time, worker)

    def transition(self, key: Any, start: str, finish: str, **_: Any) -> None:
        """Called by distributed when a task changes its state; a task that begins ends the idle time."""
        if finish == "executing":
            self._began = time.monotonic()
            self._stop_precompiling()

    def _use_idle_time(self, worker: Any) -> None:
        """Compile the other kernels after IDLE_SECONDS without a task."""
        if self._removed:
            return
        idle = time.monotonic() - self._began
        if idle < IDLE_SECONDS or worker.state.executing:
            worker.loop.call_later(IDLE_SECONDS, self._use_idle_time, worker)
        elif not refusal():
            self._precompiling = Precompiling(self._root)

    def _stop_precompiling(self) -> None:
        if self._precompiling is not None:
            self._precompiling.stop()
            self._precompiling = None

    async def teardown(self, worker: Any) -> None:
        """Called by distributed when the plugin is replaced or the worker closes; then ends the process.

        A closing worker would first finish the chunk it computes and then free all compiled code, which
        takes seconds when the service stops or the scheduler restarts. Nothing is lost: the chunk pauses, and
        the service submits it again and knows that the worker was told to leave. Without a nanny, nobody
        would notice that the process has ended.
        """
        self._removed = True
        self._stop_precompiling()
        if worker.status == Status.closing:
            log_event(worker, leaving=True)
            if worker.nanny is not None:
                await _pause_chunks(worker)
                os._exit(0)

    async def _judge(self, worker: Any) -> None:
        """Admit or refuse the worker; a refused one is judged again later."""
        reason = await asyncio.to_thread(self._requirements.judge, worker.state.nthreads, self._prepare)
        if reason:
            refuse(worker, reason)
            worker.loop.call_later(JUDGE_SECONDS, self._judge_again, worker)
        else:
            set_available(worker, available=True)
            log_event(worker, admitted=True)

    def _prepare(self) -> None:
        """Import what computes chunks. Raises any import error, and CacheRefused."""
        use_cache(self._root)
        import worker.tasks  # noqa: F401, PLC0415 - a worker without the kernel is refused, not broken

    async def _judge_again(self, worker: Any) -> None:
        if not self._removed:
            await self._judge(worker)

    def _leave(self, worker: Any) -> None:
        """On SIGTERM: report it, let chunks pause, then end as SIGTERM would."""
        log_event(worker, leaving=True)
        set_available(worker, available=False)
        worker.loop.add_callback(self._end, worker)

    async def _end(self, worker: Any) -> None:
        await _pause_chunks(worker)
        os._exit(128 + signal.SIGTERM)


def _quiet_when_closing(worker: Any) -> None:
    """Drop a closing worker's log messages about the tasks and connections that end with it."""

    def is_open(record: logging.LogRecord) -> bool:
        return worker.status not in (Status.closing, Status.closing_gracefully, Status.closed)

    for handler in logging.getLogger("distributed").handlers:
        handler.addFilter(is_open)


def rest(seconds: float, dask_worker: Any) -> None:
    """Take no task for `seconds`; run on a worker by the service."""
    set_available(dask_worker, available=False)
    dask_worker.loop.call_later(seconds, set_available_again, dask_worker)


def set_available_again(worker: Any) -> None:
    """End a rest, unless the worker is leaving."""
    if worker.status == Status.running:
        set_available(worker, available=True)


async def _pause_chunks(worker: Any) -> None:
    """Make this worker's chunks store their progress, and wait until they have."""
    if (tasks := sys.modules.get("worker.tasks")) is None:
        return  # refused, perhaps because this import fails
    tasks.LEAVING.set()
    deadline = time.monotonic() + PAUSE_SECONDS
    await asyncio.sleep(REPORT_SECONDS)
    while worker.active_threads and time.monotonic() < deadline:
        await asyncio.sleep(0.02)
