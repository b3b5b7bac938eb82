"""The scrub: what is verified again and when, in which order, and how much of the processor it takes."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from running import running
from scripted import DEADLINE, sweep, wait_for

from service.errors import LedgerUnavailable
from service.jobs import transactions
from service.jobs.prepare import JobPreparer
from service.jobs.stores import repair
from service.jobs.stores.repair import Repair, Scrubber
from service.ledger.ledger import Ledger
from service.ledger.model import JobRecord, JobState, NewJob
from service.settings import Settings
from worker.executors.inline import Inline
from worker.tasks import ChunkReport

#: In eight chunks.
SPEC = sweep(gamma={"start": 0.5, "stop": 1.2, "num": 24})


class Scrubbing:
    """A scrubber of a data folder, without a service, and what it has computed again."""

    def __init__(self, folder: Path, ledger: Ledger, computing: Callable[[], bool], **options: Any) -> None:
        settings = Settings(data=folder, **options)
        self.ledger, self.invalidated = ledger, list[int]()
        preparer = JobPreparer(settings)
        self.scrubber = Scrubber(ledger, settings, preparer, self._invalidating, lambda job: None, computing)

    @contextmanager
    def _invalidating(self, job_id: str) -> Iterator[list[int]]:
        chunks: list[int] = []
        yield chunks
        self.invalidated.extend(chunks)

    def run(self) -> Scrubber:
        """Scrub all there is."""
        self.scrubber.start()
        self.scrubber._thread.join(DEADLINE)
        assert not self.scrubber._thread.is_alive()
        return self.scrubber


@contextmanager
def scrubbing(folder: Path, computing: bool = False, **options: Any) -> Iterator[Scrubbing]:
    with Ledger(folder / "ledger.sqlite") as ledger:
        yield Scrubbing(folder, ledger, lambda: computing, **options)


@pytest.fixture
def done(tmp_path: Path, inline: Inline) -> JobRecord:
    """A job that is done, in a data folder in which nothing was verified."""
    with running(tmp_path, inline) as service:
        service.manager.scrubber._thread.join()
        return service.until(service.submit(SPEC), JobState.DONE)


def outcomes(folder: Path, job: JobRecord, chunk: int) -> Path:
    """The file of a chunk's outcomes."""
    return folder / "stores" / f"{job.id}.zarr" / "outcome" / f"c.0.0.0.{chunk}"


@pytest.mark.parametrize(("short", "gone", "changed"), [(5, 7, 3)])
def test_damage_is_found_wherever_it_is_and_the_rest_is_read_once(
    tmp_path: Path, done: JobRecord, monkeypatch: pytest.MonkeyPatch, short: int, gone: int, changed: int
):
    """Eight chunks, of which two are read at once."""
    monkeypatch.setattr(repair, "READ_AT_ONCE", 2)
    files = [outcomes(tmp_path, done, chunk) for chunk in range(done.chunks_total)]
    content = files[changed].read_bytes()
    files[changed].write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    files[short].write_bytes(files[short].read_bytes()[:-1])
    files[gone].unlink()
    with scrubbing(tmp_path) as scrubs:
        scrubber = scrubs.run()
        assert scrubs.invalidated == [short, gone, changed]
        assert (scrubber.verified_chunks, scrubber.damaged_chunks) == (6, 3)
        job = scrubs.ledger.find(done.id)
        assert job is not None
        assert (job.state, job.chunks_done) == (JobState.RUNNING, 5)
        assert done.id in scrubber.verified
        assert not any(files[chunk].exists() for chunk in (short, gone, changed))


def test_each_page_of_a_job_is_verified(tmp_path: Path, done: JobRecord, monkeypatch: pytest.MonkeyPatch):
    """Pages of eight chunks, of which the job has one; what one start has verified the next does not read."""
    for module in (repair, transactions):
        monkeypatch.setattr(module, "VERIFIED_PAGE", 8)
    assert done.chunks_total == 8
    with scrubbing(tmp_path, verify_days=1e-9) as scrubs:
        assert scrubs.run().verified_chunks == 8
        with scrubs.ledger.reading() as reading:
            assert reading.verified_chunks(done, 0).all()
            assert not reading.verified_chunks(done, 1).any()
        job = scrubs.ledger.find(done.id)
        assert job is not None
        assert job.verified is not None
        with scrubs.ledger.writing() as writing:
            writing.unmark(job, [2])  # which has its page verified again
            writing.mark_done(job, [])
    with scrubbing(tmp_path) as scrubs:
        assert scrubs.run().verified_chunks == 7


