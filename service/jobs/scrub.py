"""What an earlier life of the service may have left: results that no longer are what was written, litter.

A thread of its own looks through every job that was there at the start: first, one that goes on, which
waits for it; then the others, the last accepted first. It reads each stored chunk once, a fraction of a
millisecond for each.
"""

import logging
import re
import threading
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import Final

from kernel.params import KERNEL_VERSION
from service.jobs.ledger import Ledger
from service.jobs.model import UNFINISHED, JobRecord
from service.jobs.model_selection import attributes_of
from service.jobs.repair import Repairer, planned
from service.settings import Settings
from worker import store
from worker.schema import layout

log = logging.getLogger(__name__)

#: Chunks looked at between two looks at whether to stop, or whether a job waits.
PAGE: Final = 500
#: Jobs read from the ledger at once.
JOBS: Final = 100
#: What lies in the folder of the stores: stores, their marks, and what is being removed.
_OURS: Final = re.compile(r"([0-9a-f]{32})\.zarr(\.cancelled|\.deleted-[0-9a-f]+)?")


class Scrubber:
    """Verifies what was done before this start; `wake` is called whenever a job is cleared."""

    def __init__(
        self, ledger: Ledger, settings: Settings, repairer: Repairer, wake: Callable[[], None]
    ) -> None:
        self._ledger, self._settings, self._repairer, self._wake = ledger, settings, repairer, wake
        self._clear: set[str] = set()
        self._newest = 0  # jobs accepted later need no looking at
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="housekeeper", daemon=True)

    def start(self) -> None:
        """Begin. Until then no job is clear."""
        with self._ledger.reading() as ledger:
            self._newest = ledger.newest_seq()
        self._thread.start()

    def stop(self, seconds: float) -> None:
        """End, in at most so long; what was not looked at is looked at after the next start."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(seconds)

    def is_clear(self, job_id: str) -> bool:
        """Whether everything marked as done of this job was found to be there since the start."""
        if job_id in self._clear:
            return True
        job = self._ledger.find(job_id)
        return job is not None and job.seq > self._newest

    def _work(self) -> None:
        while not self._stop.is_set():
            try:
                self._sweep()
                for job in chain(self._waiting(), self._others()):
                    if self._stop.is_set():
                        return
                    self._look_at(job)
                return
            except Exception:  # the ledger may be out of reach
                log.exception("housekeeping stumbled; it begins again soon")
                self._stop.wait(self._settings.heartbeat_seconds)

    def _others(self) -> Iterator[JobRecord]:
        """Every job there was at the start, the last accepted first; before each, those that wait."""
        before = self._newest + 1
        while True:
            with self._ledger.reading() as ledger:
                found = ledger.newest(None, JOBS, before)
            if not found:
                return
            for job in found:
                yield from self._waiting()
                if job.id not in self._clear:
                    yield job
            before = found[-1].seq

    def _waiting(self) -> Iterator[JobRecord]:
        """Jobs that shall go on and have not been looked at."""
        with self._ledger.reading() as ledger:
            wanted = [one.id for one in ledger.unfinished(self._settings.max_queue)]
        for job_id in wanted:
            job = self._ledger.find(job_id)
            if job is not None and not self.is_clear(job_id) and job.state in UNFINISHED:
                yield job

    def _look_at(self, job: JobRecord) -> None:
        """Clear one job; those that begin to wait meanwhile go before one that has ended."""
        try:
            for _ in self._verify(job):
                if self._stop.is_set():
                    return
                if job.state not in UNFINISHED:
                    for other in self._waiting():
                        if other.id != job.id:
                            self._look_at(other)
        except Exception:
            log.exception("job %s cannot be looked at; damage will be met when it is read", job.id)
        self._clear.add(job.id)
        self._wake()

    def _verify(self, job: JobRecord) -> Iterator[None]:
        """Sweep, mend and verify a store, page by page."""
        url = self._settings.store_of(job.id)
        spec, plan = planned(job)
        store.sweep_leftovers(url)
        if job.chunks_done and job.kernel_version == KERNEL_VERSION:
            store.repair_metadata(url, layout(spec, plan.chunk_shape), attributes_of(job))
        last = -1
        while True:
            with self._ledger.reading() as ledger:
                page = ledger.checksums(job, last, PAGE)
            if not page:
                return
            marked = ((plan[chunk], checksum) for chunk, checksum in page)
            damaged = [
                chunk.index for chunk in store.find_corrupt(url, layout(spec, plan.chunk_shape), marked)
            ]
            if damaged:
                self._repairer.undo(job, damaged)
            last = page[-1][0]
            yield

    def _sweep(self) -> None:
        """Remove stores and marks of jobs that are not in the ledger, as an interrupted deletion leaves."""
        if self._newest == 0 or self._settings.stores is not None:
            return  # stores beside an empty ledger, or in a folder of their own, may be somebody else's
        for path in list(Path(self._settings.store_of("")).parent.glob("*")):
            ours = _OURS.fullmatch(path.name)
            if ours and (".deleted-" in path.name or self._ledger.find(ours[1]) is None):
                log.warning("removing %s, which belongs to no job", path.name)
                store.remove(str(path)) if path.is_dir() else path.unlink(missing_ok=True)
