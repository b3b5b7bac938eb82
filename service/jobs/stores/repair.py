"""Verifies stored results in the background and repairs damage, also what readers find.

Damaged chunks are unmarked and computed again, damaged metadata rewritten. A job of another kernel version is
not repaired, because this release would add other numbers to its results: its damaged chunks are given up and
read as missing.

At the start a thread goes once through the jobs in the ledger, the last accepted first; no job waits for it.
In each it first compares the sizes of all stored chunks, without reading files, and then reads every chunk
that was not verified since it was stored. The ledger records what was verified, so that a later start
continues from there; a done job is verified again after `verify_days`.
"""

import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from typing import Final, NamedTuple

from service.errors import LedgerUnavailable
from service.jobs.prepare import JobPreparer, PreparedJob
from service.jobs.stores.adoption import find_unknown
from service.ledger.ledger import Ledger
from service.ledger.model import UNFINISHED, Failure, JobRecord
from service.ledger.transactions import VERIFIED_PAGE, StoredChunk
from service.settings import Settings
from worker import store
from worker.store import ChunkCoords
from worker.studies import Chunk

log = logging.getLogger(__name__)

#: Pause four times as long as the last step took while jobs run: at most a fifth of a core.
PAUSES: Final = 4.0
#: Chunks read between two pauses: requests wait for them.
READ_AT_ONCE: Final = 32
#: Jobs read from the ledger at once.
JOBS_PER_PAGE: Final = 100
#: Unknown stores logged one by one.
MAX_NAMED: Final = 20
#: Damaged chunks described in a message; the others are only counted.
MAX_DESCRIBED: Final = 3


class Repair(NamedTuple):
    """The damage and its consequence, for users; `lasting`: it stays as it is."""

    detail: str
    lasting: bool = False


class _Stopping(Exception):
    """The service stops."""


