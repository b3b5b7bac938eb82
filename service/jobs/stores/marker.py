"""Checks by a marker file that the stores are present and belong to this ledger.

A file system that is not mounted looks like an empty folder: everything would be computed again beneath it.
Another data folder with the same stores would remove results that it does not own.
"""

import logging
import time
from typing import Final

from service.errors import LedgerUnavailable, LedgerUnusable
from service.jobs.ledger import Ledger
from service.settings import Settings
from worker import store

log = logging.getLogger(__name__)

#: Seconds for which a bucket's marker, once seen, is assumed to exist.
REMEMBERED_SECONDS: Final = 10.0


_UNREADABLE: Final[tuple[type[Exception], ...]] = (OSError, *store.UNREACHABLE)


class StoresMarker:
    """The marker of one ledger's stores."""

    def __init__(self, ledger: Ledger, settings: Settings) -> None:
        self._ledger, self._url = ledger, settings.stores_url
        self._within_data = settings.stores is None  # no other data folder has them
        self._remembered = REMEMBERED_SECONDS if store.in_bucket(self._url) else 0.0
        self._checked = float("-inf")

    def claim(self, adopting: bool = False) -> None:
        """Mark the stores of a ledger that has not marked any, or that adopts them.

        Raises LedgerUnusable if they are another ledger's. If it cannot write the marker, `fault` reports
        that.
        """
        with self._ledger.reading() as reading:
            ours, made = reading.marker()
        try:
            there = store.read_marker(self._url)
            if there not in (None, "", ours) and (made or not self._within_data):
                raise LedgerUnusable(self._foreign(str(there)))
            if there != ours and (adopting or not made):
                store.write_marker(self._url, ours)
            elif there != ours:
                return
        except _UNREADABLE as error:
            log.warning("%s cannot be marked as this ledger's: %s", self._url, error)
            return
        if not made:
            with self._ledger.writing() as writing:
                writing.note_marked()

    def check(self) -> None:
        """Raise LedgerUnavailable unless the stores exist and are this ledger's."""
        if time.monotonic() - self._checked < self._remembered:
            return
        with self._ledger.reading() as reading:
            ours, made = reading.marker()
        if not made:
            return
        try:
            there = store.read_marker(self._url)
        except _UNREADABLE as error:
            if store.in_bucket(self._url):
                return  # any use of the bucket raises its error
            reason = getattr(error, "strerror", None) or type(error).__name__
            raise LedgerUnavailable(f"the folder of the stores cannot be read: {reason}") from error
        if not there:
            raise LedgerUnavailable(
                f"the stores are not there: their marker {store.MARKER} is missing, as where a file system "
                "is not mounted; mount it, or if these are the stores, stop the service and run "
                "bounce adopt --all"
            )
        if there != ours:
            raise LedgerUnavailable(self._foreign(there))
        self._checked = time.monotonic()

    def _foreign(self, there: str) -> str:
        return (
            f"the stores are another data folder's: {store.MARKER} beside them names the ledger "
            f"{there[:32]!a}; set BOUNCE_STORES to another folder, or, if that data folder is gone for good, "
            f"remove {store.MARKER} and run bounce adopt --all"
        )
