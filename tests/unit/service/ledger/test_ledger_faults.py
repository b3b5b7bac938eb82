"""A ledger that is damaged or locked, stores that are not there: nothing is lost, and each is told."""

import os
import sqlite3
import subprocess
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from scripted import Held, Scripted, sweep, wait_for
from served import FIGURE_2, finished, get, running, service
from stores import files, marked

from service.cli.doctor import examine
from service.errors import LedgerUnavailable, LedgerUnusable
from service.jobs.stores.opening import open_ledger
from service.ledger import paths as ledger_paths
from service.ledger.ledger import RESERVE, Ledger
from service.ledger.model import JobState
from service.ledger.paths import wal_of
from service.settings import Settings
from worker import store
from worker.executors.inline import Inline

PAGE = 4096


@pytest.fixture
def data(tmp_path: Path, inline: Inline) -> Path:
    """A data folder with one job that is done; its ledger has no log."""
    with running(tmp_path / "data", inline) as service:
        service.until(service.submit(sweep()), JobState.DONE)
    return tmp_path / "data"


def overwrite_page(path: Path, number: int) -> None:
    """As a disk does that writes to the wrong place."""
    with path.open("r+b") as file:
        file.seek(number * PAGE)
        file.write(os.urandom(PAGE))


# At the start


def edited(sql: str) -> Callable[[Path], None]:
    def harm(path: Path) -> None:
        with closing(sqlite3.connect(path, isolation_level=None)) as connection:
            connection.execute(sql)

    return harm


@pytest.mark.parametrize(
    ("harm", "reason"),
    [
        (edited("UPDATE jobs SET spec = '{'"), "cannot have the spec '{'"),
        (edited("UPDATE jobs SET state = 'zombie'"), "cannot have the state 'zombie'"),
        (edited("UPDATE jobs SET created = 'yesterday'"), "cannot have the created 'yesterday'"),
        (edited("UPDATE jobs SET store = '../../../etc'"), "cannot have the store"),
        (edited("UPDATE jobs SET name = CAST(x'ff' AS TEXT)"), "not decode to UTF-8"),
        (edited("DELETE FROM marker"), "has no mark of its stores"),
        (edited("INSERT INTO deletions (job, store) VALUES (9, '../a.zarr')"), "deletes '../a.zarr'"),
        (edited("INSERT INTO deletions (job, store) SELECT 9, store FROM jobs"), "the store of a deleted"),
        (edited("DELETE FROM chunks WHERE chunk = 0"), "contradicts itself"),
        (lambda path: overwrite_page(path, 1), "is damaged|cannot be used"),
        (lambda path: os.truncate(path, 0), r"is empty \(0 bytes\) beside"),
        (lambda path: os.truncate(path, 2 * PAGE), "is damaged|cannot be used"),
        (lambda path: path.write_bytes(b"no line of it " * 999), "cannot be used: file is not a database"),
    ],
)
def test_a_damaged_ledger_is_named_and_nothing_is_changed(
    data: Path, harm: Callable[[Path], None], reason: str
):
    settings = Settings(data=data)
    harm(settings.ledger_path)
    before, stored = settings.ledger_path.read_bytes(), files(data / "stores")
    for _ in range(2):  # the folder is unlocked, too
        with pytest.raises(LedgerUnusable, match=reason) as refused:
            open_ledger(settings)
        assert str(settings.ledger_path) in str(refused.value)
        assert "restore a backup with bounce restore" in str(refused.value)
    assert (settings.ledger_path.read_bytes(), files(data / "stores")) == (before, stored)


def test_a_ledger_that_cannot_be_opened_is_not_called_damaged(tmp_path: Path):
    (tmp_path / "ledger.sqlite").mkdir()  # root can read any file
    with pytest.raises(LedgerUnusable, match=r"cannot be used: unable to open database file$"):
        Ledger(tmp_path / "ledger.sqlite")


def test_an_empty_file_is_a_new_ledger_where_nothing_is_stored(tmp_path: Path):
    settings = Settings(data=tmp_path)
    settings.ledger_path.touch()
    with open_ledger(settings) as ledger:
        assert ledger.find("0" * 32) is None


