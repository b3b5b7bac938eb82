"""Plugins for a cluster's workers and scheduler, which admit workers and request as many as jobs need.

A worker with another kernel computes other numbers; one without the stores, or unable to load the kernel,
fails every chunk. Such workers are refused before their first chunk, with the reason.

A worker that cannot unpickle a plugin ends, and one that is to be refused may lack this project or run
another Python: the plugins are pickled with their source. At its top this module imports the standard library
and distributed only.
"""

from __future__ import annotations

import asyncio
import functools
import hashlib
import importlib
import logging
import math
import os
import pickle
import platform
import signal
import socket
import sys
import threading
import time
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import dask
from dask.utils import parse_timedelta
from distributed import SchedulerPlugin, Status, WorkerPlugin, get_worker

#: The topic under which workers log events, each with "worker", "host" and "process", and one of "refused"
#: (why), "admitted" and "leaving".
ROSTER: Final = "bouncing-spring-workers"
#: Where a service writes the remaining work in the scheduler's metadata.
DEMAND: Final = "bouncing-spring-demand"
#: Why a worker is refused at first.
NOT_JUDGED: Final = "it is not judged yet"
#: Seconds between checks of a refused worker: its folder may be mounted late.
JUDGE_SECONDS: Final = 5.0
#: Seconds for the last event to reach the scheduler before the process ends, and the longest that chunks may
#: take to pause before that.
REPORT_SECONDS, PAUSE_SECONDS = 0.2, 1.0
#: Libraries on whose versions stored numbers or bytes depend.
_LIBRARIES: Final = ("numpy", "numba", "zarr", "numcodecs")
#: Makes an object from the source of its class. Compiled code would fit one minor version of Python.
_MAKE: Final = "exec(source, module := {'__name__': name}) or module[name](*arguments)"


class WorkerAdmission(WorkerPlugin):
    """Admits or refuses every worker that starts or joins, and ends its process quickly.

    A worker must have the `facts` of the service (its own `facts()`), and see the mark of the `stores`: their
    address and the mark's content. A refused worker stays without tasks until it meets the requirements.
    """

    name = "bouncing-spring-kernels"

    def __init__(self, facts: Mapping[str, str], stores: tuple[str, str] | None = None) -> None:
        self._facts, self._stores = facts, stores
        self.release = hashlib.sha256(repr(sorted(facts.items())).encode()).hexdigest()
        self.refusal = NOT_JUDGED  # why the worker is refused
        self._removed = False

    def __reduce__(self) -> Any:
        return _from_source(type(self), self._facts, self._stores)

    async def setup(self, worker: Any) -> None:
        """Called by distributed in the worker's process."""
        _drop_messages(worker)
        # Paused, it would wait for memory that compiled kernels never give back. The watchdog judges memory.
        worker.memory_manager.memory_pause_fraction = 1.0
        _set_available(worker, available=False)
        await self._judge_worker(worker)
        if worker.nanny is not None and threading.current_thread() is threading.main_thread():
            # Batch queues end all processes of a job at once: this one too, and not through its nanny.
            asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, self._leave, worker)

    async def teardown(self, worker: Any) -> None:
        """Called by distributed when the plugin is replaced or the worker closes; then ends the process.

        A closing worker would first finish the chunk it computes and then free all compiled code, which
        takes seconds. Nothing is lost: the chunk pauses, and the service knows that the worker was told to
        leave. Without a nanny, nobody would notice that the process has ended.
        """
        self._removed = True
        if worker.status == Status.closing:
            _log_event(worker, leaving=True)
            if worker.nanny is not None:
                await _end(worker, 0)

    async def _judge_worker(self, worker: Any) -> None:
        """Admit or refuse the worker; a refused one is judged again later."""
        if self._removed:
            return
        self.refusal = await asyncio.to_thread(self.judge, worker.state.nthreads)
        _set_available(worker, available=not self.refusal)
        if self.refusal:
            _log_event(worker, refused=self.refusal)
            worker.loop.call_later(JUDGE_SECONDS, self._judge_worker, worker)
        else:
            _log_event(worker, admitted=True)

    def judge(self, threads: int) -> str:
        """Why this process may not compute `threads` chunks at once; empty if it may."""
        importlib.invalidate_caches()  # modules may have been installed since
        try:
            own = facts()
            wrong = [
                f"its {name} is {own.get(name)}, the service's {expected}"
                for name, expected in self._facts.items()
                if own.get(name) != expected
            ]
            # another release may lack what reads the stores
            if not wrong and self._stores is not None and (unseen := _unseen(*self._stores)):
                wrong.append(unseen)
            if threads != 1:
                wrong.append(f"it has {threads} threads: start it with --nthreads 1")
            if not wrong:
                from worker.kernel_cache import use_cache  # noqa: PLC0415 - see above

                use_cache()
                importlib.import_module("worker.work")
        except Exception as error:  # noqa: BLE001 - any error means that it cannot compute
            wrong = [f"it cannot load the kernel: {one_line(error)}"]
        return "; ".join(wrong)

    def _leave(self, worker: Any) -> None:
        """On SIGTERM: report it, let chunks pause, then end as SIGTERM would."""
        _log_event(worker, leaving=True)
        _set_available(worker, available=False)
        worker.loop.add_callback(_end, worker, 128 + signal.SIGTERM)


