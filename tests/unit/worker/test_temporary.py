"""Temporary folders: for this user alone, and gone at the end."""

import subprocess
import sys
from pathlib import Path

import pytest

from worker.ownership import remove_temporary_folders, temporary_folder


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where temporary folders are made."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path


def test_the_next_one_removes_those_of_killed_processes_alone(place: Path):
    (others := place / "some-folder").mkdir()
    script = f"""
import os, tempfile
from worker.ownership import temporary_folder
tempfile.tempdir = {str(place)!r}
with temporary_folder("some-") as folder:
    os.kill(os.getpid(), 9)
"""
    with temporary_folder("some-") as living:
        subprocess.run([sys.executable, "-c", script], check=False)
        assert len(list(place.iterdir())) == 3
        with temporary_folder("some-") as folder:
            assert {*place.iterdir()} == {others, living, folder}
    assert list(place.iterdir()) == [others]


def test_a_process_that_ends_at_once_removes_those_in_use(place: Path):
    with temporary_folder("first-") as first, temporary_folder("second-") as second:
        (first / "file").touch()
        assert {*place.iterdir()} == {first, second}
        assert first.stat().st_mode & 0o777 == 0o700
        remove_temporary_folders()
        assert list(place.iterdir()) == []
    first.mkdir()  # by somebody else
    remove_temporary_folders()
    assert list(place.iterdir()) == [first]
