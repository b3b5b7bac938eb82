"""The ledger: jobs and their done chunks in one SQLite file, the authority on what is done.

With WAL and synchronous=FULL, what a transaction has changed is on the disk when it returns.
One connection writes and one reads, each behind its lock, so that a poll never waits for a commit.
"""

import fcntl
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import IO, Final, Self

import numpy as np
from numpy.typing import NDArray

from service.errors import DataFolderBusy, LedgerUnavailable, LedgerUnusable
from service.jobs.migrations import MIGRATIONS
from service.jobs.model import JobRecord
from service.jobs.transactions import ReadTransaction, WriteTransaction

#: Rows of the chunks table read at once: other readers wait for no more than this.
PAGE: Final = 50_000
#: Bytes of a file that is removed when the disk is full, so that the ledger can record what happened.
RESERVE: Final = 1 << 18


class Ledger:
    """The ledger of one data folder; used by one process at a time, by any of its threads.

    Raises DataFolderBusy if another process has it open, LedgerUnusable if a newer version wrote it or if
    the file is no ledger; the data folder is unlocked then.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._write_lock, self._read_lock = threading.Lock(), threading.Lock()
        self._reserve = path.with_suffix(".reserve")
        with ExitStack() as opened:
            opened.enter_context(_locked(path.with_suffix(".lock")))
            self.keep_reserve()
            try:
                self._writer = opened.enter_context(_connected(path))
                self._reader = opened.enter_context(_connected(path))
                _migrate(self._writer)
            except sqlite3.DatabaseError as error:
                raise LedgerUnusable(f"the data folder's {path.name} cannot be used: {error}") from error
            self._opened = opened.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file and unlock the data folder."""
        with self._write_lock, self._read_lock:
            self._opened.close()

    @contextmanager
    def reading(self) -> Iterator[ReadTransaction]:
        """Read the ledger; never waits for a writer. Raises LedgerUnavailable."""
        with self._read_lock, _available():
            yield ReadTransaction(self._reader)

    @contextmanager
    def writing(self) -> Iterator[WriteTransaction]:
        """Change the ledger, all or nothing; the changes are on the disk when the block has ended.

        Raises LedgerUnavailable.
        """
        with self._write_lock, _available():
            self._writer.execute("BEGIN IMMEDIATE")
            try:
                yield WriteTransaction(self._writer)
                self._writer.execute("COMMIT")
            except BaseException as error:
                if self._writer.in_transaction:
                    self._writer.execute("ROLLBACK")
                if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
                    self._reserve.unlink(missing_ok=True)  # the next try has space to record the failure
                raise

    def keep_reserve(self) -> None:
        """Set disk space aside, if there is any, that the ledger can use when the disk is full."""
        if not self._reserve.exists():
            with suppress(OSError), self._reserve.open("wb") as file:
                file.write(bytes(RESERVE))

    def find(self, job_id: str) -> JobRecord | None:
        """The job, if there is one."""
        with self.reading() as ledger:
            return ledger.find(job_id)

    def done_mask(self, job: JobRecord) -> NDArray[np.bool_]:
        """(chunks_total,) which chunks are done; read in pages, between which others can read."""
        mask = np.zeros(job.chunks_total, np.bool_)
        for first in range(0, job.chunks_total, PAGE):
            with self.reading() as ledger:
                mask[ledger.done_chunks(job, first, first + PAGE)] = True
        return mask


@contextmanager
def _available() -> Iterator[None]:
    """Turn SQLite's errors about the file into LedgerUnavailable."""
    try:
        yield
    except sqlite3.OperationalError as error:
        raise LedgerUnavailable(f"the ledger does not answer: {error}") from error


@contextmanager
def _connected(path: Path) -> Iterator[sqlite3.Connection]:
    with closing(sqlite3.connect(path, isolation_level=None, check_same_thread=False)) as connection:
        connection.row_factory = sqlite3.Row
        for pragma in ("journal_mode=WAL", "synchronous=FULL", "busy_timeout=10000", "foreign_keys=ON"):
            connection.execute(f"PRAGMA {pragma}")
        yield connection


def _migrate(connection: sqlite3.Connection) -> None:
    """Bring the file to this version, each step whole or not at all."""
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if version > len(MIGRATIONS):
        raise LedgerUnusable(
            f"the ledger is of version {version}, this service knows up to {len(MIGRATIONS)}: use a newer one"
        )
    for number, script in enumerate(MIGRATIONS[version:], version + 1):
        connection.executescript(f"BEGIN IMMEDIATE; {script}; PRAGMA user_version = {number}; COMMIT;")


def _locked(path: Path) -> IO[str]:
    """A file that is locked while it is open; the system unlocks it when the process dies."""
    file = path.open("w")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        file.close()
        raise DataFolderBusy(f"another service uses the data folder {path.parent}") from error
    return file
