"""Clusters to connect to: by address, by scheduler file, created by a function, or on this machine."""

import asyncio
import contextlib
import json
import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, Final

import dask
from distributed import LocalCluster, Security, Status, system

from worker.executors.base import ClusterLost
from worker.executors.plugins import one_line
from worker.ownership import temporary_folder

log = logging.getLogger(__name__)

#: Dask settings that a scheduler needs: the service itself retries tasks, and a task must wait at the
#: scheduler for the first free worker.
SCHEDULER_SETTINGS: Final[dict[str, float]] = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-saturation": 1.0,
}
#: Errors when no scheduler can be reached: a time-out is an OSError, a scheduler file may be half written.
NO_SCHEDULER: Final = (OSError, ValueError, KeyError, TypeError)
#: A cluster is replaced after this many unanswered connections in a row.
UNANSWERED: Final = 3
#: Least seconds between two calls of a function that creates a cluster: it may ask a busy batch queue.
MAKE_SECONDS: Final = 10.0
#: Seconds between checks for lost workers.
REFILL_SECONDS: Final = 5.0
#: The states of a Dask cluster that no longer computes.
_ENDED: Final = frozenset({"closed", "closing", "failed"})
LOOPBACK: Final = "127.0.0.1"
#: OpenSSL's X509_V_FLAG_NO_CHECK_TIME, for which the module ssl has no name.
_NO_CHECK_TIME: Final = 0x200000
#: On Linux, the open files of this process by their number.
_OWN_FILES: Final = "/proc/self/fd"
#: Workers still running after CLOSE_SECONDS are killed, and those that replaced them after KILL_SECONDS.
CLOSE_SECONDS, KILL_SECONDS = 1.5, 0.1
#: Schedulers and workers always listen for HTTP; without routes they serve only an empty sitemap. Nobody sees
#: what they would note of themselves up to a hundred times a second, busy or not.
_QUIET: Final[dict[str, Any]] = {
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.tick.cycle": "10s",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.admin.system-monitor.gil.enabled": False,
}


def environment_variable(setting: str) -> str:
    """The environment variable that sets a Dask setting."""
    return "DASK_" + setting.replace(".", "__").replace("-", "_").upper()


class Target:
    """The target of a connection: a scheduler's address, or a cluster object that its owner closes.

    Its methods are called from the connection's threads, one at a time.
    """

    is_own = False  # whether the service made the cluster: `refill` and `close` are for these

    def __init__(self, cluster: Any) -> None:
        self.cluster = cluster
        self._next_refill = 0.0

    def find(self) -> Any:
        """The scheduler's address, or a cluster object. Raises ClusterLost, or one of NO_SCHEDULER."""
        return self.cluster

    def unanswered(self) -> None:
        """Note that the result of `find` does not answer."""

    def refill(self) -> None:
        """Replace lost workers of a cluster of fixed size; adaptive clusters do so themselves."""
        now, cluster = time.monotonic(), self.cluster
        if self.is_own and now >= self._next_refill and hasattr(cluster, "worker_spec"):
            self._next_refill = now + REFILL_SECONDS
            asyncio.run_coroutine_threadsafe(_start_missing(cluster), cluster.loop.asyncio_loop)

    def planned(self) -> int | None:
        """Number of workers that the cluster should have; None if unknown."""
        with contextlib.suppress(Exception):
            return len(self.cluster.plan)
        return None

    def close(self) -> None:
        if self.is_own:
            cluster, self.cluster = self.cluster, None
            if hasattr(cluster, "close"):
                cluster.close()


async def _start_missing(cluster: Any) -> None:
    """Await the cluster, which makes distributed start its missing workers."""
    if cluster._lock.locked():  # it is starting or ending workers: those are not lost
        return
    for name, worker in list(cluster.workers.items()):
        if getattr(worker, "status", None) in (Status.closed, Status.failed):  # it was not restarted
            del cluster.workers[name]
    if missing := len(cluster.worker_spec.keys() - cluster.workers.keys()):
        log.warning("%d of %d workers are lost; starting others", missing, len(cluster.worker_spec))
        with contextlib.suppress(Exception):  # distributed logs it; the next check tries again
            await cluster


class SchedulerFile(Target):
    """A scheduler whose address is in a file. Waits `timeout` seconds for the file at first."""

    def __init__(self, file: Path, timeout: float) -> None:
        super().__init__(None)
        self._file, self._deadline = file, time.monotonic() + timeout

    def find(self) -> str:
        """The address in the file; distributed itself would wait for the file indefinitely."""
        while True:
            try:
                return str(json.loads(self._file.read_text())["address"])
            except NO_SCHEDULER as error:
                if time.monotonic() > self._deadline:
                    reason = f"no scheduler has written its address to {self._file}: {error}"
                    raise ClusterLost(reason) from error
            time.sleep(0.1)


