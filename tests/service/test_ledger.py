"""The ledger keeps whole transactions only, survives kills, and serves one process at a time."""

import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from paths import SUPPORT

from service.errors import DataFolderBusy, IllegalTransition, LedgerUnavailable, LedgerUnusable
from service.jobs.ledger import Ledger
from service.jobs.ledger_files import OpenFiles, lock_of
from service.jobs.migrations import MIGRATIONS
from service.jobs.model import UNFINISHED, JobRecord, JobState, NewJob
from worker.tasks import ChunkReport


@pytest.fixture
def ledger(tmp_path: Path) -> Iterator[Ledger]:
    with Ledger(tmp_path / "ledger.sqlite") as ledger:
        yield ledger


def new_job(job_id: str = "a" * 32, chunks: int = 4) -> NewJob:
    return NewJob(job_id, "a name", '{"gamma": 1.0}', "1", (1, 2, 3), chunks, 10 * chunks)


def accept(ledger: Ledger, job_id: str = "a" * 32, chunks: int = 4) -> JobRecord:
    with ledger.writing() as writing:
        writing.insert(new_job(job_id, chunks), now=100.0)
    return current(ledger, job_id)


def current(ledger: Ledger, job_id: str = "a" * 32) -> JobRecord:
    job = ledger.find(job_id)
    assert job is not None
    return job


def reports(*chunks: int) -> list[ChunkReport]:
    return [ChunkReport(chunk, 10, 0.5, 0.4, f"sum {chunk}", (0, 10, 0, 0, 0, 0)) for chunk in chunks]


def run(ledger: Ledger, job: JobRecord, now: float = 200.0) -> JobRecord:
    with ledger.writing() as writing:
        writing.run(job, now)
    return current(ledger, job.id)


def mark_and_finish(ledger: Ledger, job: JobRecord) -> None:
    with ledger.writing() as writing:
        writing.mark_done(job, reports(0))
        writing.finish(job, JobState.DONE, 300.0)


def mark_and_interrupt(ledger: Ledger, job: JobRecord) -> None:
    with ledger.writing() as writing:
        writing.mark_done(job, reports(0))
        raise KeyboardInterrupt


def test_a_job_comes_back_as_it_was_accepted(ledger: Ledger):
    job = accept(ledger)
    assert (job.id, job.name, job.spec) == ("a" * 32, "a name", '{"gamma": 1.0}')
    assert job.chunk_shape == (1, 2, 3)
    assert (job.state, job.created, job.started, job.finished) == (JobState.QUEUED, 100.0, None, None)
    assert (job.chunks_done, job.chunks_total, job.cells_done, job.cells_total) == (0, 4, 0, 40)


def test_cells_that_settle_are_counted_and_uncounted(ledger: Ledger):
    job = run(ledger, accept(ledger))
    settling = [
        ChunkReport(0, 10, 0.5, 0.4, "sum 0", (0, 7, 0, 0, 0, 0, 3)),
        ChunkReport(1, 10, 0.5, 0.4, "sum 1", (0, 8, 0, 0, 0, 0, 2)),
    ]
    with ledger.writing() as writing:
        writing.mark_done(job, [*settling, *reports(2)])
        writing.mark_done(job, settling)  # again, as after a lost connection
    assert current(ledger).cells_settling == current(ledger).progress(210.0).cells_settling == 5
    with ledger.writing() as writing:
        assert writing.unmark(current(ledger), [0, 2, 3]) == [0, 2]
    assert (current(ledger).cells_settling, current(ledger).cells_done) == (2, 10)


def test_an_unknown_job_is_none(ledger: Ledger):
    assert ledger.find("b" * 32) is None
    assert ledger.find("' OR 1=1 --") is None


def test_the_same_job_is_not_accepted_twice(ledger: Ledger):
    accept(ledger)
    with pytest.raises(sqlite3.IntegrityError):
        accept(ledger)


def test_a_job_runs_and_ends(ledger: Ledger):
    job = run(ledger, accept(ledger))
    assert (job.state, job.started, job.run_started) == (JobState.RUNNING, 200.0, 200.0)
    with ledger.writing() as writing:
        writing.finish(job, JobState.FAILED, 300.0, "because")
    job = current(ledger)
    assert (job.state, job.finished, job.error) == (JobState.FAILED, 300.0, "because")


