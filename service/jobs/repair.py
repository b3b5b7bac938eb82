"""What is marked as done but is not in the store as it was written: named, unmarked, computed again."""

import logging
from collections.abc import Callable, Sequence

from kernel.params import KERNEL_VERSION
from service.jobs.ledger import Ledger
from service.jobs.model import JobRecord
from service.jobs.model_selection import attributes_of
from service.jobs.run import describe_chunk
from service.settings import Settings
from worker import store
from worker.plan import Plan, make_plan
from worker.schema import layout
from worker.spec import SweepSpec
from worker.store import ChunkCoords

log = logging.getLogger(__name__)


class Repairer:
    """Undoes chunks that are damaged; `invalidated` lets the supervisor know."""

    def __init__(
        self, ledger: Ledger, settings: Settings, invalidated: Callable[[str, Sequence[int]], None]
    ) -> None:
        self._ledger, self._settings, self._undone = ledger, settings, invalidated

    def found(self, job_id: str, places: Sequence[ChunkCoords]) -> str:
        """Someone met damage, in these chunks or outside any. Says what it is and what becomes of it."""
        job = self._ledger.find(job_id)
        if job is None:
            return "the job was deleted"
        spec, plan = planned(job)
        if job.kernel_version == KERNEL_VERSION:
            store.repair_metadata(
                self._settings.store_of(job_id), layout(spec, plan.chunk_shape), attributes_of(job)
            )
        chunks = [plan.number(*one) for one in places]
        self.undo(job, chunks)
        named = "; ".join(describe_chunk(spec, plan[chunk]) for chunk in chunks[:3])
        more = f" and {len(chunks) - 3} more" if len(chunks) > 3 else ""
        what = f"{named}{more}" if chunks else "the store's description"
        return f"stored results are damaged and computed again: {what}"

    def undo(self, job: JobRecord, chunks: Sequence[int]) -> None:
        """Have chunks of a job computed again; until then their cells read as missing."""
        with self._ledger.writing() as ledger:
            known = ledger.find(job.id)
            gone = ledger.unmark(known, chunks) if known is not None and known.seq == job.seq else []
        if not gone:
            return
        log.error("job %s: chunks %s are damaged in the store and computed again", job.id, gone)
        spec, plan = planned(job)
        for chunk in gone:
            store.discard(self._settings.store_of(job.id), layout(spec, plan.chunk_shape), plan[chunk])
        self._undone(job.id, gone)


def planned(job: JobRecord) -> tuple[SweepSpec, Plan]:
    """What a job computes and how it is cut."""
    spec = SweepSpec.from_json(job.spec)
    return spec, make_plan(spec, chunk_shape=job.chunk_shape)