# While the service runs


def refused(client: TestClient, reason: str) -> None:
    """Nothing is accepted, and the reason is told; what was done can still be read."""
    spec = sweep(omega=0.77).as_submitted()
    submission = client.post("/v1/jobs", json=spec)
    wait_for(lambda: client.get("/readyz").status_code == 503)  # it does not wait for a writer
    for answer in (submission, client.get("/readyz")):
        assert answer.status_code == 503
        assert reason in answer.json()["detail"]
        assert answer.headers["Retry-After"]


def works(client: TestClient) -> None:
    wait_for(lambda: client.get("/readyz").status_code == 200, lambda: client.get("/readyz").text)
    finished(client, sweep(omega=0.77).as_submitted())


def test_where_the_stores_are_not_mounted_nothing_is_written_and_nothing_computed_again(tmp_path: Path):
    data, mount = tmp_path / "data", tmp_path / "mount"
    stores = str(mount / "stores")
    with closing(Scripted()) as executor:
        with service(data, executor, stores=stores) as client:
            here = finished(client, FIGURE_2)
            query = {"omega": FIGURE_2["omega"], "xi": FIGURE_2["xi"]}
            right, tried = client.get(f"{here}/diagram", params=query).content, len(executor.tried)
            mount.rename(tmp_path / "device")
            mount.mkdir()
            assert client.get(f"{here}/diagram", params=query).status_code == 503
            refused(client, "the stores are not there: their marker .ledger is missing")
        with service(data, executor, stores=stores) as client:
            refused(client, "the stores are not there")
            time.sleep(0.5)  # several heartbeats
            assert get(client, here)["state"] == "done"
            assert list(mount.iterdir()) == []
            mount.rmdir()
            (tmp_path / "device").rename(mount)
            works(client)
            assert client.get(f"{here}/diagram", params=query).content == right
            chunks = get(client, "/v1/jobs")["jobs"][0]["progress"]["chunks_total"]
            assert sorted(executor.tried[tried:]) == list(range(chunks))


def test_two_data_folders_do_not_share_stores(tmp_path: Path, inline: Inline):
    """A job deleted in one would remove the results of the other."""
    stores = str(tmp_path / "stores")
    with service(tmp_path / "one", inline, stores=stores) as client:
        here = finished(client, FIGURE_2)
        with pytest.raises(
            LedgerUnusable, match=r"another data folder's: .* set BOUNCE_STORES to another folder"
        ):
            open_ledger(Settings(data=tmp_path / "two", stores=stores))
        works(client)
    with open_ledger(Settings(data=tmp_path / "one", stores=stores)) as ledger:
        assert ledger.find(here.rpartition("/")[2]) is not None


def test_doctor_and_adopt_know_the_marker_of_the_stores(data: Path):
    """Stores that were copied without it are marked again by an operator who adopts what is there."""
    settings, marker = Settings(data=data), data / "stores" / store.MARKER
    open_ledger(settings).close()
    ours = marker.read_text()
    marker.unlink()
    with open_ledger(settings) as ledger, pytest.raises(LedgerUnavailable, match="the stores are not there"):
        ledger.check()
    assert [finding.text for finding in examine(settings, "http://127.0.0.1:9") if "marker" in finding.text]
    with open_ledger(settings, adopting=True) as ledger:
        ledger.check()
    assert marker.read_text() == ours
    assert not [finding for finding in examine(settings, "http://127.0.0.1:9") if "marker" in finding.text]


def test_an_empty_marker_is_written_anew_beside_our_own_stores_only(data: Path):
    settings, marker = Settings(data=data), data / "stores" / store.MARKER
    ours = marked(data)[1]
    (data / "stores" / f"{'0' * 32}.zarr").mkdir()
    marker.write_bytes(b"")
    with open_ledger(settings) as ledger:
        ledger.check()
    assert marker.read_text() == ours
    marker.write_bytes(b"")
    for known in (data / "stores").glob("*-*.zarr"):
        known.rename(data / known.name)
    with open_ledger(settings) as ledger, pytest.raises(LedgerUnavailable, match="the stores are not there"):
        ledger.check()


