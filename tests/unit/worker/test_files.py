"""Output files: complete or not at all; links, pipes and permissions."""

import os
import resource
import stat
import threading
from pathlib import Path

import pytest

from service.cli.options import write_file
from worker.files import complete_file, replacing


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_file_is_replaced_once_it_is_complete(tmp_path: Path):
    path = tmp_path / "out.nc"
    for content in (b"one", b"two"):
        before = path.read_bytes() if path.exists() else None
        with complete_file(path) as file:
            file.write(content)
            file.flush()
            assert (path.read_bytes() if path.exists() else None) == before
        assert path.read_bytes() == content
    assert files(tmp_path) == {"out.nc"}


def test_what_fails_leaves_the_old_file(tmp_path: Path):
    path = tmp_path / "out.nc"
    path.write_bytes(b"old")
    with pytest.raises(TypeError), complete_file(path) as file:
        file.writelines([b"half", None])  # type: ignore[list-item]
    assert path.read_bytes() == b"old"
    assert files(tmp_path) == {"out.nc"}


def test_a_file_that_cannot_be_written_to_its_end_replaces_nothing(tmp_path: Path):
    """What is small reaches the disk when the file is closed."""
    path = tmp_path / "out.nc"
    path.write_bytes(b"old")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4, before[1]))
    try:
        with pytest.raises(OSError, match=r"too large: '.*out.nc'"), complete_file(path) as file:
            file.write(b"longer than four bytes")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.read_bytes() == b"old"
    assert files(tmp_path) == {"out.nc"}


def test_an_error_names_the_file_that_is_asked_for(tmp_path: Path):
    (tmp_path / "out.nc").mkdir()
    with pytest.raises(IsADirectoryError) as caught, replacing(tmp_path / "out.nc"):
        pass
    assert (caught.value.filename, caught.value.filename2) == (str(tmp_path / "out.nc"), None)


@pytest.mark.parametrize("exists", [True, False])
def test_a_link_is_replaced_and_its_target_left_alone(tmp_path: Path, exists: bool):
    """Whoever plants a link where somebody writes a file does not choose what is overwritten."""
    target, link = tmp_path / "elsewhere" / "target", tmp_path / "out.png"
    target.parent.mkdir()
    if exists:
        target.write_bytes(b"precious")
        target.chmod(0o640)
    link.symlink_to(target)
    write_file(str(link), b"picture")
    assert (link.is_symlink(), link.read_bytes()) == (False, b"picture")
    assert target.exists() == exists
    if exists:
        assert target.read_bytes() == b"precious"
        assert stat.S_IMODE(link.stat().st_mode) != 0o640  # that of a new file


def test_a_file_keeps_its_permissions_and_a_new_one_follows_the_umask(tmp_path: Path):
    path = tmp_path / "out.csv"
    before = os.umask(0o027)
    try:
        write_file(str(path), b"1")
        assert stat.S_IMODE(path.stat().st_mode) == 0o640
        path.chmod(0o604)
        write_file(str(path), b"2")
        assert stat.S_IMODE(path.stat().st_mode) == 0o604
    finally:
        os.umask(before)


def test_a_pipe_behind_a_link_is_written_to(tmp_path: Path):
    pipe, link, read = tmp_path / "pipe", tmp_path / "link", []
    os.mkfifo(pipe)
    link.symlink_to(pipe)
    reader = threading.Thread(target=lambda: read.append(pipe.read_bytes()))
    reader.start()
    write_file(str(link), b"stream")
    reader.join()
    assert read == [b"stream"]
    assert link.is_symlink()


def test_standard_output_is_never_replaced(capfd: pytest.CaptureFixture[str]):
    write_file("/dev/stdout", b"table")
    assert Path("/dev/stdout").is_symlink()
    assert capfd.readouterr().out == "table"
