"""Deleted jobs: what the ledger records is removed, sooner or later, and nothing else."""

import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from scripted import DEADLINE, Held, sweep, wait_for
from served import running

from kernel.params import KERNEL_VERSION
from service.jobs import supervisor
from service.jobs.stores.deletion import remove_deleted
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


def record_deletion(folder: Path) -> None:
    """As an earlier run of the service left it that died before it removed anything."""
    with Ledger(folder / "ledger.sqlite") as ledger, ledger.writing() as writing:
        job = writing.find(JOB)
        assert job is not None
        writing.delete(job)


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


@pytest.mark.parametrize("name", ["set_cancelled", "remove"])
def test_a_store_that_hangs_holds_nobody_up(
    done: Path, inline: Inline, hanging: Callable[[str], Hanging], name: str
):
    """Not even the same study, whose new store is another."""
    hang = hanging(name)
    with running(done, inline) as service:
        service.manager.delete(JOB)
        assert hang.reached.wait(DEADLINE)
        again = service.until(service.submit(sweep()), JobState.DONE)
        hang.go_on.set()
        wait_for(lambda: service.pending_deletions() == 0)
        assert service.outcomes(again).all()
    assert names(done) == [f"2-{JOB}.zarr"]


def test_what_cannot_be_removed_is_tried_again(done: Path, inline: Inline, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(supervisor, "RETRY_SECONDS", 0.01)
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
    """Also one that was interrupted after the renaming; nothing else is removed."""
    unknown = f"3-{'0' * 32}.zarr"
    (done / "stores" / unknown).mkdir()
    record_deletion(done)
    (done / "stores" / f"1-{JOB}.zarr").rename(done / "stores" / f"1-{JOB}.zarr{store.DELETED}")
    with running(done, inline) as service:
        wait_for(lambda: service.pending_deletions() == 0)
        assert names(done) == [unknown]


def test_metadata_repaired_while_the_job_is_deleted_do_not_stay(
    done: Path, hanging: Callable[[str], Hanging]
):
    """The job is deleted when its metadata have just been looked at."""
    (done / "stores" / f"1-{JOB}.zarr" / "zarr.json").unlink()
    with running(done, Held(capacity=0)) as service:
        hang = hanging("repair_metadata")
        reader = threading.Thread(target=service.manager.supervisor.repair, args=(JOB, []))
        reader.start()
        assert hang.reached.wait(DEADLINE)
        service.manager.delete(JOB)
        [deletion] = service.deletions()
        assert remove_deleted(service.ledger, service.settings, [deletion], threading.Event())
        assert names(done) == []
        hang.go_on.set()
        reader.join(DEADLINE)
        wait_for(lambda: service.pending_deletions() == 0)
        assert names(done) == []