def test_a_page_that_is_damaged_while_the_service_runs_is_told(data: Path, inline: Inline):
    """In whatever request meets it; none says that it is a defect of the service."""
    with service(data, inline) as client:
        ledger = client.app.state.service.ledger  # type: ignore[attr-defined]
        finished(client, FIGURE_2)
        with ledger._exclusive():
            ledger._writer.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            for page in range(1, (data / "ledger.sqlite").stat().st_size // PAGE):
                overwrite_page(data / "ledger.sqlite", page)
            for connection in (ledger._reader, ledger._writer):
                connection.execute("PRAGMA shrink_memory")
        answer = client.get("/v1/jobs")
        assert answer.status_code == 503
        assert "ledger.sqlite is damaged" in answer.json()["detail"]
        refused(client, "ledger.sqlite is damaged")


def test_a_lock_of_another_program_is_told_and_nothing_is_lost(data: Path):
    held = Held()
    with service(data, held) as client:
        ledger = client.app.state.service.ledger  # type: ignore[attr-defined]
        here = client.post("/v1/jobs", json=sweep(omega=0.6).as_submitted()).headers["Location"]
        wait_for(lambda: held.held() == 4)
        ledger._writer.execute("PRAGMA busy_timeout = 50")
        with closing(sqlite3.connect(data / "ledger.sqlite", isolation_level=None)) as other:
            other.execute("BEGIN IMMEDIATE")
            held.let_go()
            wait_for(lambda: client.get("/readyz").status_code == 503)
            refused(client, "database is locked")
            assert get(client, here)["progress"]["chunks_done"] == 0
            other.execute("ROLLBACK")
        wait_for(lambda: client.get("/readyz").status_code == 200)
        held.let_go_until(lambda: get(client, here)["state"] == "done")


# Space


def test_a_write_that_fails_is_told_until_one_succeeds(tmp_path: Path):
    with Ledger(tmp_path / "ledger.sqlite") as ledger:
        ledger._writer.execute("PRAGMA max_page_count = 1")  # it is larger: nothing more fits
        with pytest.raises(LedgerUnavailable, match="full"), ledger.writing() as writing:
            writing._sql.execute("CREATE TABLE more AS SELECT zeroblob(?)", [2 * RESERVE])
        assert "cannot be written: database or disk is full" in (ledger.fault() or "")
        ledger.check()
        assert ledger.fault() is None


def test_the_reserve_is_inside_the_ledgers_own_files(tmp_path: Path):
    path = tmp_path / "ledger.sqlite"
    with Ledger(path) as ledger:
        assert ledger._writer.execute("PRAGMA freelist_count").fetchone()[0] * PAGE >= RESERVE
        assert path.stat().st_blocks * 512 >= RESERVE
        assert wal_of(path).stat().st_blocks * 512 >= RESERVE
        with ledger.writing() as writing:
            writing._sql.execute("CREATE TABLE used AS SELECT zeroblob(?)", [RESERVE])
        assert ledger._writer.execute("PRAGMA freelist_count").fetchone()[0] * PAGE < RESERVE
        ledger.keep_reserve()
        assert ledger._writer.execute("PRAGMA freelist_count").fetchone()[0] * PAGE >= RESERVE
        size = path.stat().st_size
        ledger.keep_reserve()
        assert path.stat().st_size == size


def test_a_ledger_on_a_network_file_system_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The temporary folder's file system is taken for one."""
    (tmp_path / "link").symlink_to("/proc")
    assert ledger_paths.file_system(tmp_path / "link") == "proc"
    kind: Any = ledger_paths.file_system(tmp_path)
    assert kind in subprocess.run(["mount"], capture_output=True, text=True, check=True).stdout
    monkeypatch.setattr(ledger_paths, "NETWORK", frozenset({kind}))
    with running(tmp_path, Held(capacity=0)) as service:
        assert f"on a network file system ({kind})" in service.manager.notices()[0]