class Scrubber:
    """Repairs stores, and verifies results of earlier starts, slowly while `is_computing`.

    `invalidating` is entered with a job's id while chunks are unmarked and their bytes removed; chunks added
    to its list are computed again. `after_writing` is called with a job whose store was written to: it may
    have been deleted meanwhile. `report`, `repair_metadata` and `invalidate` may be called from any thread.
    """

    def __init__(
        self,
        ledger: Ledger,
        settings: Settings,
        preparer: JobPreparer,
        invalidating: Callable[[str], AbstractContextManager[list[int]]],
        after_writing: Callable[[JobRecord], None],
        is_computing: Callable[[], bool],
    ) -> None:
        self._ledger, self._settings, self._preparer = ledger, settings, preparer
        self._invalidating, self._after_writing = invalidating, after_writing
        self._is_computing = is_computing
        self.verified: set[str] = set()  # jobs whose chunks were found intact, or are computed again
        self.unknown_stores: Sequence[str] = ()  # addresses; the ledger did not know them at the start
        self.verified_chunks = self.damaged_chunks = 0  # since the start
        self._newest = 0  # the last job at the start; later ones need no verification
        self._stop = threading.Event()
        self._clock: Callable[[], float] = time.monotonic
        self._resumed = 0.0  # when the last pause ended, by the clock
        self._thread = threading.Thread(target=self._work, name="scrubber", daemon=True)

    def start(self) -> None:
        """Start the thread; it verifies nothing before."""
        with self._ledger.reading() as ledger:
            self._newest = ledger.newest_seq()
        self._thread.start()

    def stop(self, seconds: float) -> None:
        """End the thread within `seconds`; the next start scrubs the rest."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(seconds)

    def _work(self) -> None:
        pause = self._settings.heartbeat_seconds
        while not self._stop.is_set():
            try:
                for job in self._jobs():
                    if self._stop.is_set():
                        return
                    self._scrub(job)
                self._find_unknown()
                return
            except _Stopping:
                return
            except LedgerUnavailable:  # the supervisor logs the reason
                self._stop.wait(pause)
            except Exception:
                log.exception("scrub failed; starting again in %g s", pause)
                self._stop.wait(pause)

    def _jobs(self) -> Iterator[JobRecord]:
        """The jobs of the start that are not verified, the last accepted first."""
        before = self._newest + 1
        while True:
            with self._ledger.reading() as ledger:
                page = ledger.newest(None, JOBS_PER_PAGE, before)
            if not page:
                return
            yield from (job for job in page if job.id not in self.verified)
            before = page[-1].seq

    def _scrub(self, job: JobRecord) -> None:
        """Verify one job, unless it was verified recently. Raises LedgerUnavailable, _Stopping."""
        self._ledger.check()
        try:
            if self._is_due(job):
                self._verify(job)
                with self._ledger.writing() as ledger:
                    ledger.finish_verification(job, time.time())
        except (LedgerUnavailable, _Stopping):
            raise
        except Exception:
            log.exception("job %s cannot be verified; damage will show when it is read", job.id)
        self.verified.add(job.id)

    def _is_due(self, job: JobRecord) -> bool:
        """Whether a job is to be verified: all of it, if its last verification is long ago."""
        if job.verified is None or job.state in UNFINISHED:
            return True
        if job.finished is not None and job.finished > job.verified:
            return True  # chunks were stored since
        if time.time() - job.verified < self._settings.verify_days * 86_400:
            return False
        with self._ledger.writing() as ledger:
            ledger.forget_verification(job)
        return True

    def _pause(self) -> None:
        """Pause, while chunks are computed, in proportion to the work since then. Raises _Stopping."""
        pause = PAUSES * (self._clock() - self._resumed) if self._is_computing() else 0.0
        if self._stop.wait(pause):
            raise _Stopping
        self._resumed = self._clock()

    def _verify(self, job: JobRecord) -> None:
        """Remove leftovers of interrupted writes, repair metadata, verify chunks. Raises _Stopping."""
        prepared = self._preparer.prepare(job)
        # Waiting for a bucket takes nothing from others.
        self._clock = time.process_time if store.in_bucket(prepared.store_url) else time.monotonic
        self._resumed = self._clock()
        if job.state not in UNFINISHED:  # unfinished ones are swept as they start
            store.sweep_leftovers(prepared.store_url)
        if not job.chunks_done:
            return
        self.repair_metadata(job)
        if job.outdated:  # chunks that only its metadata describe look damaged if these are
            store.stored_forms(prepared.store_url, None)
        pages = range(-(-job.chunks_total // VERIFIED_PAGE))
        known = self._ledger.done_mask(job)  # before the files are listed, which may lack later ones
        sizes = store.stored_sizes(prepared.store_url, prepared.layout, self._pause)
        for page in pages:
            self._pause()
            suspects = []
            for index, checksum, size in self._marked(job, page):
                chunk = prepared.plan[index]
                found = sizes[prepared.layout.coords(chunk.slices)]
                if known[index] and (found < 0 or (size is not None and found != size)):
                    suspects.append((chunk, checksum))
            # A chunk may have been recomputed since the files were listed.
            self._invalidate(job, self._corrupt(prepared, suspects))
        for page in pages:
            self._read_page(job, prepared, page)

    def _read_page(self, job: JobRecord, prepared: PreparedJob, page: int) -> None:
        """Read the unverified chunks of a page."""
        first, marked = page * VERIFIED_PAGE, self._marked(job, page)
        with self._ledger.reading() as ledger:
            verified = ledger.verified_chunks(job, page)
        unread = [(prepared.plan[index], sum_) for index, sum_, _ in marked if not verified[index - first]]
        damaged: set[int] = set()
        for begin in range(0, len(unread), READ_AT_ONCE):
            self._pause()
            damaged.update(self._corrupt(prepared, unread[begin : begin + READ_AT_ONCE]))
        if unread:
            verified[[chunk.index - first for chunk, _ in unread if chunk.index not in damaged]] = True
            with self._ledger.writing() as ledger:
                ledger.note_verified(job, page, verified)
            self.verified_chunks += len(unread)
            self._invalidate(job, sorted(damaged))

    def _marked(self, job: JobRecord, page: int) -> list[StoredChunk]:
        with self._ledger.reading() as ledger:
            return ledger.stored_chunks(job, page * VERIFIED_PAGE, (page + 1) * VERIFIED_PAGE)

    def _corrupt(self, prepared: PreparedJob, chunks: Sequence[tuple[Chunk, str]]) -> list[int]:
        found = store.find_corrupt(prepared.store_url, prepared.layout, chunks)
        return [chunk.index for chunk in found]

    def _invalidate(self, job: JobRecord, chunks: Sequence[int]) -> None:
        if chunks:
            self.damaged_chunks += len(chunks)
            self.invalidate(job, chunks)

    def _find_unknown(self) -> None:
        """Report stores without a job in the ledger. They may be all that remains of a job: they stay."""
        self.unknown_stores = find_unknown(self._ledger, self._settings)
        for url in self.unknown_stores[:MAX_NAMED]:
            log.warning("%s is unknown to the ledger and left alone: bounce adopt takes it in", url)
        if more := len(self.unknown_stores[MAX_NAMED:]):
            log.warning("%d more stores are unknown to the ledger and left alone", more)

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
        prepared = self._preparer.prepare(job)
        error = f"its stored results were damaged ({job.notice}): resume the job to compute all of it anew"
        with self._invalidating(job.id) as computed_again:
            with self._ledger.writing() as ledger:
                current = ledger.find(job.id)
                if current is None or current.seq != job.seq:
                    return  # deleted, and perhaps accepted again
                if job.outdated:
                    places = {chunk: prepared.describe(prepared.plan[chunk]) for chunk in chunks}
                    lost = [Failure(chunk, place, error, None, tries=0) for chunk, place in places.items()]
                    unmarked = ledger.lose(current, lost)
                else:
                    unmarked = ledger.unmark(current, chunks)
            if not unmarked:
                return
            if not job.outdated:  # whether or not their files can be removed
                computed_again.extend(unmarked)
            fate = "given up" if job.outdated else "computed again"
            log.error("job %s: chunks %s are damaged in the store and %s", job.id, unmarked, fate)
            for chunk in unmarked:
                store.discard(prepared.store_url, prepared.layout, prepared.plan[chunk])
