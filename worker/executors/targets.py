"""What a connection connects to, now and after each loss: an address, a scheduler file, or a cluster object.

`CreatedCluster` creates a cluster by a user's function, replaces lost workers, and creates another cluster
when the scheduler is gone for good.
"""

import asyncio
import contextlib
import json
import logging
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Protocol

from worker.executors.errors import ClusterLost

log = logging.getLogger(__name__)

#: Errors when no scheduler can be reached: a time-out is an OSError, a scheduler file may be half written.
NO_SCHEDULER: Final = (OSError, ValueError, KeyError, TypeError)
#: A cluster is replaced after this many unanswered connections in a row.
UNANSWERED: Final = 3
#: Seconds until a failed function is called again: the first pause, doubled each time, and the longest.
FIRST_PAUSE, LONGEST_PAUSE = 1.0, 60.0
#: Seconds between checks for lost workers.
REFILL_SECONDS: Final = 5.0
#: The states of a Dask cluster that no longer computes.
_ENDED: Final = frozenset({"closed", "closing", "failed"})


class Target(Protocol):
    """What a connection connects to. Its methods are called from the connection's threads, one at a time."""

    def find(self) -> Any:
        """The scheduler's address, or a cluster object. Raises ClusterLost, or one of NO_SCHEDULER."""

    def unanswered(self) -> None:
        """Note that the result of `find` does not answer."""

    def refill(self) -> None:
        """Replace lost workers; does not block."""

    def planned(self) -> int | None:
        """Number of workers that the cluster should have; None if unknown."""

    def close(self) -> None:
        """Close what `find` has created."""


class Fixed:
    """A scheduler at one address, or a cluster object that its owner closes."""

    def __init__(self, address: Any) -> None:
        self._address = address

    def find(self) -> Any:
        return self._address

    def unanswered(self) -> None: ...

    def refill(self) -> None: ...

    def planned(self) -> int | None:
        return planned(self._address)

    def close(self) -> None: ...


class SchedulerFile(Fixed):
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


class CreatedCluster:
    """A cluster returned by `function()`, created again when it has ended or its scheduler does not answer.

    `name` is for messages. A function that fails is called again after FIRST_PAUSE seconds, doubled each time
    up to LONGEST_PAUSE.
    """

    def __init__(self, function: Callable[[], Any], name: str) -> None:
        self._function, self._name = function, name
        self._cluster: Any = None
        self._unanswered = 0  # connections in a row
        self._pause, self._next_try, self._failure = 0.0, 0.0, ""
        self._next_refill = 0.0

    def find(self) -> Any:
        if self._cluster is not None and self._has_ended():
            self._discard("it has ended")
        if self._cluster is None:
            self._cluster = self._create()
            self._unanswered, self._next_refill = 0, time.monotonic() + REFILL_SECONDS
        return self._cluster

    def unanswered(self) -> None:
        self._unanswered += 1
        if self._cluster is not None and self._unanswered >= UNANSWERED:
            self._discard("its scheduler does not answer")

    def refill(self) -> None:
        """Replace lost workers of a cluster of fixed size; adaptive clusters do so themselves."""
        now = time.monotonic()
        if self._cluster is None or now < self._next_refill or not hasattr(self._cluster, "worker_spec"):
            return
        self._next_refill = now + REFILL_SECONDS
        if len(self._cluster.workers) < len(self._cluster.worker_spec):
            log.warning("%s has lost workers; starting others", self._name)
            asyncio.run_coroutine_threadsafe(_start_missing(self._cluster), self._cluster.loop.asyncio_loop)

    def planned(self) -> int | None:
        return planned(self._cluster)

    def close(self) -> None:
        if self._cluster is not None:
            cluster, self._cluster = self._cluster, None
            if hasattr(cluster, "close"):
                cluster.close()

    def _has_ended(self) -> bool:
        status = getattr(self._cluster, "status", None)
        return getattr(status, "name", status) in _ENDED

    def _discard(self, why: str) -> None:
        log.warning("the cluster of %s is made again: %s", self._name, why)
        with contextlib.suppress(Exception):  # the rest cannot be closed either
            self.close()
        self._cluster = None
        self._postpone()

    def _postpone(self) -> None:
        self._pause = min(2 * self._pause, LONGEST_PAUSE) if self._pause else FIRST_PAUSE
        self._next_try = time.monotonic() + self._pause

    def _create(self) -> Any:
        if (wait := self._next_try - time.monotonic()) > 0:
            raise ClusterLost(f"no cluster from {self._name}{self._failure}; made again in {wait:.0f} s")
        try:
            cluster = self._function()
        except Exception as error:
            self._failure = f": {type(error).__name__}: {error}"
            self._postpone()
            raise ClusterLost(f"no cluster from {self._name}{self._failure}") from error
        self._pause, self._failure = 0.0, ""
        return cluster


def planned(cluster: Any) -> int | None:
    """The size that a cluster object should have; None for an address or an object that does not know."""
    with contextlib.suppress(Exception):
        return len(cluster.plan)
    return None


async def _start_missing(cluster: Any) -> None:
    """Await the cluster, which makes distributed start its missing workers."""
    with contextlib.suppress(Exception):  # the next check tries again
        await cluster
