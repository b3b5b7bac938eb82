"""The ledger: jobs and their done chunks in one SQLite file, the authority on what is done.

One connection writes and one reads, each behind its lock, so that a reader never waits for a commit. The file
is checked when it is opened. Nothing is written to a damaged file.
"""

import fcntl
import logging
import os
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import IO, Final

import numpy as np
from numpy.typing import NDArray

from service.errors import DataFolderBusy, LedgerUnavailable, LedgerUnusable
from service.ledger.model import JobRecord
from service.ledger.paths import lock_of, network_file_system, replaced_copies, size_of, wal_of
from service.ledger.tables import RELEASED, TABLES, UPGRADE, VERSION, faults
from service.ledger.transactions import ReadTransaction, WriteTransaction
from worker.files import make_folder

log = logging.getLogger(__name__)

#: Rows of the chunks table read at once, which limits the wait of other readers.
PAGE: Final = 50_000
#: Free bytes inside the ledger's files, for records when the disk is full.
RESERVE: Final = 1 << 18
#: Seconds that a transaction waits for one of this process, and again for one of another process.
BUSY_SECONDS: Final = 10.0
#: Limit on the seconds of the check at the start; damage in the rest of a large file shows when it is read.
CHECK_SECONDS: Final = 10.0


class Ledger(AbstractContextManager["Ledger"]):
    """The ledger of one data folder; used by one process at a time, by any of its threads.

    has_stores: whether there are stores beside it; then an empty file is not a new ledger. Raises
    DataFolderBusy if another process has it open, and LedgerUnusable if a newer version wrote it, or if the
    file is damaged or not a ledger. On errors the data folder is unlocked.
    """

    def __init__(self, path: Path, has_stores: Callable[[], bool] = lambda: False) -> None:
        make_folder(path.parent)
        self.path = path
        self._write_lock, self._read_lock = threading.Lock(), threading.Lock()
        self._damage: str | None = None  # why nothing is written until the next start
        self._refused: str | None = None  # why the last transaction could not begin or write
        #: Raises LedgerUnavailable while nothing may be stored; `check` calls it.
        self.check_stores: Callable[[], None] = lambda: None
        self._stores_fault: str | None = None  # what is wrong with the stores, as of the last check
        self._closed = False
        with ExitStack() as opened:
            self._lock = opened.enter_context(locked(path))
            _check_not_emptied(path, has_stores)
            try:
                self._writer = opened.enter_context(_connected(path))
                self._reader = opened.enter_context(_connected(path))
                check(self._reader, path)
                make_tables(self._writer)
            except sqlite3.DatabaseError as error:
                mend = "" if getattr(error, "sqlite_errorcode", 0) & 0xFF in _REFUSED else f": {MEND}"
                raise LedgerUnusable(f"{path} cannot be used: {error}{mend}") from error
            self._opened = opened.pop_all()
        self.keep_reserve()
        if kind := network_file_system(path.parent):
            log.warning("%s is on a network file system (%s): %s", path.parent, kind, NOT_LOCAL)

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file and unlock the data folder."""
        with self._write_lock, self._read_lock:
            self._closed = True
            self._opened.close()

    @contextmanager
    def reading(self) -> Iterator[ReadTransaction]:
        """Read the ledger as it is at the first read; never waits for a writer. Raises LedgerUnavailable."""
        with self._read_lock, self._available():
            self._reader.execute("BEGIN")
            try:
                yield ReadTransaction(self._reader)
            finally:
                self._reader.rollback()  # unless an error has ended the transaction

    @contextmanager
    def writing(self) -> Iterator[WriteTransaction]:
        """Change the ledger, all or nothing; the changes are on the disk after the block.

        Raises LedgerUnavailable, also as `check` does.
        """
        with self._exclusive():
            try:
                self._writer.execute("BEGIN IMMEDIATE")
                self._refused = None
                yield WriteTransaction(self._writer)
                self._writer.execute("COMMIT")
            except sqlite3.OperationalError as error:  # such as another program's lock
                self._refused = f"the ledger cannot be written: {error}"
                raise

    def check(self) -> None:
        """Raise LedgerUnavailable while the file is damaged or unlocked, or the stores are missing.

        Called at every heartbeat, and before anything is stored.
        """
        try:
            self.check_stores()  # without a lock: a file system that hangs stops only this thread
            with suppress(ValueError):  # it is closed
                if not os.fstat(self._lock.fileno()).st_nlink:
                    rule = "make sure that no other service uses it, and start this one again"
                    raise LedgerUnavailable(f"the lock of the data folder was removed: {rule}")
            self._stores_fault = None
        except LedgerUnavailable as error:
            self._stores_fault = str(error)
        with self._exclusive() if self._refused is None else self.writing():
            if self._writer.in_transaction:
                self._writer.execute(f"PRAGMA user_version = {VERSION}")  # writes a page

    def fault(self) -> str | None:
        """Why the ledger could not be read or written last; None if it could. Waits for no writer.

        Names no path: anyone may ask for the service's readiness.
        """
        try:
            if self._damage is None:
                with self.reading() as ledger:
                    ledger.newest_seq()
        except LedgerUnavailable as error:
            return str(error)
        return self._stores_fault or self._damage or self._refused

    @contextmanager
    def _exclusive(self) -> Iterator[None]:
        """Hold the lock of writers. Raises LedgerUnavailable, also while the stores are missing."""
        if not self._write_lock.acquire(timeout=BUSY_SECONDS):
            raise LedgerUnavailable("the ledger does not answer: other transactions take too long")
        try:
            with self._available():
                if fault := self._damage or self._stores_fault:
                    raise LedgerUnavailable(fault)
                try:
                    yield
                except BaseException as error:
                    self._roll_back(error)
                    raise
        finally:
            self._write_lock.release()

    def _roll_back(self, error: BaseException) -> None:
        self._writer.rollback()
        if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
            # the log fills the disk: once its contents are in the main file, it begins anew
            with suppress(sqlite3.Error):
                self._writer.execute("PRAGMA wal_checkpoint(PASSIVE)")

    def keep_reserve(self) -> None:
        """Keep free pages in the main file and room in its log, if the disk has space.

        When the disk is full, no other program can take them, as it could the space of a removed file.
        """
        with suppress(LedgerUnavailable), self._exclusive():
            pragmas = ("PRAGMA freelist_count", "PRAGMA page_size")
            pages, size = (int(self._writer.execute(pragma).fetchone()[0]) for pragma in pragmas)
            if pages * size < RESERVE or size_of(wal_of(self.path)) < RESERVE:
                # in two transactions: pages made and freed in one are never written
                self._writer.executescript(
                    "BEGIN IMMEDIATE; DROP TABLE IF EXISTS reserve; CREATE TABLE reserve (content BLOB);"
                    f"INSERT INTO reserve VALUES (zeroblob({RESERVE + (1 << 16)})); COMMIT;"
                    "PRAGMA wal_checkpoint(PASSIVE); DROP TABLE reserve; PRAGMA wal_checkpoint(PASSIVE);"
                )

    def find(self, job_id: str) -> JobRecord | None:
        """The job, if there is one."""
        with self.reading() as ledger:
            return ledger.find(job_id)

    def done_mask(self, job: JobRecord) -> NDArray[np.bool_]:
        """(chunks_total,) which chunks are done; read in pages, so that others can read in between."""
        mask = np.zeros(job.chunks_total, np.bool_)
        for first in range(0, job.chunks_total, PAGE):
            with self.reading() as ledger:
                mask[ledger.done_chunks(job, first, first + PAGE)] = True
        return mask

    @contextmanager
    def _available(self) -> Iterator[None]:
        """Turn SQLite's errors about the file into LedgerUnavailable, and remember damage."""
        if self._closed:  # threads that outlive the service write nothing
            raise LedgerUnavailable("the ledger is closed: the service ends")
        try:
            yield
        except sqlite3.OperationalError as error:
            raise LedgerUnavailable(f"the ledger does not answer: {error}") from error
        except sqlite3.DatabaseError as error:
            if getattr(error, "sqlite_errorcode", 0) & 0xFF not in _DAMAGE:
                raise
            name = self.path.name
            self._damage = f"the data folder's {name} is damaged ({error}): stop the service; {MEND}"
            raise LedgerUnavailable(self._damage) from error


