"""Progress events: one ledger query at a time serves all listeners; none of them holds a thread."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Final

from starlette.concurrency import run_in_threadpool

from kernel.numerics.cache import Compilation
from service.ledger.ledger import Ledger
from service.ledger.model import UNFINISHED, JobRecord

#: Seconds between two queries for the same listener.
POLL_SECONDS: Final = 0.25

_Found = Mapping[str, JobRecord | None]


class ProgressStream:
    """Polls the ledger for listeners, in the event loop; only `close` may be called from any thread."""

    def __init__(self, ledger: Ledger, compiling: Callable[[JobRecord], Compilation | None]) -> None:
        self._ledger, self._compiling = ledger, compiling
        self._asked: set[str] = set()  # jobs of the next query
        self._next: asyncio.Future[_Found] | None = None
        self._querying = asyncio.Lock()
        self._closing = False

    def close(self) -> None:
        """End every iteration soon, so that open responses do not delay the shutdown."""
        self._closing = True

    async def changes(self, job_id: str) -> AsyncIterator[tuple[JobRecord, Compilation | None]]:
        """The job and the kernel compiled for it, now and after every change.

        Ends when the job is finished or deleted, or the service stops.
        """
        revision: tuple[object, ...] | None = None
        while not self._closing:
            job = await self._find(job_id)
            if job is None:
                return
            compiling = self._compiling(job)
            kernel = None if compiling is None else compiling.kernel
            if revision != (revision := (*job.revision(time.time()), kernel)):
                yield job, compiling
            if job.state not in UNFINISHED:
                return
            await asyncio.sleep(POLL_SECONDS)

    async def _find(self, job_id: str) -> JobRecord | None:
        """The job, found by the next query, which serves all that ask while another query runs."""
        self._asked.add(job_id)
        if self._next is None:
            self._next = asyncio.ensure_future(self._query())
        return (await asyncio.shield(self._next))[job_id]

    async def _query(self) -> _Found:
        async with self._querying:
            asked, self._asked, self._next = self._asked, set(), None
            find = self._ledger.find  # one by one: other readers come in between
            return await run_in_threadpool(lambda: {job_id: find(job_id) for job_id in asked})
