"""Repair of stored results: damaged chunks are unmarked and computed again, damaged metadata rewritten."""

import logging
from collections.abc import Callable, Sequence
from typing import Final

from kernel.params import KERNEL_VERSION
from service.jobs.ledger import Ledger
from service.jobs.model import JobRecord
from service.jobs.prepare import JobPreparer
from worker import store
from worker.store import ChunkCoords

log = logging.getLogger(__name__)

#: Damaged chunks that a message describes; of more it gives the number.
MAX_DESCRIBED: Final = 3


class Repairer:
    """Repairs stores. Its methods may be called from any thread.

    `on_invalidated` is called with a job's id and its chunks when chunks are to be computed again.
    """

    def __init__(
        self, ledger: Ledger, preparer: JobPreparer, on_invalidated: Callable[[str, Sequence[int]], None]
    ) -> None:
        self._ledger, self._preparer, self._on_invalidated = ledger, preparer, on_invalidated

    def report(self, job_id: str, damaged: Sequence[ChunkCoords]) -> str:
        """Repair a store in which a reader met damage, in these chunks or outside any.

        Returns what is damaged and what becomes of it, fit to show to a user.
        """
        job = self._ledger.find(job_id)
        if job is None:
            return "the job was deleted"
        prepared = self._preparer.prepare(job)
        self.repair_metadata(job)
        chunks = [prepared.plan.number(*coords) for coords in damaged]
        self.invalidate(job, chunks)
        described = [prepared.describe(prepared.plan[i]) for i in chunks[:MAX_DESCRIBED]]
        more = f" and {len(chunks) - MAX_DESCRIBED} more" if len(chunks) > MAX_DESCRIBED else ""
        subject = f"{'; '.join(described)}{more}" if chunks else "the store's metadata"
        return f"stored results are damaged and computed again: {subject}"

    def repair_metadata(self, job: JobRecord) -> None:
        """Rewrite damaged metadata and coordinates; not those of another kernel version, which differ."""
        if job.kernel_version == KERNEL_VERSION:
            prepared = self._preparer.prepare(job)
            store.repair_metadata(prepared.store_url, prepared.layout, prepared.attributes)

    def invalidate(self, job: JobRecord, chunks: Sequence[int]) -> None:
        """Have chunks of a job computed again; until then their cells read as missing."""
        with self._ledger.writing() as ledger:
            current = ledger.find(job.id)
            if current is None or current.seq != job.seq:
                return  # deleted, and perhaps accepted again
            unmarked = ledger.unmark(current, chunks)
        if not unmarked:
            return
        log.error("job %s: chunks %s are damaged in the store and computed again", job.id, unmarked)
        prepared = self._preparer.prepare(job)
        try:
            for chunk in unmarked:
                store.discard(prepared.store_url, prepared.layout, prepared.plan[chunk])
        finally:  # they are unmarked, whether or not their files could be removed
            self._on_invalidated(job.id, unmarked)