#: The remedy for an unusable ledger, for operators.
MEND: Final = "restore a backup with bounce restore, or move it away and run bounce adopt --all"

NOT_LOCAL: Final = (
    "it must not be used from two machines; keep the ledger on a local disk (BOUNCE_DATA), "
    "stores may be there (BOUNCE_STORES)"
)

#: SQLite's codes for a damaged file.
_DAMAGE: Final = frozenset({sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB})
#: Its codes for a file that is locked or another user's, and a full disk: the contents are as they were.
_REFUSED: Final = frozenset(
    {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_FULL, sqlite3.SQLITE_READONLY}
)


@contextmanager
def _connected(path: Path) -> Iterator[sqlite3.Connection]:
    with closing(sqlite3.connect(path, isolation_level=None, check_same_thread=False)) as connection:
        connection.row_factory = sqlite3.Row
        connection.create_function("casefold", 1, str.casefold, deterministic=True)  # SQLite's: ASCII only
        busy = f"busy_timeout={int(1000 * BUSY_SECONDS)}"
        for pragma in (busy, "journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
            connection.execute(f"PRAGMA {pragma}")
        yield connection


def check(connection: sqlite3.Connection, path: Path, seconds: float = CHECK_SECONDS) -> None:
    """Check a ledger, for `seconds` at most. Raises LedgerUnusable, or sqlite3.DatabaseError."""
    deadline = time.monotonic() + seconds
    connection.set_progress_handler(lambda: int(time.monotonic() > deadline), 100_000)
    try:
        version = connection.execute("PRAGMA user_version").fetchone()[0]
        if version not in (0, RELEASED, VERSION):
            rule = f"this service needs version {VERSION}: use the release that wrote it, or another folder"
            raise LedgerUnusable(f"the ledger is of version {version}, {rule}")
        for query in faults(version):
            if fault := next((row[0] for row in connection.execute(query) if row[0] is not None), None):
                raise LedgerUnusable(f"{path} {fault}: {MEND}")
    except sqlite3.OperationalError as error:
        if getattr(error, "sqlite_errorcode", None) != sqlite3.SQLITE_INTERRUPT:
            raise
        log.warning("%s is large: its check ended after %g s", path, seconds)
    finally:
        connection.set_progress_handler(None, 0)


def make_tables(connection: sqlite3.Connection) -> None:
    """Create the tables of a new ledger, or bring those of an earlier version to this one; all or nothing."""
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if version != VERSION:
        change = UPGRADE if version else TABLES
        connection.executescript(f"BEGIN IMMEDIATE; {change} PRAGMA user_version = {VERSION}; COMMIT;")


@contextmanager
def locked(path: Path) -> Iterator[IO[str]]:
    """Lock the folder of a ledger. The system unlocks it when the process dies. Raises DataFolderBusy."""
    with lock_of(path).open("a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise DataFolderBusy(f"another service uses the data folder {path.parent}") from error
        yield file


def _check_not_emptied(path: Path, has_stores: Callable[[], bool]) -> None:
    """Raise LedgerUnusable if a new ledger would replace a lost one."""
    if not path.exists() and (copies := replaced_copies(path)):
        raise LedgerUnusable(f"{path} is missing: restore {copies[-1]} with bounce restore, or move it away")
    if path.exists() and not size_of(path) and (size_of(wal_of(path)) or has_stores()):
        raise LedgerUnusable(f"{path} is empty (0 bytes) beside what it should know: {MEND}")
