"""Deleted jobs: what the ledger records is removed, sooner or later, and nothing else."""

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from running import running
from scripted import DEADLINE, Held, Scripted, sweep, wait_for

from kernel.params import KERNEL_VERSION
from service.jobs.stores import deletion
from service.ledger.ledger import Ledger
from service.ledger.model import JobState
from worker import store
from worker.executors.inline import Inline

JOB = sweep().job_id(KERNEL_VERSION)


@pytest.fixture
def done(tmp_path: Path, inline: Inline) -> Path:
    """A data folder with one job that is done."""
    with running(tmp_path, inline) as service:
        service.until(service.submit(sweep()), JobState.DONE)
    return tmp_path


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in (folder / "stores").iterdir())


def record_deletion(folder: Path, age: float) -> None:
    """As an earlier run of the service left it that died `age` seconds ago, before it removed anything."""
    with Ledger(folder / "ledger.sqlite") as ledger, ledger.writing() as writing:
        job = writing.find(JOB)
        assert job is not None
        writing.delete(job, time.time() - age)


class Hanging:
    """Lets one of the store's functions wait until the test lets it go on."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
        self.reached, self.go_on = threading.Event(), threading.Event()
        real = getattr(store, name)

        def wait(*given: Any) -> Any:
            self.reached.set()
            assert self.go_on.wait(DEADLINE)
            return real(*given)

        monkeypatch.setattr(store, name, wait)


@pytest.fixture
def hanging(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], Hanging]]:
    made: list[Hanging] = []

    def hang(name: str) -> Hanging:
        made.append(Hanging(monkeypatch, name))
        return made[-1]

    yield hang
    for one in made:
        one.go_on.set()


@pytest.mark.parametrize("name", ["set_cancelled", "rename_for_deletion", "remove"])
def test_a_store_that_hangs_holds_nobody_up(
    done: Path, inline: Inline, hanging: Callable[[str], Hanging], name: str
):
    hang = hanging(name)
    with running(done, inline) as service:
        service.manager.scrubber._thread.join()  # it would repair what is being removed
        service.manager.delete(JOB)
        assert hang.reached.wait(DEADLINE)
        service.until(service.submit(sweep(omega=0.6)), JobState.DONE)
        again = service.submit(sweep())
        assert again.state is JobState.QUEUED
        if name == "remove":  # the address is free
            service.until(again, JobState.DONE)
        hang.go_on.set()
        service.until(again, JobState.DONE)
        wait_for(lambda: service.pending_deletions() == 0)
        assert service.outcomes(again).all()


def test_a_job_waits_while_its_address_has_results_of_a_deleted_one(
    done: Path, hanging: Callable[[str], Hanging]
):
    hang, held = hanging("rename_for_deletion"), Held()
    with running(done, held, heartbeat_seconds=0.02) as service:
        service.manager.scrubber._thread.join()  # it would repair what is being removed
        service.manager.delete(JOB)
        assert hang.reached.wait(DEADLINE)
        again, other = service.submit(sweep()), service.submit(sweep(omega=0.6))
        service.until(other, JobState.RUNNING)
        assert service.job(again).state is JobState.QUEUED
        hang.go_on.set()
        service.until(again, JobState.RUNNING)


def test_what_cannot_be_removed_is_tried_again(done: Path, inline: Inline, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(deletion, "RETRY_SECONDS", 0.01)
    tries, real = iter(range(3)), store.remove

    def remove(url: str) -> None:
        if next(tries, None) is not None:
            raise PermissionError(13, os.strerror(13))
        real(url)

    monkeypatch.setattr(store, "remove", remove)
    with running(done, inline) as service:
        service.manager.delete(JOB)
        wait_for(lambda: service.pending_deletions() == 0)
    assert names(done) == []


def test_a_deletion_goes_on_at_the_next_start(done: Path, inline: Inline):
    (done / "stores" / f"{'0' * 32}.zarr").mkdir()
    record_deletion(done, age=0.0)
    with running(done, inline) as service:
        wait_for(lambda: service.pending_deletions() == 0)
        assert names(done) == [f"{'0' * 32}.zarr"]


def test_one_that_was_interrupted_after_the_renaming_goes_on(done: Path, inline: Inline):
    record_deletion(done, age=0.0)
    url = str(done / "stores" / f"{JOB}.zarr")
    store.rename_for_deletion(url, f"{url}.deleted-1")
    with running(done, inline) as service:
        again = service.submit(sweep())
        wait_for(lambda: service.pending_deletions() == 0)
        service.until(again, JobState.DONE)
    assert names(done) == [f"{JOB}.zarr"]


def test_a_store_made_after_its_deletion_stays(done: Path, inline: Inline):
    """As with an older copy of the ledger, which has the deletion of a job that was accepted again since."""
    record_deletion(done, age=3600.0)
    with running(done, inline) as service:
        wait_for(lambda: service.pending_deletions() == 0)
        service.manager.scrubber._thread.join()
        assert [Path(url).name for url in service.manager.unknown_stores] == [f"{JOB}.zarr"]
        assert service.manager._deleter.kept == [service.settings.store_of(JOB)]
    assert names(done) == [f"{JOB}.zarr"]


def test_a_running_job_is_not_touched_by_the_deletion_of_its_predecessor(
    done: Path, hanging: Callable[[str], Hanging]
):
    hang = hanging("remove")
    with closing(Scripted()) as executor, running(done, executor) as service:
        service.manager.scrubber._thread.join()  # it would repair what is being removed
        service.manager.delete(JOB)
        assert hang.reached.wait(DEADLINE)
        again = service.until(service.submit(sweep()), JobState.DONE)
        before = service.outcomes(again)
        hang.go_on.set()
        wait_for(lambda: service.pending_deletions() == 0)
        assert (service.outcomes(again) == before).all()
        assert len(executor.tried) == again.chunks_total


def test_metadata_repaired_while_the_job_is_deleted_does_not_stay(
    done: Path, hanging: Callable[[str], Hanging]
):
    """The job is verified at the start, and deleted when its metadata have just been looked at."""
    hang = hanging("repair_metadata")
    with running(done, Held(capacity=0)) as service:
        assert hang.reached.wait(DEADLINE)
        service.manager.delete(JOB)
        wait_for(lambda: service.pending_deletions() == 0)
        assert names(done) == []
        hang.go_on.set()
        service.manager.scrubber._thread.join()
        wait_for(lambda: service.pending_deletions() == 0)
        assert names(done) == []
