"""Removes the stores of deleted jobs. Nothing else removes a store.

The transaction that forgets a job adds its store to the ledger's list of deletions. The store leaves the list
once it is removed. An interrupted removal continues at the next start. No name of a store is used twice.
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

#: Chunks of a deleted job that one transaction forgets, so that other writers wait a few milliseconds at
#: most.
CHUNKS_FORGOTTEN: Final = 2_000
#: Seconds between two of these transactions, for other writers.
YIELD_SECONDS: Final = 0.005


def remove_deleted(
    ledger: Ledger, settings: Settings, deletions: Sequence[Deletion], stopping: Event
) -> bool:
    """Try to remove the stores of deleted jobs; whether all are removed. A bucket may take minutes."""
    removed = [_remove(ledger, settings.store_of(job.store), job, stopping) for job in deletions]
    return all(removed)


def _remove(ledger: Ledger, url: str, deletion: Deletion, stopping: Event) -> bool:
    """Remove one store; whether it is removed."""
    began = time.monotonic()
    try:
        ledger.check()
        with suppress(Exception):  # a worker that lost its connection may still compute
            store.set_cancelled(url)
        store.remove(url)
        store.clear_cancelled(url)
        forgotten = False
        while not forgotten:
            if stopping.wait(YIELD_SECONDS):
                return False
            with ledger.writing() as writing:
                forgotten = writing.forget_deletion(deletion, CHUNKS_FORGOTTEN)
    except Exception as error:  # noqa: BLE001 - such as a bucket that does not answer
        log.warning("%s cannot be removed now, it is tried again: %s", url, error)
        return False
    log.info("%s is removed, in %.1f s", url, time.monotonic() - began)
    return True


def remove_if_deleted(ledger: Ledger, job: JobRecord) -> None:
    """Have a store removed again if its job was deleted while it was written. Raises LedgerUnavailable."""
    with ledger.writing() as writing:
        deleted = writing.delete_again(job)
    if deleted:
        log.info("job %s was deleted while its store was written: it is removed again", job.id)
