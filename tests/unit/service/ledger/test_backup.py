"""Backups and their commands: whole copies beside a running service; restoring loses nothing."""

import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from answering import Answer, scripted
from click.testing import CliRunner, Result
from scripted import Held, Scripted, free_port, sweep, wait_for
from served import running
from stores import files, store_in

from kernel.params import KERNEL_VERSION
from service.cli.main import main
from service.errors import DataFolderBusy, LedgerUnusable
from service.jobs.stores.opening import open_ledger
from service.ledger import backup
from service.ledger.model import JobState
from service.ledger.paths import wal_of
from service.settings import Settings
from worker.executors.inline import Inline

SPECS = [sweep(omega=omega) for omega in (0.5, 0.6, 0.7)]


def bounce(*arguments: str) -> Result:
    return CliRunner().invoke(main, arguments)


def ids(path: Path) -> set[str]:
    with closing(sqlite3.connect(path)) as connection:
        return {row[0] for row in connection.execute("SELECT id FROM jobs")}


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder with one job that is done, a backup of it, and two jobs that are done since."""
    folder = tmp_path_factory.mktemp("original")
    with closing(Inline()) as inline, running(folder / "data", inline) as service:
        service.until(service.submit(SPECS[0]), JobState.DONE)
        backup.backup(service.settings.ledger_path, folder / "backup.sqlite")
        for spec in SPECS[1:]:
            service.until(service.submit(spec), JobState.DONE)
    return folder


@pytest.fixture
def folder(original: Path, tmp_path: Path) -> Path:
    """A copy of it for one test."""
    shutil.copytree(original, tmp_path, dirs_exist_ok=True)
    return tmp_path


def test_a_backup_is_whole_while_the_service_writes(tmp_path: Path):
    """It has every mark that was there when it began."""
    held, file = Held(), tmp_path / "copies" / "ledger.sqlite"
    file.parent.mkdir()
    with running(tmp_path / "data", held) as service:
        job = service.submit(SPECS[0])
        wait_for(held.held)
        held.let_go()
        wait_for(lambda: service.job(job).chunks_done == 1)
        answer = bounce("backup", str(file), "--data", str(tmp_path / "data"))
        assert (answer.exit_code, answer.output) == (0, f"{file}: 1 job, 1 done chunk\n")
        held.let_go_until(lambda: service.job(job).state is JobState.DONE)
        marked = service.job(job).chunks_done
        backup.backup(service.settings.ledger_path, file)  # in place of the one before
    assert backup.inspect(file) == (1, marked)
    assert list(file.parent.iterdir()) == [file]
    assert file.stat().st_mode & 0o777 == 0o600


def test_a_backup_that_cannot_be_written_leaves_the_one_before(folder: Path):
    before = (folder / "backup.sqlite").read_bytes()
    answer = bounce("backup", str(folder / "no" / "such"), "--data", str(folder / "data"))
    assert answer.exit_code == 1
    assert "there is no such folder" in answer.output
    assert "Errno" not in answer.output
    for content, reason in ((b"no ledger at all" * 999, "file is not a database"), (b"", "no such table")):
        (folder / "data" / "ledger.sqlite").write_bytes(content)
        answer = bounce("backup", str(folder / "backup.sqlite"), "--data", str(folder / "data"))
        assert answer.exit_code == 1
        assert reason in answer.output
        assert (folder / "backup.sqlite").read_bytes() == before
    os.mkfifo(folder / "pipe")
    ledger = folder / "data" / "ledger.sqlite"
    for file in (ledger, wal_of(ledger), folder / "pipe"):
        answer = bounce("backup", str(file), "--data", str(folder / "data"))
        assert (answer.exit_code, "name another file" in answer.output) == (1, True)
    assert (folder / "pipe").is_fifo()


def test_what_contradicts_itself_is_neither_backed_up_nor_restored(folder: Path):
    ledger, earlier, copy = folder / "data/ledger.sqlite", folder / "backup.sqlite", folder / "copy.sqlite"
    with closing(sqlite3.connect(ledger, isolation_level=None)) as connection:
        connection.execute("DELETE FROM chunks WHERE chunk = 0")
    shutil.copyfile(ledger, copy)
    before = {path: path.read_bytes() for path in (ledger, earlier, copy)}
    with pytest.raises(LedgerUnusable, match="contradicts itself"):
        backup.backup(ledger, earlier)
    with pytest.raises(LedgerUnusable, match="contradicts itself"):
        backup.restore(ledger, copy)
    assert {path: path.read_bytes() for path in before} == before
    assert sorted(path.name for path in folder.iterdir()) == ["backup.sqlite", "copy.sqlite", "data"]


def test_a_restored_ledger_loses_no_store_and_the_one_before_is_kept(folder: Path):
    data = folder / "data"
    stores = {path: path.stat().st_mtime_ns for path in (data / "stores").rglob("*")}
    known = ids(data / "ledger.sqlite")
    answer = bounce("restore", str(folder / "backup.sqlite"), "--data", str(data))
    assert answer.exit_code == 0, answer.output
    assert "1 job, " in answer.output
    assert "2 stores unknown to it: bounce adopt --all" in answer.output
    [replaced] = data.glob("ledger-replaced-*.sqlite")
    assert f"the ledger that was there is {replaced}\n" in answer.output
    assert ids(replaced) == known
    assert len(ids(data / "ledger.sqlite")) == 1
    assert (data / "ledger.sqlite").stat().st_mode & 0o777 == 0o600
    with running(data, Held(capacity=0)) as service:
        assert len(service.unknown_stores()) == 2
        assert "stores that the ledger does not know: 2" in service.manager.notices()[0]
    answer = bounce("adopt", "--all", "--data", str(data))
    assert (answer.exit_code, answer.stderr) == (0, "")
    adopted = [line.split("  ") for line in answer.stdout.splitlines()]
    assert {job_id for job_id, *_ in adopted} == known - {SPECS[0].job_id(KERNEL_VERSION)}
    assert [state for _, state, *_ in adopted] == ["done", "done"]
    assert ids(data / "ledger.sqlite") == known
    with closing(Scripted()) as executor, running(data, executor) as service:
        assert [service.manager.submit(spec).accepted for spec in SPECS] == [False] * 3
        assert service.manager.notices() == []
        assert executor.tried == []
    assert stores.items() <= {path: path.stat().st_mtime_ns for path in (data / "stores").rglob("*")}.items()


def test_a_log_that_is_not_of_the_backup_is_set_aside(folder: Path):
    ledger = folder / "data" / "ledger.sqlite"
    wal_of(ledger).write_bytes(b"of the ledger before")
    _, replaced = backup.restore(ledger, folder / "backup.sqlite")
    assert replaced is not None
    assert wal_of(replaced).read_bytes() == b"of the ledger before"
    assert not wal_of(ledger).exists()
    assert len(ids(ledger)) == 1


def test_nothing_is_restored_under_a_running_service(folder: Path):
    data = folder / "data"
    with running(data, Held(capacity=0)) as service:
        with pytest.raises(DataFolderBusy):
            backup.restore(service.settings.ledger_path, folder / "backup.sqlite")
        assert "another service uses the data folder" in bounce("adopt", "--all", "--data", str(data)).output
        with service.ledger.reading() as ledger:
            assert len(ledger.stores()) == 3


def test_a_backup_of_another_data_folder_is_refused_before_anything_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    for name in ("one", "other"):
        open_ledger(Settings(data=tmp_path / name)).close()
    backup.backup(tmp_path / "one" / "ledger.sqlite", tmp_path / "of one")
    before, data = files(tmp_path / "other"), ["--data", str(tmp_path / "other")]
    answer = bounce("restore", str(tmp_path / "of one"), *data)
    assert (answer.exit_code, "the stores are another data folder's" in answer.output) == (1, True)
    assert "remove .ledger, restore again and run bounce adopt --all" in answer.output
    assert files(tmp_path / "other") == before
    with monkeypatch.context() as patch:
        patch.setenv("BOUNCE_STORES", str(tmp_path / ("x" * 300)))  # they cannot be read
        answer = bounce("restore", str(tmp_path / "of one"), *data)
    assert (answer.exit_code, "/.ledger: File name too long" in answer.output) == (1, True)
    assert files(tmp_path / "other") == before
    (tmp_path / "other" / "stores" / ".ledger").unlink()
    assert bounce("restore", str(tmp_path / "of one"), *data).exit_code == 0
    assert bounce("adopt", "--all", *data).exit_code == 0


def test_what_is_no_ledger_is_not_restored(folder: Path):
    data, file = folder / "data", folder / "other.sqlite"
    before = sorted(path.name for path in data.iterdir())
    for reason in ("there is no file", "file is not a database"):
        with pytest.raises(LedgerUnusable, match=reason):
            backup.restore(data / "ledger.sqlite", file)
        assert sorted(path.name for path in data.iterdir()) == before
        assert len(ids(data / "ledger.sqlite")) == 3
        file.write_bytes(b"not a database " * 999)


def test_the_doctor_verifies_all_results_and_has_damage_computed_again(folder: Path):
    data, jobs = folder / "data", [spec.job_id(KERNEL_VERSION) for spec in SPECS]

    def verify(*job: str) -> list[str]:
        answer = bounce("doctor", "--verify", *job, "--data", str(data))
        assert answer.exit_code == ("!!" in answer.output)
        return answer.output.splitlines()

    assert verify() == [f"ok  job               {job}: 8 chunks are sound" for job in reversed(jobs)]
    stores = [store_in(data, job) for job in jobs]
    before = files(data / "stores")
    content = bytearray((stores[0] / "flight_time" / "c.0.0.0.3.0").read_bytes())
    content[len(content) // 2] ^= 1
    (stores[0] / "flight_time" / "c.0.0.0.3.0").write_bytes(content)
    (stores[0] / "outcome" / "c.0.0.0.5").unlink()
    (stores[1] / "omega" / "c" / "0").unlink()
    (stores[1] / ".partial" / "left.partial").touch()
    with running(data, Held(capacity=0)):
        lines = verify()
        assert [line[:2] for line in lines] == ["ok", "!!", "!!"]
        assert "damaged: chunk 3 (rest, " in lines[2]
        assert "omega/c/0: is not what the store's specification says" in lines[1]
    assert "a service uses the folder" in lines[2]
    mended = "metadata that differed are rewritten: omega/c/0"
    assert verify(jobs[1]) == [f"ok  job               {jobs[1]}: 8 chunks are sound; {mended}"]
    [line] = verify(jobs[0])
    assert "stored results are damaged and computed again: chunk 3 (rest, " in line
    with closing(Scripted()) as executor, running(data, executor) as service:
        wait_for(lambda: files(data / "stores") == before)
        service.until(service.submit(SPECS[0]), JobState.DONE)
        assert sorted(executor.tried) == [3, 5]
    assert bounce("doctor", "--verify", "0" * 32, "--data", str(data)).exit_code == 1
    assert bounce("doctor", jobs[0], "--data", str(data)).exit_code == 2
    (data / "ledger.sqlite").unlink()
    assert "unknown to the ledger" in bounce("doctor", "--verify", "--data", str(data)).output


def test_the_doctor_names_what_needs_attention(folder: Path):
    data, url = folder / "data", f"http://127.0.0.1:{free_port()}"
    answer = bounce("doctor", "--data", str(data), "--url", url)
    assert answer.exit_code == 0, answer.output
    assert "3 jobs" in answer.output
    assert f"no service answers at {url} ([" in answer.output
    assert "!!" not in answer.output
    assert "copies beside it" not in answer.output
    with scripted(Answer(302, b"<html>", Location="/login")) as (_, client):
        answer = bounce("doctor", "--data", str(data), "--url", client.url)
    assert (answer.exit_code, f" sends on to {client.url}/login" in answer.output) == (1, True)
    assert f"service           none on {data}" in bounce("doctor", "--data", str(data)).output
    lost = next((data / "stores").glob("*.zarr"))
    lost.rename(folder / lost.name)
    answer = bounce("doctor", "--data", str(data), "--url", url)
    assert (answer.exit_code, answer.output.count(f"missing, such as {lost.name}")) == (1, 1)
    (folder / lost.name).rename(lost)
    backup.restore(data / "ledger.sqlite", folder / "backup.sqlite")
    files = {path: path.read_bytes() for path in data.glob("ledger*")}
    answer = bounce("doctor", "--data", str(data), "--url", url)
    assert answer.exit_code == 1
    assert answer.output.count("is unknown to the ledger: bounce adopt") == 2
    assert "ok  ledger            copies beside it: ledger-replaced-" in answer.output
    for content, reason in ((b"", "ledger.sqlite is empty"), (b"none" * 999, "file is not a database")):
        (data / "ledger.sqlite").write_bytes(content)
        lines = bounce("doctor", "--data", str(data), "--url", url).output.splitlines()
        (line,) = [line for line in lines if line.startswith("!!  ledger ")]
        assert reason in line
    (data / "ledger.sqlite").write_bytes(files[data / "ledger.sqlite"])
    assert {path: path.read_bytes() for path in data.glob("ledger*")} == files


def test_the_doctor_names_a_kernel_cache_that_others_can_write_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    cache = tmp_path / "cache"
    cache.mkdir()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache))
    command = ("doctor", "--data", str(tmp_path / "data"), "--url", f"http://127.0.0.1:{free_port()}")
    assert f"{cache}, 0 compiled kernels" in " ".join(bounce(*command).output.split())
    (cache / "digest").mkdir()
    for suffix in ("", ".198d9536", ".lock"):  # before optimisation, for a processor, the lock
        (cache / "digest" / f"drive-of-rigid-45feb91e4af1{suffix}").touch()
    assert f"{cache}, 1 compiled kernels" in " ".join(bounce(*command).output.split())
    cache.chmod(0o777)
    answer = bounce(*command)
    assert answer.exit_code == 1
    assert "remove it" in answer.output


def test_adopt_makes_no_ledger_where_there_is_nothing_to_adopt(tmp_path: Path):
    """In a folder that is none of a service's."""
    result = bounce("adopt", "--all", "--data", str(tmp_path))
    assert result.exit_code == 2
    assert "neither a ledger nor stores" in " ".join(result.output.split())
    assert list(tmp_path.iterdir()) == []