def _from_source(made: type, *arguments: Any) -> Any:
    """For `__reduce__`: an object that unpickles as `made(*arguments)` without this module."""
    return eval, (_MAKE, {"source": _source(), "name": made.__name__, "arguments": arguments})


@functools.cache
def _source() -> str:
    return Path(__file__).read_text()


def facts() -> dict[str, str]:
    """The properties of this process that the stored bytes depend on, by name.

    Of the processor only its kind counts: the kernel's operations are rounded correctly everywhere
    (docs/accuracy.md).
    """
    from kernel.params import KERNEL_VERSION  # noqa: PLC0415 - see above
    from worker.kernel_cache import digest_of  # noqa: PLC0415

    return {
        "kernel version": KERNEL_VERSION,
        **{f"package {name}": digest_of(name) for name in ("kernel", "worker")},
        **{name: version(name) for name in _LIBRARIES},
        "kind of processor": platform.machine(),
        "Python": ".".join(platform.python_version_tuple()[:2]),
    }


def _unseen(url: str, mark: str) -> str:
    """Why the stores' folder is another one or unusable; empty if it is the service's."""
    try:
        from worker import store  # noqa: PLC0415 - see above

        own_mark = store.read_marker(url)
    except Exception as error:  # noqa: BLE001 - without the stores it cannot compute
        return f"it cannot read {url}, where the stores are: {one_line(error)}"
    if own_mark != mark:
        return f"it does not see the service's stores in {url}: share that folder, under the same path"
    fault = store.write_fault(url)
    return f"it cannot write into {url}, where the stores are: {fault}" if fault else ""


