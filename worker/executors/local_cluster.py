"""Room: worker processes of this machine, and the scheduler that gives them work; all on loopback."""

import asyncio
import contextlib
import logging
import os
import signal
import threading
from typing import Any, Final

import dask
from distributed import LocalCluster, Status, system

from worker.executors.connection import SCHEDULER

log = logging.getLogger(__name__)

#: For workers to end by themselves.
CLOSE_SECONDS: Final = 2.0
#: How often it is looked whether every process is there.
KEEP_SECONDS: Final = 1.0
LOOPBACK: Final = "127.0.0.1"
#: distributed lets go for good of a worker that it does not see so long after one of its deaths: one that
#: comes up slowly on a busy machine, or has just died again. Ours are waited for.
LOST: Final = {"distributed.deploy.lost-worker-timeout": "1000 days"}


class LocalWorkers:
    """`workers` processes with one thread each, kept at that number until `close`.

    A process that dies is started again by its nanny; a nanny that could not do that, for want of
    memory or of process numbers, is replaced. Each process may use `memory` bytes; None: its share of
    the machine's.
    """

    def __init__(self, workers: int, memory: int | None) -> None:
        dask.config.set({name: wanted for name, (wanted, _) in SCHEDULER.items()} | LOST)
        self.cluster: Any = LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host=LOOPBACK,
            dashboard_address=f"{LOOPBACK}:0",
            # Not by the number of cores, which has nothing to do with how many processes there are.
            memory_limit=memory or system.MEMORY_LIMIT // workers,
        )
        self._number = workers
        loop: Any = self.cluster.loop
        loop.add_callback(self._keep)

    def close(self) -> None:
        """End every process, one that starts without a word: it may compile for a minute and hears none."""
        late = threading.Timer(CLOSE_SECONDS, _kill, [list(self.cluster.workers.values())])
        late.start()
        self.cluster.close()
        late.cancel()

    async def _keep(self) -> None:
        """In the cluster's event loop, for as long as it runs: what has no nanny any more gets one."""
        while self.cluster.status == Status.running:
            nannies = self.cluster.workers
            for name, nanny in list(nannies.items()):
                if nanny.status in (Status.closed, Status.failed):
                    del nannies[name]
            if gone := self._number - len(nannies):
                log.warning("%d of %d worker processes are gone; starting others", gone, self._number)
                with contextlib.suppress(Exception):  # it is tried again, and distributed says why
                    await self.cluster._correct_state()
            await asyncio.sleep(KEEP_SECONDS)


def _kill(nannies: list[Any]) -> None:
    for nanny in nannies:
        if nanny.pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(nanny.pid, signal.SIGKILL)