def test_a_resumed_job_keeps_its_chunks_and_loses_its_error(ledger: Ledger):
    job = run(ledger, accept(ledger))
    with ledger.writing() as writing:
        writing.mark_done(job, reports(0, 1))
        writing.finish(job, JobState.FAILED, 300.0, "because")
    with ledger.writing() as writing:
        writing.queue(current(ledger), None)
    job = run(ledger, current(ledger), now=400.0)
    assert (job.error, job.finished, job.chunks_done) == (None, None, 2)
    assert (job.started, job.run_started, job.run_cells) == (200.0, 400.0, 20)
    assert job.progress(410.0).eta_seconds is None  # nothing done in this run yet


def test_an_illegal_step_changes_nothing(ledger: Ledger):
    job = accept(ledger)
    with pytest.raises(IllegalTransition):
        mark_and_finish(ledger, job)
    assert current(ledger) == job


def test_chunks_are_marked_once(ledger: Ledger):
    job = run(ledger, accept(ledger))
    for chunks in (reports(0, 2), reports(2, 3)):
        with ledger.writing() as writing:
            writing.mark_done(job, chunks)
    assert current(ledger).chunks_done == 3
    assert current(ledger).cells_done == 30
    assert ledger.done_mask(job).tolist() == [True, False, True, True]


def test_jobs_do_not_share_chunks(ledger: Ledger):
    one, two = accept(ledger, "a" * 32), accept(ledger, "b" * 32)
    with ledger.writing() as writing:
        writing.mark_done(one, reports(0, 1))
    assert not ledger.done_mask(two).any()


def test_newest_first_and_counted(ledger: Ledger):
    for letter in "abc":
        accept(ledger, letter * 32)
    run(ledger, current(ledger, "b" * 32))
    with ledger.reading() as reading:
        assert [job.id[0] for job in reading.newest(None, 10)] == ["c", "b", "a"]
        assert [job.id[0] for job in reading.newest(None, 2)] == ["c", "b"]
        assert [job.id[0] for job in reading.newest(JobState.QUEUED, 10)] == ["c", "a"]
        assert reading.count(UNFINISHED) == 3
        assert reading.count([JobState.DONE]) == 0


def test_unfinished_are_the_running_ones_and_then_the_queue(ledger: Ledger):
    for letter in "abcd":
        accept(ledger, letter * 32)
    run(ledger, current(ledger, "c" * 32))
    with ledger.writing() as writing:
        writing.finish(current(ledger, "a" * 32), JobState.CANCELLED, 1.0)
        writing.set_cancel_requested(current(ledger, "c" * 32), True)
    with ledger.reading() as reading:
        assert [(job.id[0], job.cancel_requested) for job in reading.unfinished(9)] == [
            ("c", True),
            ("b", False),
            ("d", False),
        ]
        assert len(reading.unfinished(2)) == 2


def test_a_transaction_is_all_or_nothing(ledger: Ledger):
    job = accept(ledger)
    with pytest.raises(KeyboardInterrupt):
        mark_and_interrupt(ledger, job)
    assert current(ledger).chunks_done == 0
    with ledger.writing() as writing:  # and the next one works
        writing.mark_done(job, reports(1))
    assert current(ledger).chunks_done == 1


def test_a_reader_does_not_wait_for_a_writer(ledger: Ledger):
    job = accept(ledger)
    with ledger.writing() as writing:
        writing.mark_done(job, reports(0))
        assert current(ledger).chunks_done == 0


