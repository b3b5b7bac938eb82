"""Progress events: one ledger query serves all listeners of a job; no listener holds a thread."""

import asyncio
from collections.abc import AsyncIterator
from typing import Final

from starlette.concurrency import run_in_threadpool

from service.jobs.ledger import Ledger
from service.jobs.model import UNFINISHED, JobRecord

#: Seconds between two queries for the same listener.
POLL_SECONDS: Final = 0.25


class ProgressStream:
    """Polls the ledger for listeners, in the event loop; only `close` may be called from any thread."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._queries: dict[str, asyncio.Future[JobRecord | None]] = {}
        self._closing = False

    def close(self) -> None:
        """End every iteration soon, so that open responses do not delay the shutdown."""
        self._closing = True

    async def changes(self, job_id: str) -> AsyncIterator[JobRecord]:
        """The job, now and after every change, until it is finished or deleted, or the service stops."""
        revision = None
        while not self._closing:
            job = await self._find(job_id)
            if job is None:
                return
            if revision != (revision := job.revision):
                yield job
            if job.state not in UNFINISHED:
                return
            await asyncio.sleep(POLL_SECONDS)

    async def _find(self, job_id: str) -> JobRecord | None:
        """The job, at most half a poll interval old; listeners of the same job share the query."""
        query = self._queries.get(job_id)
        if query is None:
            query = asyncio.ensure_future(run_in_threadpool(self._ledger.find, job_id))
            self._queries[job_id] = query
            asyncio.get_running_loop().call_later(POLL_SECONDS / 2, self._queries.pop, job_id, None)
        return await asyncio.shield(query)
