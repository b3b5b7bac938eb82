"""A Dask cluster of this machine: a scheduler in this process and worker processes, on loopback only."""

import asyncio
import contextlib
import logging
import os
import signal
import threading
from typing import Any, Final

import dask
from distributed import LocalCluster, Status, system

from worker.executors.connection import SCHEDULER_SETTINGS

log = logging.getLogger(__name__)

#: Workers that have not ended by themselves after so long are killed.
CLOSE_SECONDS: Final = 2.0
#: The interval at which lost workers are replaced.
REPLACE_SECONDS: Final = 1.0
LOOPBACK: Final = "127.0.0.1"
#: distributed drops a worker for good if it is not back so long after a death. A worker may take longer on a
#: busy machine, so this is switched off.
_LOST_WORKER_SETTINGS: Final = {"distributed.deploy.lost-worker-timeout": "1000 days"}


class LocalWorkers:
    """A cluster of `workers` processes with one thread each, kept at that number until `close`.

    A process that dies is restarted by its nanny; a nanny that cannot do that, for lack of memory or of
    process numbers, is replaced. Each process may use `memory` bytes (None: an equal share of the
    machine's). Sets the Dask settings that its scheduler needs for this process.
    """

    def __init__(self, workers: int, memory: int | None) -> None:
        dask.config.set(SCHEDULER_SETTINGS | _LOST_WORKER_SETTINGS)
        self.cluster: Any = LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host=LOOPBACK,
            dashboard_address=f"{LOOPBACK}:0",
            # distributed's default is by the number of cores, whatever the number of processes.
            memory_limit=memory or system.MEMORY_LIMIT // workers,
        )
        self._number = workers
        loop: Any = self.cluster.loop
        loop.add_callback(self._replace_lost)

    def close(self) -> None:
        """End all processes. Kills those that are still starting: they may compile for a minute first."""
        kill = threading.Timer(CLOSE_SECONDS, _kill, [list(self.cluster.workers.values())])
        kill.start()
        self.cluster.close()
        kill.cancel()

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


def _kill(nannies: list[Any]) -> None:
    for nanny in nannies:
        if nanny.pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(nanny.pid, signal.SIGKILL)
