"""Backups of the ledger: copied while the service runs, checked, and restored in place of a lost one."""

import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Final, NamedTuple
from urllib.parse import quote

from service.errors import LedgerUnavailable, LedgerUnusable
from service.ledger.ledger import check, locked, make_tables
from service.ledger.paths import lock_of, replaced_path, shm_of, wal_of
from service.ledger.tables import RELEASED, VERSION
from service.ledger.transactions import ReadTransaction
from worker.files import make_folder, replacing, sync

SQLITE_VERSION: Final = sqlite3.sqlite_version


class Contents(NamedTuple):
    """The numbers of jobs and chunks in a ledger."""

    jobs: int
    chunks: int  # marked done


def backup(ledger: Path, file: Path) -> Contents:
    """Copy a ledger, as it is at one moment, to `file`, whole or not at all. A service may be using it.

    Raises LedgerUnavailable if a file cannot be read or written, LedgerUnusable if the ledger is damaged.
    """
    if not ledger.is_file():
        raise LedgerUnavailable(f"there is no ledger {ledger}")
    own = {path.resolve() for path in (ledger, *(of(ledger) for of in (wal_of, shm_of, lock_of)))}
    if file.resolve() in own or (file.exists() and not file.is_file()):
        rule = "is the ledger's own" if file.resolve() in own else "is no regular file"
        raise LedgerUnavailable(f"{file} {rule}: name another file for the copy")
    try:
        with (
            _opened(ledger) as source,
            replacing(file, private=True) as copied,
            closing(sqlite3.connect(copied.name)) as target,
        ):
            source.backup(target)
            contents = _contents(target, Path(copied.name))  # before it replaces an earlier copy
    except (sqlite3.OperationalError, OSError) as error:
        reason = getattr(error, "strerror", None) or error
        raise LedgerUnavailable(f"{ledger} cannot be copied to {file}: {reason}") from error
    except sqlite3.DatabaseError as error:
        raise LedgerUnusable(f"{ledger} cannot be copied: {error}") from error
    return contents


def restore(
    ledger: Path, file: Path, check_marker: Callable[[str, bool], object] = lambda *_: None
) -> tuple[Contents, Path | None]:
    """Put a backup in place of a ledger; its contents, and the path where the previous ledger is kept.

    check_marker: raises for the marker of other stores. Raises DataFolderBusy while a service uses the
    folder, LedgerUnusable if `file` is not a whole ledger.
    """
    if not file.is_file():
        raise LedgerUnusable(f"there is no file {file}")
    contents = inspect(file)
    with reading(file) as kept:
        check_marker(*kept.marker())
    make_folder(ledger.parent)
    with locked(ledger):
        try:
            with replacing(ledger, private=True) as restored:
                with file.open("rb") as kept:
                    shutil.copyfileobj(kept, restored)
                restored.flush()
                with closing(sqlite3.connect(restored.name)) as connection, connection:
                    if _version(connection) != VERSION:
                        # stores were named by the id: deleted ones may have been computed again
                        connection.executescript("DELETE FROM deletions")
                    make_tables(connection)
                    connection.execute("PRAGMA journal_mode=DELETE")  # one file, moved by one renaming
                sync(Path(restored.name))  # before the previous one is moved
                replaced = _set_aside(ledger)
        except sqlite3.Error as error:
            raise LedgerUnusable(f"{file} cannot be restored: {error}") from error
    return contents, replaced


def inspect(file: Path) -> Contents:
    """Check a ledger and count its contents. A service may be using it. Raises LedgerUnusable."""
    with _readable(file), _opened(file) as connection:
        return _contents(connection, file)


def _contents(connection: sqlite3.Connection, file: Path) -> Contents:
    check(connection, file)
    jobs, chunks = connection.execute("SELECT count(*), total(chunks_done) FROM jobs").fetchone()
    return Contents(int(jobs), int(chunks))


def is_earlier(file: Path) -> bool:
    """Whether a ledger has the tables of an earlier release. Raises LedgerUnusable."""
    with _readable(file), _opened(file) as connection:
        return _version(connection) == RELEASED


def _version(connection: sqlite3.Connection) -> int:
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


@contextmanager
def reading(file: Path) -> Iterator[ReadTransaction]:
    """Read a ledger that a service may be using. Raises LedgerUnusable."""
    with _readable(file), _opened(file) as connection, closing(sqlite3.connect(":memory:")) as copy:
        current = connection
        if _version(connection) != VERSION:
            connection.backup(copy)
            make_tables(copy)
            current = copy
        current.row_factory = sqlite3.Row
        yield ReadTransaction(current)


@contextmanager
def _readable(file: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.DatabaseError as error:
        raise LedgerUnusable(f"{file} cannot be read: {error}") from error


@contextmanager
def _opened(file: Path) -> Iterator[sqlite3.Connection]:
    """A connection that changes nothing and applies no log, which may be another copy's."""
    mode = "mode=ro" if wal_of(file).exists() else "mode=ro&immutable=1"
    with closing(sqlite3.connect(f"file:{quote(str(file.absolute()))}?{mode}", uri=True)) as connection:
        yield connection


def _set_aside(ledger: Path) -> Path | None:
    """Rename a ledger and its log; None if there is none."""
    replaced = replaced_path(ledger) if ledger.exists() else None
    for beside in (wal_of, shm_of):
        if replaced is None:
            beside(ledger).unlink(missing_ok=True)
        elif beside(ledger).exists():
            beside(ledger).rename(beside(replaced))
    return replaced and ledger.rename(replaced)
