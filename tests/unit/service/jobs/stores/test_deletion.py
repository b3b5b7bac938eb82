"""Deleted jobs: what the ledger records is removed, sooner or later, and nothing else."""

import os
import threading
from pathlib import Path

import pytest
from scripted import DEADLINE, Held, hanging, sweep, wait_for
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


@pytest.mark.parametrize("name", ["set_cancelled", "remove"])
def test_a_store_that_hangs_holds_nobody_up(
    done: Path, inline: Inline, monkeypatch: pytest.MonkeyPatch, name: str
):
    """Not even the same study, whose new store is another."""
    with running(done, inline) as service, hanging(monkeypatch, store, name) as (reached, go_on):
        service.manager.delete(JOB)
        assert reached.wait(DEADLINE)
        again = service.until(service.submit(sweep()), JobState.DONE)
        go_on.set()
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
    with Ledger(done / "ledger.sqlite") as ledger, ledger.writing() as writing:
        writing.delete(writing.find(JOB))
    (done / "stores" / f"1-{JOB}.zarr").rename(done / "stores" / f"1-{JOB}.zarr{store.DELETED}")
    with running(done, inline) as service:
        wait_for(lambda: service.pending_deletions() == 0)
        assert names(done) == [unknown]


def test_metadata_repaired_while_the_job_is_deleted_do_not_stay(done: Path, monkeypatch: pytest.MonkeyPatch):
    """The job is deleted when its metadata have just been looked at."""
    (done / "stores" / f"1-{JOB}.zarr" / "zarr.json").unlink()
    with (
        running(done, Held(capacity=0)) as service,
        hanging(monkeypatch, store, "repair_metadata") as (reached, go_on),
    ):
        reader = threading.Thread(target=service.manager.supervisor.repair, args=(JOB, []))
        reader.start()
        assert reached.wait(DEADLINE)
        service.manager.delete(JOB)
        [deletion] = service.deletions()
        assert remove_deleted(service.ledger, service.settings, [deletion], threading.Event())
        assert names(done) == []
        go_on.set()
        reader.join(DEADLINE)
        wait_for(lambda: service.pending_deletions() == 0)
        assert names(done) == []
