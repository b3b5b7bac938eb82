"""Opens a ledger with its stores, and finds stores that it does not know.

A file beside the stores marks them as the ledger's. Without it, a file system that is not mounted would look
like an empty folder, and everything would be computed again. Another data folder with the same stores would
remove results that it does not own.
"""

import logging
import re
import time
from contextlib import ExitStack, suppress
from functools import partial
from typing import Final

from service.errors import LedgerUnavailable, LedgerUnusable
from service.ledger.ledger import Ledger
from service.settings import Settings
from worker import store

log = logging.getLogger(__name__)

#: A store's name: the job's number, which stores of 0.2.0 lack, and its id.
_NAME: Final = re.compile(r"(?:[0-9]{1,18}-)?[0-9a-f]{32}\.zarr")
#: Seconds for which a bucket's marker, once seen, is assumed to exist.
REMEMBERED_SECONDS: Final = 10.0
#: Unknown stores logged one by one.
MAX_NAMED: Final = 20
_UNREADABLE: Final[tuple[type[Exception], ...]] = (OSError, store.Unreachable)


class StoresMarker:
    """The marker of one ledger's stores."""

    def __init__(self, ledger: Ledger, settings: Settings) -> None:
        self._ledger, self._settings, self._url = ledger, settings, settings.stores_url
        self._remembered = REMEMBERED_SECONDS if store.in_bucket(self._url) else 0.0
        self._checked = float("-inf")

    def claim(self, adopting: bool) -> None:
        """Mark the stores if the ledger has not marked them before, or if it adopts them.

        Raises LedgerUnusable if they are another ledger's. If the marker cannot be written, `fault` reports
        it.
        """
        with self._ledger.reading() as reading:
            ours, made = reading.marker()
        settings = self._settings
        try:
            marker = own_marker(settings, ours, made)
            # a marker that a power cut left empty is ours if the ledger knows one of the stores beside it
            emptied = marker == "" and find_unknown(self._ledger, settings) != (_stored(settings) or None)
            if marker != ours and (adopting or not made or emptied):
                store.write_marker(self._url, ours)
            elif marker != ours:
                return
        except _UNREADABLE as error:
            log.warning("%s cannot be marked as this ledger's: %s", self._url, error)
            return
        if not made:
            with self._ledger.writing() as writing:
                writing.note_marked()

    def check(self) -> None:
        """Raise LedgerUnavailable unless the stores are this ledger's and both folders can be written."""
        self._check_marker()
        folders = {"the data folder": str(self._settings.data), "the folder of the stores": self._url}
        for folder, place in folders.items():
            if reason := store.write_fault(place):
                raise LedgerUnavailable(f"{folder} cannot be written: {reason}")

    def _check_marker(self) -> None:
        if time.monotonic() - self._checked < self._remembered:
            return
        with self._ledger.reading() as reading:
            ours, made = reading.marker()
        if not made:
            return
        try:
            marker = store.read_marker(self._url)
        except _UNREADABLE as error:
            if store.in_bucket(self._url):
                return  # the next use of the bucket raises its error
            reason = getattr(error, "strerror", None) or type(error).__name__
            raise LedgerUnavailable(f"the folder of the stores cannot be read: {reason}") from error
        if not marker:
            raise LedgerUnavailable(
                f"the stores are not there: their marker {store.MARKER} is missing, as where a file system "
                "is not mounted; mount it, or if these are the stores, stop the service and run "
                "bounce adopt --all"
            )
        if marker != ours:
            raise LedgerUnavailable(_foreign(marker))
        self._checked = time.monotonic()


def own_marker(settings: Settings, ours: str, made: bool, then: str = "") -> str | None:
    """The stores' marker; None if it is missing. Raises LedgerUnusable for another's, OSError, Unreachable.

    ours, made: of the ledger, `ReadTransaction.marker`. One that has marked none takes its data folder's.
    then: what to do before `bounce adopt`, if that data folder is gone.
    """
    marker = store.read_marker(settings.stores_url)
    if marker not in (None, "", ours) and (made or settings.stores is not None):
        raise LedgerUnusable(_foreign(str(marker), then))
    return marker


def _foreign(marker: str, then: str = "") -> str:
    return (
        f"the stores are another data folder's: {store.MARKER} beside them names the ledger "
        f"{marker[:32]!a}; set BOUNCE_STORES to another folder, or, if that data folder is gone for "
        f"good, remove {store.MARKER}{then} and run bounce adopt --all"
    )


def find_unknown(ledger: Ledger, settings: Settings) -> list[str]:
    """Names of the stores without a job in the ledger, the newest first, except those being removed.

    Raises OSError, or `store.Unreachable`.
    """
    with ledger.reading() as reading:
        names = reading.stores()
    return [name for name in _stored(settings) if name not in names]


def report_unknown(ledger: Ledger, settings: Settings) -> list[str]:
    """Name the unknown stores in the log, and return them: they may be all that remains of a job.

    Raises `store.Unreachable`.
    """
    try:
        unknown = find_unknown(ledger, settings)
    except OSError as error:
        log.warning("the stores cannot be listed: %s", error)
        return []
    for name in unknown[:MAX_NAMED]:
        log.warning("%s is unknown to the ledger and left alone: bounce adopt takes it in", name)
    if more := len(unknown[MAX_NAMED:]):
        log.warning("%d more stores are unknown to the ledger and left alone", more)
    return unknown


def _stored(settings: Settings) -> list[str]:
    """The names of stores, the newest first."""
    return sorted(filter(_NAME.fullmatch, store.names_in(settings.stores_url)), key=_number, reverse=True)


def _number(name: str) -> int:
    """The number of the job in its store's name; 0 in names of 0.2.0."""
    return int(name.rpartition("-")[0] or 0)


def id_of(name: str) -> str:
    """The id of the job in its store's name."""
    return name.rpartition("-")[2].removesuffix(".zarr")


def has_stores(settings: Settings) -> bool:
    """Whether there are stores at the settings' address; True if it does not answer."""
    try:
        return bool(_stored(settings))
    except Exception as error:  # noqa: BLE001 - any reason not to answer
        log.warning("the stores cannot be listed: %s", error)
        return True


def open_ledger(settings: Settings, adopting: bool = False) -> Ledger:
    """Open the ledger of the settings' data folder, and mark its stores as its own.

    Its next jobs get numbers above those of all stores: an older copy of a ledger does not know the newest.
    Raises as `Ledger`, and LedgerUnusable if the stores are another ledger's.
    """
    with ExitStack() as opened:
        ledger = opened.enter_context(Ledger(settings.ledger_path, partial(has_stores, settings)))
        marker = StoresMarker(ledger, settings)
        marker.claim(adopting)
        with suppress(*_UNREADABLE):
            newest = max(map(_number, _stored(settings)), default=0)
            with ledger.writing() as writing:
                writing.continue_after(newest)
        opened.pop_all()
    ledger.check_stores = marker.check
    return ledger
