"""A Dask cluster of this machine: a scheduler in this process and worker processes, on loopback only.

Scheduler, nannies and workers run whatever code they are sent, and every user of the machine reaches their
ports. So they speak TLS with a certificate made for this cluster, which is known to its processes only; their
HTTP servers have no pages; and the workers' files are in a folder of this user alone.
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

#: Workers that have not ended by themselves after so long are killed.
CLOSE_SECONDS: Final = 1.5
#: Seconds after which they are killed again, where others replaced them meanwhile.
KILL_SECONDS: Final = 0.1
#: The interval at which lost workers are replaced.
REPLACE_SECONDS: Final = 1.0
LOOPBACK: Final = "127.0.0.1"
#: distributed drops a worker for good if it is not back so long after a death. A worker may take longer on a
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

    A process that dies is restarted by its nanny; a nanny that cannot do that, for lack of memory or of
    process numbers, is replaced. Each process may use `memory` bytes (None: an equal share of the
    machine's). Sets the Dask settings that its scheduler needs for this process. Its certificate is valid for
    a year, which a cluster therefore cannot outlive.
    """

    def __init__(self, workers: int, memory: int | None) -> None:
        dask.config.set(SCHEDULER_SETTINGS | _LOST_WORKER_SETTINGS)
        self._scratch = _Scratch()
        self.cluster: Any = None
        try:
            # For the scheduler, which would make a folder of its own: see `_Scratch`.
            with dask.config.set(_NO_HTTP | {"temporary-directory": str(self._scratch.folder)}):
                self.cluster = LocalCluster(  # type: ignore[no-untyped-call]
                    n_workers=0,
                    threads_per_worker=1,
                    processes=True,
                    host=LOOPBACK,
                    security=Security.temporary(),  # type: ignore[no-untyped-call]
                    dashboard_address=f"{LOOPBACK}:0",
                    scheduler_kwargs={"dashboard": False},  # it would be there if bokeh is installed
                    # distributed's default is by the number of cores, whatever the number of processes.
                    memory_limit=memory or system.MEMORY_LIMIT // workers,
                    # For the workers, also those that replace others later.
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

        Ctrl-C of a terminal goes to all processes of a command. It is for this one: threads and processes
        inherit what the event loop's thread blocks.
        """
        resource_tracker.ensure_running()  # which at its start would unblock it again
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        self.cluster.scale(self._number)
        await self.cluster._correct_state()

    def close(self, *, at_once: bool = False) -> None:
        """End all processes; kills those that need long, or, with `at_once`, do not compute yet."""
        if self.cluster is not None:
            ended = threading.Event()
            kill = threading.Thread(target=self._kill, args=(ended, 0.0 if at_once else CLOSE_SECONDS))
            kill.start()
            self.cluster.close()
            ended.set()
            kill.join()
        self._scratch.remove()

    def _kill(self, ended: threading.Event, seconds: float) -> None:
        """Kill the processes after so long, and those that replace them, until the cluster has ended."""
        while not ended.wait(seconds):
            for nanny in list(self.cluster.workers.values()):
                if nanny.pid:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(nanny.pid, signal.SIGKILL)
            seconds = KILL_SECONDS

    async def _replace_lost(self) -> None:
        """Runs in the cluster's event loop for as long as the cluster does."""
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
    """A folder for the workers' files that no other user can enter or foresee, locked while it is used.

    distributed's own would be `dask-scratch-space` in the system's folder for temporary files, where another
    user can make it first. The workers' part of it is the first place where they look for modules.
    """

    def __init__(self) -> None:
        _remove_abandoned(Path(tempfile.gettempdir()))
        self.folder = temporary.make(_SCRATCH)
        self._lock = (self.folder / _LOCK).open("w")
        fcntl.flock(self._lock, fcntl.LOCK_EX)

    def remove(self) -> None:
        """Remove it with all that is in it."""
        temporary.remove(self.folder)
        self._lock.close()


def _remove_abandoned(temporary: Path) -> None:
    """Remove the scratch folders that killed processes of this user left."""
    for folder in temporary.glob(f"{_SCRATCH}*"):
        with contextlib.suppress(OSError):
            status = folder.lstat()  # a link is another user's, or of no use
            if status.st_uid != os.geteuid() or time.time() - status.st_mtime < _SETTLED_SECONDS:
                continue
            with _locked(folder / _LOCK):
                shutil.rmtree(folder, ignore_errors=True)


def _locked(path: Path) -> IO[str]:
    """The file, locked until it is closed. Raises OSError if there is none or another process has it."""
    file = path.open()
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise
    return file
