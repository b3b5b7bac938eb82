"""Temporary folders: for this user alone, and gone at the end."""

import fcntl
import os
import time
from pathlib import Path

import pytest

from worker import temporary
from worker.executors import local_cluster


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where temporary folders are made."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path


def fill_and_fail() -> None:
    with temporary.temporary_folder("some-") as folder:
        assert folder.name.startswith("some-")
        assert folder.stat().st_mode & 0o777 == 0o700
        (folder / "inner").mkdir()
        (folder / "inner" / "file").touch()
        raise ZeroDivisionError(folder)


def test_a_temporary_folder_is_gone_at_the_end_of_its_block(place: Path):
    with pytest.raises(ZeroDivisionError) as caught:
        fill_and_fail()
    [folder] = caught.value.args
    assert folder.parent == place
    assert list(place.iterdir()) == []
    folder.mkdir()  # by somebody else
    temporary.remove_all()
    assert list(place.iterdir()) == [folder]


def test_a_process_that_ends_at_once_removes_those_in_use(place: Path):
    with temporary.temporary_folder("first-") as first, temporary.temporary_folder("second-") as second:
        (first / "file").touch()
        assert {*place.iterdir()} == {first, second}
        temporary.remove_all()
        assert list(place.iterdir()) == []


def test_what_killed_clusters_left_is_removed_and_what_others_use_is_not(place: Path):
    """A young folder is perhaps about to be locked."""
    ages = {"dead": 120, "used": 120, "young": 0}
    for name, age in ages.items():
        folder = place / f"bouncing-spring-dask-{name}"
        folder.mkdir()
        (folder / "held").touch()
        os.utime(folder, (time.time() - age,) * 2)
    (place / "somebody else's").mkdir()
    with (place / "bouncing-spring-dask-used" / "held").open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        scratch = local_cluster._Scratch()
    left = {path.name.removeprefix("bouncing-spring-dask-") for path in place.iterdir()}
    assert left == {
        "used",
        "young",
        "somebody else's",
        scratch.folder.name.removeprefix("bouncing-spring-dask-"),
    }
    with pytest.raises(BlockingIOError):
        local_cluster._locked(scratch.folder / "held")
    (scratch.folder / "file").touch()
    scratch.remove()
    assert not scratch.folder.exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to another user")
def test_folders_of_other_users_stay(place: Path):
    folder = place / "bouncing-spring-dask-theirs"
    folder.mkdir()
    (folder / "held").touch()
    os.utime(folder, (time.time() - 120,) * 2)
    os.chown(folder, 65534, 65534)
    local_cluster._remove_abandoned(place)
    assert folder.exists()
    os.chown(folder, 0, 0)
    local_cluster._remove_abandoned(place)
    assert not folder.exists()
