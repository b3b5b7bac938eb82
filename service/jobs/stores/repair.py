"""Repair of stored results: damaged chunks are unmarked and computed again, damaged metadata rewritten.

A job of another kernel version is not repaired, because this release would add other numbers to its results:
its damaged chunks are given up and read as missing.
"""

import logging
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Final, NamedTuple

from service.jobs.ledger import Ledger
from service.jobs.model import Failure, JobRecord
from service.jobs.prepare import JobPreparer
from worker import store
from worker.store import ChunkCoords

log = logging.getLogger(__name__)

#: Damaged chunks described in a message; the others are only counted.
MAX_DESCRIBED: Final = 3


class Repair(NamedTuple):
    """The damage and its consequence, for users; `lasting`: it stays as it is."""

    detail: str
    lasting: bool = False


class Repairer:
    """Repairs stores. Its methods may be called from any thread.

    `invalidating` is entered with a job's id while chunks are unmarked and their bytes removed; chunks added
    to its list are computed again. `after_writing` is called with a job whose store was written to: it may
    have been deleted meanwhile.
    """

    def __init__(
        self,
        ledger: Ledger,
        preparer: JobPreparer,
        invalidating: Callable[[str], AbstractContextManager[list[int]]],
        after_writing: Callable[[JobRecord], None] = lambda job: None,
    ) -> None:
        self._ledger, self._preparer = ledger, preparer
        self._invalidating, self._after_writing = invalidating, after_writing

    def report(self, job_id: str, damaged: Sequence[ChunkCoords]) -> Repair:
        """Repair a store in which a reader found damage, in these chunks or outside any."""
        job = self._ledger.find(job_id)
        if job is None:
            return Repair("the job was deleted")
        prepared = self._preparer.prepare(job)
        self.repair_metadata(job)
        chunks = [prepared.plan.number(*coords) for coords in damaged]
        self.invalidate(job, chunks)
        described = [prepared.describe(prepared.plan[i]) for i in chunks[:MAX_DESCRIBED]]
        more = f" and {len(chunks) - MAX_DESCRIBED} more" if len(chunks) > MAX_DESCRIBED else ""
        subject = f"{'; '.join(described)}{more}" if chunks else "the store's metadata"
        if not job.outdated:
            return Repair(f"stored results are damaged and computed again: {subject}")
        if chunks:
            return Repair(f"stored results are damaged and missing from now on: {subject} ({job.notice})")
        return Repair(f"stored results are damaged: {subject} ({job.notice})", lasting=True)

    def repair_metadata(self, job: JobRecord) -> None:
        """Rewrite damaged metadata and coordinates, but not those of an outdated job, which differ."""
        if not job.outdated:
            self._ledger.check()
            prepared = self._preparer.prepare(job)
            if store.repair_metadata(prepared.store_url, prepared.layout, prepared.attributes):
                self._after_writing(job)

    def invalidate(self, job: JobRecord, chunks: Sequence[int]) -> None:
        """Queue chunks of a job to be computed again; until then their cells read as missing.

        Those of an outdated job are given up: their cells stay missing, and a done job becomes failed.
        Raises LedgerUnavailable, also if the stores are missing.
        """
        self._ledger.check()
        with self._invalidating(job.id) as computed_again:
            with self._ledger.writing() as ledger:
                current = ledger.find(job.id)
                if current is None or current.seq != job.seq:
                    return  # deleted, and perhaps accepted again
                if job.outdated:
                    unmarked = ledger.lose(current, [self._lost(current, chunk) for chunk in chunks])
                else:
                    unmarked = ledger.unmark(current, chunks)
            if not unmarked:
                return
            if not job.outdated:  # whether or not their files can be removed
                computed_again.extend(unmarked)
            fate = "given up" if job.outdated else "computed again"
            log.error("job %s: chunks %s are damaged in the store and %s", job.id, unmarked, fate)
            prepared = self._preparer.prepare(job)
            for chunk in unmarked:
                store.discard(prepared.store_url, prepared.layout, prepared.plan[chunk])

    def _lost(self, job: JobRecord, chunk: int) -> Failure:
        prepared = self._preparer.prepare(job)
        error = f"its stored results were damaged ({job.notice}): resume the job to compute all of it anew"
        return Failure(chunk, prepared.describe(prepared.plan[chunk]), error, None, tries=0)
