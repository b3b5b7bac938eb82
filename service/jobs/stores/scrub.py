"""Startup scrub: verifies stored checksums, repairs metadata, finds stores that the ledger does not know.

A thread goes once through the jobs that the ledger had at the start: first the unfinished ones, which wait
for it, then the others, the last accepted first. It reads every stored chunk once, which takes a fraction
of a millisecond per chunk. Damage in a job it has not reached is met when the job is read.
"""

import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from typing import Final

from service.jobs.ledger import Ledger
from service.jobs.model import UNFINISHED, JobRecord
from service.jobs.prepare import JobPreparer
from service.jobs.stores.adoption import find_unknown
from service.jobs.stores.repair import Repairer
from service.settings import Settings
from worker import store

log = logging.getLogger(__name__)

#: Chunks verified before the thread checks whether to stop, and whether a job waits for it.
CHUNKS_PER_PAGE: Final = 500
#: Jobs read from the ledger at once.
JOBS_PER_PAGE: Final = 100
#: Unknown stores that the log names one by one.
MAX_NAMED: Final = 20


class Scrubber:
    """Verifies what was stored before this start; `wake` is called whenever a job is verified."""

    def __init__(
        self,
        ledger: Ledger,
        settings: Settings,
        preparer: JobPreparer,
        repairer: Repairer,
        wake: Callable[[], None],
    ) -> None:
        self._ledger, self._settings, self._wake = ledger, settings, wake
        self._preparer, self._repairer = preparer, repairer
        self._verified: set[str] = set()
        self.unknown_stores: Sequence[str] = ()  # addresses; the ledger did not know them at the start
        self._newest = 0  # the last job there was at the start; later ones need no verification
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="scrubber", daemon=True)

    def start(self) -> None:
        """Start the thread; until then no job is verified."""
        with self._ledger.reading() as ledger:
            self._newest = ledger.newest_seq()
        self._thread.start()

    def stop(self, seconds: float) -> None:
        """End the thread, within `seconds`; the next start scrubs what was not reached."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(seconds)

    def is_verified(self, job_id: str) -> bool:
        """Whether every chunk marked as done of this job has been found intact since the start."""
        if job_id in self._verified:
            return True
        job = self._ledger.find(job_id)
        return job is not None and job.seq > self._newest

    def _work(self) -> None:
        while not self._stop.is_set():
            try:
                for job in chain(self._waiting(), self._all()):
                    if self._stop.is_set():
                        return
                    self._scrub(job)
                self._find_unknown()
                return
            except Exception:  # such as a ledger that does not answer
                pause = self._settings.heartbeat_seconds
                log.exception("scrub failed; starting again in %g s", pause)
                self._stop.wait(pause)

    def _all(self) -> Iterator[JobRecord]:
        """Every job there was at the start, the last accepted first; before each, those that wait."""
        before = self._newest + 1
        while True:
            with self._ledger.reading() as ledger:
                page = ledger.newest(None, JOBS_PER_PAGE, before)
            if not page:
                return
            for job in page:
                yield from self._waiting()
                if job.id not in self._verified:
                    yield job
            before = page[-1].seq

    def _waiting(self) -> Iterator[JobRecord]:
        """Unfinished jobs that are not verified: the supervisor waits for them."""
        with self._ledger.reading() as ledger:
            unfinished = [job.id for job in ledger.unfinished(self._settings.max_queue)]
        for job_id in unfinished:
            job = self._ledger.find(job_id)
            if job is not None and not self.is_verified(job_id) and job.state in UNFINISHED:
                yield job

    def _scrub(self, job: JobRecord) -> None:
        """Verify one job; a finished one is interrupted for those that are resumed meanwhile."""
        try:
            for _ in self._verify(job):
                if self._stop.is_set():
                    return
                if job.state not in UNFINISHED:
                    for other in self._waiting():
                        if other.id != job.id:
                            self._scrub(other)
        except Exception:
            log.exception("job %s cannot be verified; damage will be met when it is read", job.id)
        self._verified.add(job.id)
        self._wake()

    def _verify(self, job: JobRecord) -> Iterator[None]:
        """Remove leftovers of interrupted writes, repair metadata, verify chunks; yields after each page."""
        prepared = self._preparer.prepare(job)
        store.sweep_leftovers(prepared.store_url)
        if job.chunks_done:
            self._repairer.repair_metadata(job)
        last = -1
        while True:
            with self._ledger.reading() as ledger:
                page = ledger.checksums(job, last, CHUNKS_PER_PAGE)
            if not page:
                return
            marked = ((prepared.plan[chunk], checksum) for chunk, checksum in page)
            corrupt = store.find_corrupt(prepared.store_url, prepared.layout, marked)
            damaged = [chunk.index for chunk in corrupt]
            if damaged:
                self._repairer.invalidate(job, damaged)
            last = page[-1][0]
            yield

    def _find_unknown(self) -> None:
        """Report stores without a job in the ledger. They may be all that is left of a job: they stay."""
        self.unknown_stores = find_unknown(self._ledger, self._settings)
        for url in self.unknown_stores[:MAX_NAMED]:
            log.warning("%s is unknown to the ledger and left alone: bounce adopt takes it in", url)
        if more := len(self.unknown_stores[MAX_NAMED:]):
            log.warning("%d more stores are unknown to the ledger and left alone", more)