def test_a_scrub_that_fails_starts_again(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    (tmp_path / "stores").write_text("no folder")
    with scrubbing(tmp_path, heartbeat_seconds=0.01) as scrubs:
        scrubs.scrubber.start()
        assert scrubs.scrubber._thread.daemon
        wait_for(lambda: "scrub failed; starting again" in caplog.text)
        (tmp_path / "stores").unlink()
        (tmp_path / "stores" / f"{'a' * 32}.zarr").mkdir(parents=True)
        scrubs.scrubber._thread.join(DEADLINE)
        assert [Path(url).stem for url in scrubs.scrubber.unknown_stores] == ["a" * 32]


# Repair


def test_damaged_chunks_of_an_outdated_job_are_given_up_and_its_metadata_stay(
    tmp_path: Path, done: JobRecord
):
    with scrubbing(tmp_path) as scrubs:
        with scrubs.ledger.writing() as writing:
            writing._sql.execute("UPDATE jobs SET kernel_version = '0'")
        repair = scrubs.scrubber.report(done.id, [(0, 0, 0, 2)])
        assert repair.detail.startswith("stored results are damaged and missing from now on: chunk 2 (")
        assert not repair.lasting
        assert not outcomes(tmp_path, done, 2).exists()
        job = scrubs.ledger.find(done.id)
        assert job is not None
        assert (job.state, job.chunks_done) == (JobState.FAILED, 7)
        with scrubs.ledger.reading() as reading:
            [failure] = reading.failures(job)
        assert (failure.chunk, failure.traceback, failure.tries) == (2, None, 0)
        assert failure.error.endswith("resume the job to compute all of it anew")
        root = tmp_path / "stores" / f"{done.id}.zarr" / "zarr.json"
        root.write_text("{")
        repair = scrubs.scrubber.report(done.id, [])
        assert repair.detail.startswith("stored results are damaged: the store's metadata (")
        assert repair.lasting
        assert root.read_text() == "{"
        assert scrubs.invalidated == []


def test_nothing_of_a_deleted_job_is_invalidated_nor_of_one_accepted_again(tmp_path: Path, done: JobRecord):
    with scrubbing(tmp_path) as scrubs:
        with scrubs.ledger.writing() as writing:
            writing.delete(done, 1.0)
        scrubs.scrubber.invalidate(done, [0])
        again = NewJob(
            done.id, done.name, done.spec, done.kernel_version, done.chunk_shape, done.chunks_total,
            done.cells_total,
        )  # fmt: skip
        with scrubs.ledger.writing() as writing:
            writing.insert(again, 2.0)
            writing.mark_done(writing.find(done.id), [ChunkReport(0, 1, 0.5, 0.5, "00", (0, 1))])
        scrubs.scrubber.invalidate(done, [0])
        job = scrubs.ledger.find(done.id)
        assert job is not None
        assert (job.seq, job.chunks_done) == (done.seq + 1, 1)
        assert scrubs.invalidated == []
        assert outcomes(tmp_path, done, 0).exists()


def test_nothing_is_repaired_while_the_ledger_cannot_be_written(tmp_path: Path, done: JobRecord):
    root = tmp_path / "stores" / f"{done.id}.zarr" / "zarr.json"
    intact = root.read_bytes()
    root.write_text("{")
    with scrubbing(tmp_path) as scrubs:
        os.utime(scrubs.ledger.path, (1e9, 1e9))  # as another program leaves it
        with pytest.raises(LedgerUnavailable):
            scrubs.scrubber.report(done.id, [])
        assert root.read_text() == "{"
    with scrubbing(tmp_path) as scrubs:
        repair = scrubs.scrubber.report(done.id, [])
        assert repair == Repair("stored results are damaged and computed again: the store's metadata")
        assert root.read_bytes() == intact
