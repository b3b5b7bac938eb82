"""The ledger keeps whole transactions only, survives kills, and serves one process at a time."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from ledgers import accept, current, reports

from service.cli.doctor import examine, verify
from service.errors import LedgerUnavailable, LedgerUnusable
from service.ledger import backup
from service.ledger.ledger import Ledger
from service.ledger.model import JobRecord
from service.ledger.paths import lock_of
from service.settings import Settings


@pytest.fixture
def ledger(tmp_path: Path) -> Iterator[Ledger]:
    with Ledger(tmp_path / "ledger.sqlite") as ledger:
        yield ledger


def mark_and_interrupt(ledger: Ledger, job: JobRecord) -> None:
    with ledger.writing() as writing:
        writing.mark_done(job, reports(0))
        raise KeyboardInterrupt


def test_a_transaction_is_all_or_nothing(ledger: Ledger):
    job = accept(ledger)
    with pytest.raises(KeyboardInterrupt):
        mark_and_interrupt(ledger, job)
    assert current(ledger).chunks_done == 0
    with ledger.writing() as writing:  # and the next one works
        writing.mark_done(job, reports(1))
    assert current(ledger).chunks_done == 1


def test_what_is_committed_is_on_the_disk(ledger: Ledger):
    """As `PRAGMA synchronous` says: 2 is FULL, which syncs the write-ahead log at each commit."""
    assert ledger._writer.execute("PRAGMA synchronous").fetchone()[0] == 2


def test_what_is_read_at_once_is_of_one_moment(ledger: Ledger):
    job = accept(ledger)
    with ledger.reading() as before:
        assert before.done_chunks(job, 0, 9) == []
        with ledger.writing() as writing:
            writing.mark_done(job, reports(0, 1))
        assert before.find(job.id) == job
    assert current(ledger).chunks_done == 2


def test_without_its_lock_nothing_is_written(ledger: Ledger):
    """Another service may use the folder then."""
    accept(ledger)
    lock_of(ledger.path).unlink()
    with pytest.raises(LedgerUnavailable, match="the lock of the data folder was removed"):
        ledger.check()
    assert "lock" in (ledger.fault() or "")
    with pytest.raises(LedgerUnavailable), ledger.writing():
        pass
    assert current(ledger).chunks_done == 0  # it can be read


def test_a_closed_ledger_is_not_opened_again(tmp_path: Path):
    """Threads may outlive the service's end. SQLite removes the log at the close, which is no loss then."""
    with Ledger(tmp_path / "ledger.sqlite") as ledger:
        accept(ledger)
    with pytest.raises(LedgerUnavailable, match="closed"), ledger.reading():
        pass
    with pytest.raises(LedgerUnavailable, match="closed"), ledger.writing():
        pass
    with pytest.raises(LedgerUnavailable, match="closed"):
        ledger.check()
    assert "closed" in str(ledger.fault())
    ledger.keep_reserve()
    ledger.close()
    assert not (tmp_path / "ledger.sqlite-wal").exists()
    with Ledger(tmp_path / "ledger.sqlite") as again:
        assert current(again).name == "a name"


def test_a_newer_ledger_is_left_alone(tmp_path: Path):
    path = tmp_path / "ledger.sqlite"
    newer = sqlite3.connect(path)
    newer.execute("PRAGMA user_version = 99")
    newer.close()
    for _ in range(2):  # the folder is unlocked, too
        with pytest.raises(LedgerUnusable, match="version 99"):
            Ledger(path)
    with pytest.raises(LedgerUnusable, match="version 99"):
        list(verify(Settings(data=tmp_path), None))
    findings = [finding for finding in examine(Settings(data=tmp_path), None) if not finding.ok]
    assert [finding.subject for finding in findings] == ["ledger"]


def test_a_pause_is_no_progress_from_which_the_time_left_counts(ledger: Ledger):
    job = accept(ledger, chunks=3)
    for done in ([], [0], [], [1]):
        with ledger.writing() as writing:
            writing.mark_done(job, reports(*done), float(len(done)))
        now = current(ledger)
        assert (now.progressed is None) == (now.chunks_done == 0)
        assert now.seconds_left == (1.0 if now.chunks_done else None)