def one_line(error: Exception) -> str:
    """The error on one line; numpy's have many."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def run_if_admitted(release: str, call: bytes) -> Any:
    """Call a function pickled with its arguments; returns WorkerRefused on a refused worker.

    The scheduler gives a refused worker no tasks, but may have done so before the worker was judged. Such
    a worker may be unable to unpickle them. `release` is that of the service: where it is not that of the
    service which has judged the worker, or nobody has, ClusterLost is returned.
    """
    if reason := refusal(get_worker()):
        from worker.executors.base import WorkerRefused  # noqa: PLC0415 - see above

        return WorkerRefused(reason)
    if getattr(get_worker().plugins.get(WorkerAdmission.name), "release", "") != release:
        from worker.executors.base import ClusterLost  # noqa: PLC0415 - see above

        lost = ClusterLost("a service of another release admits it: each needs a scheduler of its own")
        lost.event = {**_origin(get_worker()), "refused": str(lost)}  # type: ignore[attr-defined]
        return lost
    function, *arguments = pickle.loads(call)
    return function(*arguments)


def refusal(dask_worker: Any) -> str:
    """Why a worker is refused; empty if it is admitted."""
    return getattr(dask_worker.plugins.get(WorkerAdmission.name), "refusal", "")


def _set_available(worker: Any, *, available: bool) -> None:
    """Allow or forbid the scheduler to give this worker tasks.

    The worker itself is not paused: that would hold up the tasks it already has, and its memory monitor
    would end the pause.
    """
    status = (Status.running if available else Status.paused).name
    stimulus = f"bouncing-spring-{time.time()}"
    worker.batched_send({"op": "worker-status-change", "status": status, "stimulus_id": stimulus})


def _log_event(worker: Any, **what: Any) -> None:
    """Report something about this worker to the service, under `ROSTER`."""
    worker.log_event(ROSTER, {**_origin(worker), **what})


def _origin(worker: Any) -> dict[str, Any]:
    """The parts of an event that name its worker."""
    return {"worker": worker.address, "host": socket.gethostname(), "process": os.getpid()}


async def _end(worker: Any, status: int) -> None:
    """End this process, once its chunks have stored their progress."""
    if (chunks := sys.modules.get("worker.study.chunks")) is not None:  # else refused, maybe for this import
        chunks.LEAVING.set()
        deadline = time.monotonic() + PAUSE_SECONDS
        await asyncio.sleep(REPORT_SECONDS)
        while worker.active_threads and time.monotonic() < deadline:
            await asyncio.sleep(0.02)
    os._exit(status)


def _drop_messages(worker: Any) -> None:
    """Drop the log messages of a closing worker, and those of tasks that raise: the service logs these."""

    def is_kept(record: logging.LogRecord) -> bool:
        is_open = worker.status not in (Status.closing, Status.closing_gracefully, Status.closed)
        return is_open and not str(record.msg).startswith("Compute Failed")

    for handler in logging.getLogger("distributed").handlers:
        handler.addFilter(is_kept)


class Demand(SchedulerPlugin):
    """Makes the scheduler ask an adaptive cluster for as many workers as the services' jobs need.

    The scheduler counts its own tasks, but a service submits only a few chunks per worker. With `seconds`
    core-seconds left and Dask's `target-duration` T it asks for seconds / T workers, at most one for each
    chunk that could run, plus one for each refused worker. Services write both numbers, by client, under
    DEMAND into the scheduler's metadata.
    """

    name = "bouncing-spring-demand"
    idempotent = True

    def __reduce__(self) -> Any:
        return _from_source(type(self))

    async def start(self, scheduler: Any) -> None:
        """Called by distributed in the scheduler's process."""
        self._scheduler, self._by_tasks = scheduler, scheduler.adaptive_target
        self._needs: dict[str, tuple[float, int]] = scheduler.task_metadata.setdefault(DEMAND, {})
        scheduler.adaptive_target = scheduler.handlers["adaptive_target"] = self._target

    def remove_client(self, scheduler: Any, client: str) -> None:
        """Called by distributed: a service that has left needs nothing."""
        self._needs.pop(client, None)

    def _target(self, target_duration: Any = None) -> int:
        """Replaces `Scheduler.adaptive_target`; never less than that."""
        by_tasks: int = self._by_tasks(target_duration)
        duration = parse_timedelta(target_duration or dask.config.get("distributed.adaptive.target-duration"))
        needs = self._needs.values()
        wanted: int = sum(min(tasks, math.ceil(seconds / duration)) for seconds, tasks in needs)
        paused: int = sum(worker.status == Status.paused for worker in self._scheduler.workers.values())
        return max(by_tasks, wanted + paused) if wanted else by_tasks
