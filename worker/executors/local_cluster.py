"""A Dask cluster on this machine: a scheduler in this process and worker processes, on loopback only.

Scheduler, nannies and workers run any code they receive, and every user of the machine can reach their
ports. So they use TLS with a certificate known to this cluster's processes only; their HTTP servers have no
pages; and only this user can enter the folder of the workers' files.
"""

import asyncio
import contextlib
import fcntl
import logging
import os
import shutil
import signal
import tempfile
import threading
import time
from multiprocessing import resource_tracker
from pathlib import Path
from typing import IO, Any, Final

import dask
from distributed import LocalCluster, Security, Status, system

from worker import temporary
from worker.executors.connection import SCHEDULER_SETTINGS

log = logging.getLogger(__name__)

#: Workers still running after this many seconds are killed.
CLOSE_SECONDS: Final = 1.5
#: Seconds between further kills, of workers that replaced them meanwhile.
KILL_SECONDS: Final = 0.1
#: The interval at which lost workers are replaced.
REPLACE_SECONDS: Final = 1.0
LOOPBACK: Final = "127.0.0.1"
#: distributed drops a worker for good if it is not back this long after a death. That can take longer on a
#: busy machine, so this is switched off.
_LOST_WORKER_SETTINGS: Final = {"distributed.deploy.lost-worker-timeout": "1000 days"}
#: Schedulers and workers always listen for HTTP; without routes they have nothing but an empty sitemap.
_NO_HTTP: Final[dict[str, list[str]]] = {
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
#: The beginning of the names of scratch folders, in the system's folder for temporary files.
_SCRATCH: Final = "bouncing-spring-dask-"
_LOCK: Final = "held"
#: A scratch folder younger than this may belong to a cluster that is about to lock it.
_SETTLED_SECONDS: Final = 60.0


class LocalWorkers:
    """A cluster of `workers` processes with one thread each, kept at that number until `close`.

    A process that dies is restarted by its nanny; a nanny that cannot do so, for lack of memory or process
    numbers, is replaced. Each process may use `memory` bytes (None: an equal share of the machine's). Sets
    the Dask settings that its scheduler needs in this process. The certificate, and so the cluster, is valid
    for a year.
    """

    def __init__(self, workers: int, memory: int | None) -> None:
        dask.config.set(SCHEDULER_SETTINGS | _LOST_WORKER_SETTINGS)
        self._scratch = _Scratch()
        self.cluster: Any = None
        try:
            # For the scheduler, which would make its own folder: see `_Scratch`.
            with dask.config.set(_NO_HTTP | {"temporary-directory": str(self._scratch.folder)}):
                self.cluster = LocalCluster(  # type: ignore[no-untyped-call]
                    n_workers=0,
                    threads_per_worker=1,
                    processes=True,
                    host=LOOPBACK,
                    security=Security.temporary(),  # type: ignore[no-untyped-call]
                    dashboard_address=f"{LOOPBACK}:0",
                    scheduler_kwargs={"dashboard": False},  # there by default if bokeh is installed
                    # distributed's default depends on the cores, not on the number of processes.
                    memory_limit=memory or system.MEMORY_LIMIT // workers,
                    # For the workers, later replacements included.
                    local_directory=str(self._scratch.folder),
                    config=_NO_HTTP,
                )
                self._number = workers
                self.cluster.sync(self._start_workers)
        except BaseException:
            self.close(at_once=True)
            raise
        self.cluster.loop.add_callback(self._replace_lost)

    async def _start_workers(self) -> None:
        """Start all workers, in the cluster's event loop, and wait until they have joined.

        A terminal's Ctrl-C goes to all processes of a command, but only this one should handle it: threads
        and processes inherit the signals that the event loop's thread blocks.
        """
        resource_tracker.ensure_running()  # starting it later would unblock Ctrl-C
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        self.cluster.scale(self._number)
        await self.cluster._correct_state()

    def close(self, *, at_once: bool = False) -> None:
        """Stop all processes; kill any still running after CLOSE_SECONDS, or at once with `at_once`."""
        if self.cluster is not None:
            ended = threading.Event()
            kill = threading.Thread(target=self._kill, args=(ended, 0.0 if at_once else CLOSE_SECONDS))
            kill.start()
            self.cluster.close()
            ended.set()
            kill.join()
        self._scratch.remove()

    def _kill(self, ended: threading.Event, seconds: float) -> None:
        """Kill the processes and their replacements after `seconds`, until the cluster has ended."""
        while not ended.wait(seconds):
            for nanny in list(self.cluster.workers.values()):
                if nanny.pid:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(nanny.pid, signal.SIGKILL)
            seconds = KILL_SECONDS

    async def _replace_lost(self) -> None:
        """Replace lost workers; runs in the cluster's event loop as long as the cluster."""
        while self.cluster.status == Status.running:
            nannies = self.cluster.workers
            for name, nanny in list(nannies.items()):
                if nanny.status in (Status.closed, Status.failed):
                    del nannies[name]
            if lost := self._number - len(nannies):
                log.warning("%d of %d worker processes are lost; starting others", lost, self._number)
                with contextlib.suppress(Exception):  # distributed logs it; the next round tries again
                    await self.cluster._correct_state()
            await asyncio.sleep(REPLACE_SECONDS)


class _Scratch:
    """A folder for the workers' files that other users can neither enter nor predict, locked while in use.

    distributed's default is `dask-scratch-space` in the system's folder for temporary files, which another
    user can create first. Workers search their part of it for modules before anything else.
    """

    def __init__(self) -> None:
        _remove_abandoned(Path(tempfile.gettempdir()))
        self.folder = temporary.make(_SCRATCH)
        self._lock = (self.folder / _LOCK).open("w")
        fcntl.flock(self._lock, fcntl.LOCK_EX)

    def remove(self) -> None:
        """Remove the folder and its contents."""
        temporary.remove(self.folder)
        self._lock.close()


def _remove_abandoned(temporary: Path) -> None:
    """Remove this user's scratch folders whose processes were killed."""
    for folder in temporary.glob(f"{_SCRATCH}*"):
        with contextlib.suppress(OSError):
            status = folder.lstat()  # not followed: a link is not ours
            if status.st_uid != os.geteuid() or time.time() - status.st_mtime < _SETTLED_SECONDS:
                continue
            with _locked(folder / _LOCK):
                shutil.rmtree(folder, ignore_errors=True)


def _locked(path: Path) -> IO[str]:
    """The file, locked until closed. Raises OSError if it is missing or another process has it."""
    file = path.open()
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise
    return file