def test_chunks_of_deleted_jobs_are_forgotten_a_few_at_a_time(ledger: Ledger):
    kept, one, two = (accept(ledger, letter * 32, chunks=5) for letter in "abc")
    with ledger.writing() as writing:
        for job in (kept, one, two):
            writing.mark_done(job, reports(*range(5)))
        writing.delete(one)
        writing.delete(two)
        first, second = writing.deletions()
        assert (first.store, second.store) == (one.store, two.store)
        assert [writing.forget_deletion(first, 2) for _ in range(3)] == [False, False, True]
        assert writing.deletions() == [second]
        assert (writing.done_chunks(one, 0, 5), len(writing.done_chunks(two, 0, 5))) == ([], 5)
    assert ledger.done_mask(kept).all()


#: The tables of 0.2.0, made from today's.
BACK_TO_14 = """
    DROP TABLE answers;
    ALTER TABLE jobs DROP COLUMN progressed;
    ALTER TABLE jobs DROP COLUMN seconds_left;
    ALTER TABLE jobs ADD COLUMN run_started REAL;
    ALTER TABLE jobs ADD COLUMN cells_timed INTEGER NOT NULL DEFAULT 0;
    ALTER TABLE jobs ADD COLUMN run_cells INTEGER NOT NULL DEFAULT 0;
    ALTER TABLE jobs DROP COLUMN store;
    ALTER TABLE jobs ADD COLUMN verified REAL;
    ALTER TABLE chunks ADD COLUMN checksum BLOB NOT NULL DEFAULT x'00';
    ALTER TABLE chunks ADD COLUMN bytes INTEGER;
    CREATE TABLE verified (job INTEGER, page INTEGER, chunks BLOB, PRIMARY KEY (job, page)) WITHOUT ROWID;
    DROP TABLE deletions;
    CREATE TABLE deletions (job TEXT, seq INTEGER, created REAL, step INTEGER, PRIMARY KEY (job, seq))
        WITHOUT ROWID;
    INSERT INTO deletions VALUES ('gone', 7, 1.0, 0), ('renamed', 8, 1.0, 1), ('removed', 9, 1.0, 2),
        ('{again}', 6, 1.0, 0);
    PRAGMA user_version = 14;
"""


def test_a_ledger_of_the_release_before_keeps_its_jobs_and_their_stores(tmp_path: Path):
    path = tmp_path / "ledger.sqlite"
    with Ledger(path) as ledger:
        done, again = accept(ledger), accept(ledger, "b" * 32)
        with ledger.writing() as writing:
            writing.mark_done(done, reports(*range(4)))
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(BACK_TO_14.format(again=again.id))
    assert backup.inspect(path) == (2, 4)
    with backup.reading(path) as reading:
        assert f"{done.id}.zarr" in reading.stores()
    assert len(list(verify(Settings(data=tmp_path), None))) == 2
    assert backup.is_earlier(path)  # as that release needs it
    backup.backup(path, tmp_path / "backup.sqlite")
    with Ledger(path) as ledger:
        assert ledger.done_mask(current(ledger)).all()
        # One that waits until the store of a deleted job is removed gets another.
        stores = [current(ledger, job.id).store for job in (done, again)]
        assert stores == [f"{done.id}.zarr", f"2-{again.id}.zarr"]
        with ledger.reading() as reading:
            removed = {deletion.store for deletion in reading.deletions()}
        assert removed == {"gone.zarr", "renamed.zarr.deleted-8", f"{again.id}.zarr"}
        assert accept(ledger, "c" * 32).store == f"3-{'c' * 32}.zarr"
    backup.restore(path, tmp_path / "backup.sqlite")
    with Ledger(path) as ledger:
        assert current(ledger).chunks_done == 4
        with ledger.reading() as reading:
            assert reading.deletions() == []  # what they name may have been computed again since
