"""Removes deleted jobs' results in the background, as recorded in the ledger, until it succeeds.

Nothing else removes a store. The transaction that forgets the job records its deletion, so an interrupted one
continues at the next start. No lock is held while files are removed: a bucket may take minutes.
"""

import logging
import threading
import time
from collections.abc import Callable
from typing import Final

from service.errors import LedgerUnavailable
from service.ledger.ledger import Ledger
from service.ledger.model import JobRecord
from service.ledger.transactions import Deletion, DeletionStep
from service.settings import Settings
from worker import store

log = logging.getLogger(__name__)

#: Chunks of a deleted job forgotten in one transaction; other writers wait a few milliseconds at most, and
#: write in between.
CHUNKS_FORGOTTEN: Final = 2_000
#: Seconds between two of these steps, for other writers.
YIELD_SECONDS: Final = 0.005

#: Seconds until a failed deletion is tried again: the first pause, doubled each time, and the longest.
RETRY_SECONDS: Final = 1.0
MAX_RETRY_SECONDS: Final = 60.0


class Deleter:
    """Carries out the ledger's deletions; calls `on_freed` when a job's address is free again.

    `start`, `wake` and `stop` may be called from any thread.
    """

    def __init__(self, ledger: Ledger, settings: Settings, on_freed: Callable[[], None]) -> None:
        self._ledger, self._settings, self._on_freed = ledger, settings, on_freed
        self._recorded, self._stopping = threading.Event(), threading.Event()
        self.kept: list[str] = []  # addresses of stores newer than their recorded deletion
        self._inherited: set[Deletion] = set()  # from earlier runs of the service
        self._thread = threading.Thread(target=self._work, name="deleter", daemon=True)

    def start(self) -> None:
        """Start the thread, with the deletions left by earlier runs of the service."""
        with self._ledger.writing() as ledger:
            ledger.forget_deletions(DeletionStep.COMPLETE)
            self._inherited = set(ledger.deletions())
        self._recorded.set()
        self._thread.start()

    def wake(self) -> None:
        """Look for deletions now. Call it after recording one."""
        self._recorded.set()

    def repeat(self, job: JobRecord) -> None:
        """Remove anything written at the job's address since its deletion, if it was deleted.

        Call it after writing outside a transaction: the job may have been deleted meanwhile. If its study was
        accepted again, the store at the address is the new job's.
        """
        with self._ledger.writing() as ledger:
            repeated = ledger.find(job.id) is None and ledger.repeat_deletion(job, time.time())
        if repeated:
            log.info("job %s was deleted while its store was written: removing it again", job.id)
            self.wake()

    def stop(self, seconds: float) -> None:
        """End the thread within `seconds`; the next start continues."""
        self._stopping.set()
        self.wake()
        if self._thread.is_alive():
            self._thread.join(seconds)

    def _work(self) -> None:
        pause: float | None = None  # until the next try of failed deletions
        while True:
            self._recorded.wait(pause)
            if self._stopping.is_set():
                return
            self._recorded.clear()
            complete = self._carry_out_all()
            pause = None if complete else min(2 * pause if pause else RETRY_SECONDS, MAX_RETRY_SECONDS)

    def _carry_out_all(self) -> bool:
        """Carry out all deletions; whether nothing remains."""
        try:
            with self._ledger.reading() as ledger:
                pending = ledger.deletions()
        except LedgerUnavailable as error:
            log.warning("deletions wait: %s", error)
            return False
        return sum(not self._carry_out(deletion) for deletion in pending) == 0

    def _carry_out(self, deletion: Deletion) -> bool:
        """Remove one deleted job's store; whether that is done."""
        if self._stopping.is_set():
            return False
        url, began = self._settings.store_of(deletion.job_id), time.monotonic()
        renamed = f"{url}.deleted-{deletion.seq}"
        try:
            self._ledger.check()
            created = store.created_at(url) if deletion in self._inherited else None
            if created is not None and created > deletion.created and deletion.step is DeletionStep.RECORDED:
                log.error(
                    "%s was created after its job was deleted: it stays, the ledger is an older copy", url
                )
                self.kept.append(url)
            else:
                if deletion.step is DeletionStep.RECORDED:
                    self._free(deletion, url, renamed)
                store.remove(renamed)
                log.info("%s is removed, in %.1f s", url, time.monotonic() - began)
            self._forget_chunks(deletion.seq)
            self._advance(deletion, DeletionStep.COMPLETE)
        except Exception as error:  # noqa: BLE001 - a bucket that does not answer, a folder that cannot be changed
            log.warning("%s cannot be removed now, it is tried again: %s", url, error)
            return False
        return True

    def _forget_chunks(self, seq: int) -> None:
        """Forget a deleted job's chunks. Raises LedgerUnavailable."""
        forgotten = CHUNKS_FORGOTTEN
        while forgotten == CHUNKS_FORGOTTEN and not self._stopping.wait(YIELD_SECONDS):
            with self._ledger.writing() as ledger:
                forgotten = ledger.forget_chunks(seq, CHUNKS_FORGOTTEN)
        if self._stopping.is_set():
            raise LedgerUnavailable("the service ends")

    def _free(self, deletion: Deletion, url: str, renamed: str) -> None:
        """Free a deleted job's address."""
        # A worker that lost its connection may still compute: the cancel flag stops it, and without its
        # metadata the store accepts no chunk.
        try:
            store.set_cancelled(url)
        except Exception as error:  # noqa: BLE001 - no inode left, a folder that cannot be written
            log.warning("the cancel flag of %s cannot be set: %s", url, error)
        store.rename_for_deletion(url, renamed)
        store.clear_cancelled(url)
        self._advance(deletion, DeletionStep.FREED)
        self._on_freed()

    def _advance(self, deletion: Deletion, step: DeletionStep) -> None:
        with self._ledger.writing() as ledger:
            ledger.advance_deletion(deletion, step)