class CreatedCluster(Target):
    """A cluster returned by `function()`, created again when it has ended or its scheduler does not answer.

    `name` is for messages. A function that fails is called again MAKE_SECONDS after its last call.
    """

    is_own = True

    def __init__(self, function: Callable[[], Any], name: str) -> None:
        super().__init__(None)
        self._function, self._name = function, name
        self._unanswered = 0  # connections in a row
        self._next_try, self._failure = 0.0, ""

    def find(self) -> Any:
        status = getattr(self.cluster, "status", None)
        if getattr(status, "name", status) in _ENDED:
            self._discard("it has ended")
        if self.cluster is None:
            self._create()
        return self.cluster

    def unanswered(self) -> None:
        self._unanswered += 1
        if self.cluster is not None and self._unanswered >= UNANSWERED:
            self._discard("its scheduler does not answer")

    def _discard(self, why: str) -> None:
        log.warning("the cluster of %s is made again: %s", self._name, why)
        with contextlib.suppress(Exception):  # the rest cannot be closed either
            self.close()

    def _create(self) -> None:
        if (wait := self._next_try - time.monotonic()) > 0:
            raise ClusterLost(f"no cluster from {self._name}{self._failure}; made again in {wait:.0f} s")
        self._next_try = time.monotonic() + MAKE_SECONDS
        try:
            cluster = self._function()
            if not hasattr(cluster, "scheduler_address"):  # of None, distributed would make a cluster
                raise TypeError(f"it returns no Dask cluster, but {type(cluster).__name__}")
            self.cluster = cluster
        except Exception as error:
            self._failure = f": {one_line(error)}"
            raise ClusterLost(f"no cluster from {self._name}{self._failure}") from error
        self._failure, self._unanswered = "", 0
        self._next_refill = time.monotonic() + REFILL_SECONDS


class _AtAnyTime(Security):
    """TLS at any time of the clock, which may be set back: the certificate is valid from now, for a year.

    Where Linux can, it is in no file: one for a moment, as distributed writes, is left by a process that is
    killed then.
    """

    def _get_tls_context(self, tls: Any, purpose: Any) -> Any:
        with contextlib.ExitStack() as held:
            if hasattr(os, "memfd_create") and Path(_OWN_FILES).is_dir():
                tls = tls | {name: held.enter_context(_in_memory(tls[name])) for name in ("cert", "key")}
            context = super()._get_tls_context(tls, purpose)  # type: ignore[no-untyped-call]
        context.verify_flags |= _NO_CHECK_TIME
        return context


@contextlib.contextmanager
def _in_memory(text: str) -> Iterator[str]:
    """The name of a file in memory alone, for this process and within the block."""
    with os.fdopen(os.memfd_create("tls"), "w") as file:
        file.write(text)
        file.flush()
        yield f"{_OWN_FILES}/{file.fileno()}"


class LocalWorkers(Target):
    """A scheduler in this process, and `workers` processes with one thread each, on loopback only.

    Scheduler, nannies and workers run any code they receive, and every user of the machine can reach their
    ports. So they use TLS with a certificate known to this cluster's processes only; their HTTP servers have
    no pages; and only this user can enter the folder of the workers' files: distributed's own folder can be
    made by another user first, and workers search it for modules before anything else.

    Each process may use `memory` bytes (None: an equal share of the machine's). A process that dies is
    restarted by its nanny. Sets the Dask settings that its scheduler needs in this process.
    """

    is_own = True

    def __init__(self, workers: int, memory: int | None) -> None:
        super().__init__(None)
        dask.config.set(SCHEDULER_SETTINGS)
        self._stack = contextlib.ExitStack()
        try:
            folder = str(self._stack.enter_context(temporary_folder("bouncing-spring-dask-")))
            with dask.config.set(_QUIET | {"temporary-directory": folder}):  # of the scheduler
                self.cluster = LocalCluster(  # type: ignore[no-untyped-call]
                    n_workers=0,
                    threads_per_worker=1,
                    processes=True,
                    host=LOOPBACK,
                    security=_AtAnyTime.temporary(),  # type: ignore[no-untyped-call]
                    dashboard_address=f"{LOOPBACK}:0",
                    scheduler_kwargs={"dashboard": False},  # there by default if bokeh is installed
                    # distributed's default depends on the cores, not on the number of processes.
                    memory_limit=memory or system.MEMORY_LIMIT // workers,
                    local_directory=folder,  # of the workers, later replacements included
                    config=_QUIET,
                )
                self.cluster.sync(self._start_workers, workers)
        except BaseException:
            self.close()
            raise

    async def _start_workers(self, workers: int) -> None:
        """Start all workers, in the cluster's event loop, and wait until they have joined.

        A terminal's Ctrl-C goes to all processes of a command, but only this one should handle it: threads
        and processes inherit the signals that the event loop's thread blocks.
        """
        resource_tracker.ensure_running()  # starting it later would unblock Ctrl-C
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        self.cluster.scale(workers)
        await self.cluster

    def close(self) -> None:
        """Stop all processes; kill any still running after CLOSE_SECONDS."""
        if (cluster := self.cluster) is not None:
            ended = threading.Event()
            killing = threading.Thread(target=_kill_until, args=(ended, cluster), daemon=True)
            try:
                killing.start()
                super().close()
            except AssertionError as error:  # distributed's, where a worker was just being started again
                log.warning("the workers are killed, as their cluster could not be closed: %s", error)
                _kill(cluster)
            finally:
                ended.set()
                if killing.is_alive():  # a second signal may have come before it started
                    killing.join()
        self._stack.close()


def _kill_until(ended: threading.Event, cluster: Any) -> None:
    """Kill the processes and their replacements after CLOSE_SECONDS, until the cluster has ended."""
    seconds = CLOSE_SECONDS
    while not ended.wait(seconds):
        _kill(cluster)
        seconds = KILL_SECONDS


def _kill(cluster: Any) -> None:
    """Kill the processes of all nannies, of those too that the cluster has dropped or is just starting."""
    nannies: list[Any] = []
    with contextlib.suppress(RuntimeError):  # another was made meanwhile
        nannies = list(cluster._created)
    for nanny in nannies:
        if nanny.pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(nanny.pid, signal.SIGKILL)
