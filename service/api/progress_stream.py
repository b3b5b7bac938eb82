"""Progress as it happens: one look at the ledger for all who listen, no thread for any of them."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from typing import Final

from starlette.concurrency import run_in_threadpool

from service.api import schemas
from service.errors import Busy
from service.jobs.ledger import Ledger
from service.jobs.model import UNFINISHED, JobRecord

#: Seconds between two looks at a job that somebody listens to.
LOOK_SECONDS: Final = 0.25


class ProgressStream:
    """Looks at jobs for those who listen. Used in the event loop, but for `close`."""

    def __init__(self, ledger: Ledger, most: int) -> None:
        self._ledger, self._most = ledger, most
        self._looks: dict[str, asyncio.Future[JobRecord | None]] = {}
        self._listeners = 0
        self._closing = False

    @contextmanager
    def place(self) -> Iterator[None]:
        """A place among the listeners. Raises Busy."""
        if self._listeners >= self._most:
            raise Busy(f"{self._most} listen to events already, at most so many may; poll the job instead")
        self._listeners += 1
        try:
            yield
        finally:
            self._listeners -= 1

    def close(self) -> None:
        """End every listening soon, so that no open answer holds up the end of the service."""
        self._closing = True

    async def changes(self, job_id: str) -> AsyncIterator[JobRecord]:
        """The job, now and after every change, until it is finished, deleted, or the service stops."""
        told = None
        while not self._closing:
            job = await self._look(job_id)
            if job is None:
                return
            if told != (told := schemas.etag(job)):
                yield job
            if job.state not in UNFINISHED:
                return
            await asyncio.sleep(LOOK_SECONDS)

    async def _look(self, job_id: str) -> JobRecord | None:
        """One look at the ledger serves all who listen to the same job at about the same time."""
        look = self._looks.get(job_id)
        if look is None:
            look = asyncio.ensure_future(run_in_threadpool(self._ledger.find, job_id))
            self._looks[job_id] = look
            asyncio.get_running_loop().call_later(LOOK_SECONDS / 2, self._looks.pop, job_id, None)
        return await asyncio.shield(look)