def test_threads_do_not_lose_each_others_marks(ledger: Ledger):
    job = accept(ledger, chunks=200)

    def mark(first: int) -> None:
        for chunk in range(first, 200, 8):
            with ledger.writing() as writing:
                writing.mark_done(job, reports(chunk))

    threads = [threading.Thread(target=mark, args=(first,)) for first in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert current(ledger).chunks_done == 200
    assert ledger.done_mask(job).all()


def test_it_survives_closing(tmp_path: Path):
    path = tmp_path / "folder" / "ledger.sqlite"
    with Ledger(path) as ledger:
        accept(ledger)
    with Ledger(path) as ledger:
        assert current(ledger).name == "a name"
    with closing(sqlite3.connect(path)) as reader:
        assert reader.execute("PRAGMA user_version").fetchone() == (len(MIGRATIONS),)


def test_what_a_transaction_returned_survives_a_kill(tmp_path: Path):
    """A process that marks chunks one by one and prints each is killed in the middle."""
    program = (
        "import sys; from pathlib import Path; sys.path[:0] = sys.argv[2:]\n"
        "from service.jobs.ledger import Ledger; from test_ledger import accept, reports\n"
        "ledger = Ledger(Path(sys.argv[1])); job = accept(ledger, chunks=100000)\n"
        "for chunk in range(100000):\n"
        "    with ledger.writing() as writing: writing.mark_done(job, reports(chunk))\n"
        "    print(chunk, flush=True)\n"
    )
    path = tmp_path / "ledger.sqlite"
    command = [sys.executable, "-c", program, str(path), str(Path(__file__).parent), str(SUPPORT)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        printed = [int(process.stdout.readline()) for _ in range(50)]
        process.kill()
    with Ledger(path) as ledger:
        mask = ledger.done_mask(current(ledger))
        assert mask[printed].all()
        assert np.count_nonzero(mask) == current(ledger).chunks_done


def test_one_service_at_a_time(tmp_path: Path):
    path = tmp_path / "ledger.sqlite"
    with Ledger(path), pytest.raises(DataFolderBusy, match="another service uses the data folder"):
        Ledger(path)
    Ledger(path).close()


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


@pytest.mark.parametrize("exists", [False, True], ids=["new", "of an earlier release"])
def test_the_file_gets_smaller_when_jobs_are_deleted(tmp_path: Path, *, exists: bool):
    path = tmp_path / "ledger.sqlite"
    if exists:
        with closing(sqlite3.connect(path)) as earlier:
            earlier.executescript(f"{MIGRATIONS[0]}; PRAGMA user_version = 1")
            assert earlier.execute("PRAGMA auto_vacuum").fetchone() == (0,)
    with Ledger(path) as ledger, closing(sqlite3.connect(path)) as reader:
        assert reader.execute("PRAGMA auto_vacuum").fetchone() == (2,)  # incremental
        accept(ledger)


def test_what_others_write_into_the_same_file_is_told_from_another_file(tmp_path: Path):
    path = tmp_path / "ledger.sqlite"
    lock_of(path).touch()
    path.write_bytes(b"as it was opened")
    files = OpenFiles(path)
    assert not files.changed_from_outside()
    path.write_bytes(b"longer than it was opened")
    assert files.changed_from_outside()
    assert files.replaced() is None
    files.note_written()
    assert not files.changed_from_outside()
    (tmp_path / "other").write_bytes(b"another file")
    (tmp_path / "other").replace(path)
    assert not files.changed_from_outside()
    assert files.replaced() is not None


def test_a_newer_ledger_is_left_alone(tmp_path: Path):
    path = tmp_path / "ledger.sqlite"
    newer = sqlite3.connect(path)
    newer.execute("PRAGMA user_version = 99")
    newer.close()
    for _ in range(2):  # the folder is unlocked, too
        with pytest.raises(LedgerUnusable, match="version 99"):
            Ledger(path)


def test_what_is_no_ledger_is_left_alone(tmp_path: Path):
    path = tmp_path / "ledger.sqlite"
    path.write_bytes(b"not a database, and not one line of it " * 99)
    for _ in range(2):  # the folder is unlocked, too
        with pytest.raises(LedgerUnusable, match=r"ledger\.sqlite cannot be used: file is not a database"):
            Ledger(path)
    assert path.read_bytes().startswith(b"not a database")


def test_a_hundred_thousand_chunks_are_lean(ledger: Ledger, tmp_path: Path):
    job = accept(ledger, chunks=100_000)
    began = time.process_time()
    for first in range(0, 100_000, 1000):
        with ledger.writing() as writing:
            writing.mark_done(job, reports(*range(first, first + 1000)))
    assert ledger.done_mask(job).all()
    assert time.process_time() - began < 10
    assert (tmp_path / "ledger.sqlite").stat().st_size < 100_000 * 100
