"""Verifies stored results in the background, repairs metadata, finds stores unknown to the ledger.

A thread goes once through the jobs in the ledger at the start: first the unfinished ones, then the others,
the last accepted first. No job waits for it: damage that it finds is computed again, like damage found by a
reader. In each job it first compares the sizes of all stored chunks, without reading files, and then reads
every chunk not verified since it was stored. The ledger records what was verified, so that a later start
continues from there; a done job is verified again after `verify_days`.
"""

import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from typing import Final

from service.errors import LedgerUnavailable
from service.jobs.ledger import Ledger
from service.jobs.model import UNFINISHED, JobRecord
from service.jobs.prepare import JobPreparer, PreparedJob
from service.jobs.stores.adoption import find_unknown
from service.jobs.stores.repair import Repairer
from service.jobs.transactions import VERIFIED_PAGE
from service.settings import Settings
from worker import store

log = logging.getLogger(__name__)

#: Pause four times as long as the last step took while jobs run: at most a fifth of a core.
PAUSES: Final = 4.0
#: Chunks read, or compared by size, between two pauses: requests wait for them.
READ_AT_ONCE: Final = 32
COMPARED_AT_ONCE: Final = 512
#: Jobs read from the ledger at once.
JOBS_PER_PAGE: Final = 100
#: Unknown stores logged one by one.
MAX_NAMED: Final = 20


class _Stopping(Exception):
    """The service stops."""


class Scrubber:
    """Verifies results of earlier starts, slowly while `is_computing` says that jobs compute."""

    def __init__(
        self,
        ledger: Ledger,
        settings: Settings,
        preparer: JobPreparer,
        repairer: Repairer,
        is_computing: Callable[[], bool],
    ) -> None:
        self._ledger, self._settings, self._is_computing = ledger, settings, is_computing
        self._preparer, self._repairer = preparer, repairer
        self._verified: set[str] = set()
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

    def is_verified(self, job_id: str) -> bool:
        """Whether every chunk done at the start has been found intact, or is computed again."""
        if job_id in self._verified:
            return True
        job = self._ledger.find(job_id)
        return job is not None and job.seq > self._newest

    def _work(self) -> None:
        while not self._stop.is_set():
            try:
                for job in chain(self._unfinished(), self._all()):
                    if self._stop.is_set():
                        return
                    self._scrub(job)
                self._find_unknown()
                return
            except LedgerUnavailable:  # the supervisor logs the reason
                self._stop.wait(self._settings.heartbeat_seconds)
            except Exception:
                pause = self._settings.heartbeat_seconds
                log.exception("scrub failed; starting again in %g s", pause)
                self._stop.wait(pause)

    def _all(self) -> Iterator[JobRecord]:
        """Every job of the start, the last accepted first."""
        before = self._newest + 1
        while True:
            with self._ledger.reading() as ledger:
                page = ledger.newest(None, JOBS_PER_PAGE, before)
            if not page:
                return
            yield from (job for job in page if job.id not in self._verified)
            before = page[-1].seq

    def _unfinished(self) -> Iterator[JobRecord]:
        """Unfinished jobs not yet verified."""
        with self._ledger.reading() as ledger:
            unfinished = [job.id for job in ledger.unfinished(self._settings.max_queue)]
        for job_id in unfinished:
            job = self._ledger.find(job_id)
            if job is not None and not self.is_verified(job_id) and job.state in UNFINISHED:
                yield job

    def _scrub(self, job: JobRecord) -> None:
        """Verify one job, unless it was verified recently. Raises LedgerUnavailable."""
        self._ledger.check()
        try:
            if not self._is_due(job):
                self._verified.add(job.id)
                return
            self._verify(job)
            with self._ledger.writing() as ledger:
                ledger.finish_verification(job, time.time())
        except _Stopping:
            return
        except LedgerUnavailable:
            raise
        except Exception:
            log.exception("job %s cannot be verified; damage will show when it is read", job.id)
        self._verified.add(job.id)

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
        """Pause, while chunks are computed, in proportion to the work since the last pause.

        Raises _Stopping.
        """
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
        self._repairer.repair_metadata(job)
        if job.outdated:  # chunks that only its metadata describe look damaged if these are
            store.stored_forms(prepared.store_url, None)
        self._verify_sizes(job, prepared)
        for page in range(-(-job.chunks_total // VERIFIED_PAGE)):
            self._verify_page(job, prepared, page)

    def _verify_sizes(self, job: JobRecord, prepared: PreparedJob) -> None:
        """Find missing chunks and those of another size, before reading any."""
        known = self._ledger.done_mask(job)  # before the files are listed, which may lack later ones
        sizes = store.stored_sizes(prepared.store_url, prepared.layout, self._pause)
        for first in range(0, job.chunks_total, COMPARED_AT_ONCE):
            self._pause()
            with self._ledger.reading() as ledger:
                marked = ledger.stored_chunks(job, first, first + COMPARED_AT_ONCE)
            suspects = []
            for index, checksum, size in marked:
                chunk = prepared.plan[index]
                found = sizes[prepared.layout.coords(chunk.slices)]
                if known[index] and (found < 0 or (size is not None and found != size)):
                    suspects.append((chunk, checksum))
            # Again: a chunk may have been recomputed since the files were listed.
            corrupt = store.find_corrupt(prepared.store_url, prepared.layout, suspects)
            self._invalidate(job, [chunk.index for chunk in corrupt])

    def _verify_page(self, job: JobRecord, prepared: PreparedJob, page: int) -> None:
        """Read the unverified chunks of a page."""
        first = page * VERIFIED_PAGE
        with self._ledger.reading() as ledger:
            verified = ledger.verified_chunks(job, page)
            marked = ledger.stored_chunks(job, first, first + VERIFIED_PAGE)
        unread = [(prepared.plan[index], sum_) for index, sum_, _ in marked if not verified[index - first]]
        if not unread:
            return
        damaged: set[int] = set()
        for begin in range(0, len(unread), READ_AT_ONCE):
            self._pause()
            reading = unread[begin : begin + READ_AT_ONCE]
            corrupt = store.find_corrupt(prepared.store_url, prepared.layout, reading)
            damaged.update(chunk.index for chunk in corrupt)
        verified[[chunk.index - first for chunk, _ in unread if chunk.index not in damaged]] = True
        with self._ledger.writing() as ledger:
            ledger.note_verified(job, page, verified)
        self.verified_chunks += len(unread)
        self._invalidate(job, sorted(damaged))

    def _invalidate(self, job: JobRecord, chunks: Sequence[int]) -> None:
        if chunks:
            self.damaged_chunks += len(chunks)
            self._repairer.invalidate(job, chunks)

    def _find_unknown(self) -> None:
        """Report stores without a job in the ledger. They may be all that remains of a job: they stay."""
        self.unknown_stores = find_unknown(self._ledger, self._settings)
        for url in self.unknown_stores[:MAX_NAMED]:
            log.warning("%s is unknown to the ledger and left alone: bounce adopt takes it in", url)
        if more := len(self.unknown_stores[MAX_NAMED:]):
            log.warning("%d more stores are unknown to the ledger and left alone", more)
