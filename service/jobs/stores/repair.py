"""Finds damage in stores and repairs it.

Damaged chunks are unmarked and computed again; damaged metadata are rewritten. A job of another kernel
version is not repaired, because this release would add other numbers to its results. Its damaged chunks are
given up, and read as missing.
"""

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from service.errors import UnknownJob
from service.jobs.prepare import JobPreparer, PreparedJob
from service.jobs.stores.deletion import remove_if_deleted
from service.ledger.ledger import Ledger
from service.ledger.model import Failure, JobRecord
from worker import store
from worker.store import ChunkCoords

#: Damaged chunks described in a message; the others are only counted.
MAX_DESCRIBED: Final = 3


class Repair(NamedTuple):
    """The damage and its consequence, for users."""

    detail: str
    lasting: bool = False  # the damage remains
    unmarked: Sequence[int] = ()  # chunks to compute again


def repair(ledger: Ledger, preparer: JobPreparer, job_id: str, damaged: Sequence[ChunkCoords]) -> Repair:
    """Repair a store in which a reader found damage, in these chunks or, without any, in its metadata.

    No run of the job may begin meanwhile: it would find chunks unmarked, and its new results would be removed
    with the old ones. Raises UnknownJob, LedgerUnusable, or LedgerUnavailable, also without the stores.
    """
    job = ledger.find(job_id)
    if job is None:
        raise UnknownJob.of(job_id)
    ledger.check()
    prepared = preparer.prepare(job)
    repair_metadata(ledger, job, prepared)
    chunks = [prepared.plan.number(*coords) for coords in damaged]
    unmarked = _invalidate(ledger, job, prepared, chunks) if chunks else []
    subject = describe(prepared, damaged)
    if not job.outdated:
        return Repair(f"stored results are damaged and computed again: {subject}", unmarked=unmarked)
    if chunks:
        return Repair(f"stored results are damaged and missing from now on: {subject} ({job.notice})")
    return Repair(f"stored results are damaged: {subject} ({job.notice})", lasting=True)


def describe(prepared: PreparedJob, damaged: Sequence[ChunkCoords]) -> str:
    """The damaged chunks, or metadata, of a store."""
    numbers = sorted(prepared.plan.number(*coords) for coords in damaged)
    chunks = [prepared.plan[number] for number in numbers[:MAX_DESCRIBED]]
    more = f" and {len(damaged) - MAX_DESCRIBED} more" if len(damaged) > MAX_DESCRIBED else ""
    return f"{'; '.join(map(prepared.describe, chunks))}{more}" if chunks else "the store's metadata"


def repair_metadata(ledger: Ledger, job: JobRecord, prepared: PreparedJob) -> list[str]:
    """Rewrite damaged metadata and coordinates, but not those of an outdated job, which differ: the keys."""
    if job.outdated:
        return []
    rewritten = store.repair_metadata(prepared.store_url, prepared.layout, prepared.attributes)
    if rewritten:
        remove_if_deleted(ledger, job)
    return rewritten


def _invalidate(ledger: Ledger, job: JobRecord, prepared: PreparedJob, chunks: Sequence[int]) -> list[int]:
    """Unmark chunks, or give up those of an outdated job; their cells then read as missing. Returns them."""
    error = f"its stored results were damaged ({job.notice}): resume the job to compute all of it anew"
    with ledger.writing() as writing:
        current = writing.find(job.id)
        if current is None or current.seq != job.seq:
            return []  # it was deleted, even if it was accepted again
        if job.outdated:
            places = {chunk: prepared.describe(prepared.plan[chunk]) for chunk in chunks}
            lost = [Failure(chunk, place, error, None, tries=0) for chunk, place in places.items()]
            unmarked = writing.lose(current, lost)
        else:
            unmarked = writing.unmark(current, chunks)
    for chunk in unmarked:
        store.discard(prepared.store_url, prepared.layout, prepared.plan[chunk])
    return unmarked


def find_damage(prepared: PreparedJob, done: Iterable[int]) -> list[ChunkCoords]:
    """Read a whole store; the damaged chunks among those marked `done`.

    Raises StoreError if the metadata are damaged.
    """
    url, layout = prepared.store_url, prepared.layout
    store.stored_forms(url, prepared.forms)
    for key in prepared.metadata or ():
        prepared.read_file(key, complete=True)
    damaged = []
    for chunk in map(prepared.plan.__getitem__, done):
        try:
            store.read_chunk(url, chunk, layout.names, complete=True)
        except store.StoreDamaged:
            damaged.append(layout.coords(chunk.slices))
    return damaged
