"""Removes the stores of deleted jobs, as recorded in the ledger. Nothing else removes a store.

The transaction that forgets a job adds its store to the ledger's list of deletions; it leaves the list once
it is removed. An interrupted removal continues at the next start. A store's name is never used twice.
"""

import logging
import time
from collections.abc import Sequence
from contextlib import suppress
from threading import Event
from typing import Final

from service.ledger.ledger import Ledger
from service.ledger.model import JobRecord
from service.ledger.transactions import Deletion
from service.settings import Settings
from worker import store

log = logging.getLogger(__name__)

#: Chunks of a deleted job forgotten in one transaction; other writers wait a few milliseconds at most, and
#: write in between.
CHUNKS_FORGOTTEN: Final = 2_000
#: Seconds between two of these steps, for other writers.
YIELD_SECONDS: Final = 0.005


def remove_deleted(
    ledger: Ledger, settings: Settings, deletions: Sequence[Deletion], stopping: Event
) -> bool:
    """Remove deleted jobs' stores, without a lock: a bucket may take minutes. Whether nothing remains."""
    failed = [not _remove(ledger, settings.store_of(each.store), each, stopping) for each in deletions]
    return not any(failed)


def _remove(ledger: Ledger, url: str, deletion: Deletion, stopping: Event) -> bool:
    """Remove one store; whether that is done."""
    began = time.monotonic()
    try:
        ledger.check()
        with suppress(Exception):  # no inode left, a folder that cannot be written: it only saves time
            store.set_cancelled(url)  # a worker that lost its connection may still compute
        store.remove(url)
        store.clear_cancelled(url)
        forgotten = False
        while not forgotten:
            if stopping.wait(YIELD_SECONDS):
                return False
            with ledger.writing() as writing:
                forgotten = writing.forget_deletion(deletion, CHUNKS_FORGOTTEN)
    except Exception as error:  # noqa: BLE001 - a bucket that does not answer, a folder that cannot be changed
        log.warning("%s cannot be removed now, it is tried again: %s", url, error)
        return False
    log.info("%s is removed, in %.1f s", url, time.monotonic() - began)
    return True


def remove_if_deleted(ledger: Ledger, job: JobRecord) -> None:
    """Have a job's store removed that was written while the job was deleted. Raises LedgerUnavailable."""
    with ledger.writing() as writing:
        deleted = writing.delete_again(job)
    if deleted:
        log.info("job %s was deleted while its store was written: it is removed again", job.id)
