"""Stores in folders, below zarr: keys, parts of them, partial files, flags, markers and checkpoints."""

import os
from pathlib import Path

import numpy as np
import pytest

from worker import store
from worker.store import backend


@pytest.fixture
def url(tmp_path: Path) -> str:
    """A folder with ten bytes under the keys `a` and `folder/b`."""
    (tmp_path / "store" / "folder").mkdir(parents=True)
    for key in ("a", "folder/b"):
        (tmp_path / "store" / key).write_bytes(b"0123456789")
    return str(tmp_path / "store")


def below(folder: str | Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in Path(folder).rglob("*")}


def test_addresses_that_no_store_can_have_are_refused(url: str):
    backend.check_address(url)
    backend.check_address("s3://bucket/prefix")
    with pytest.raises(store.StoreError, match="only folders and s3://BUCKET/PREFIX can hold stores"):
        backend.check_address("file:///folder")
    for wrong in ("s3://", "s3:///prefix"):
        with pytest.raises(store.StoreError, match="must be s3://BUCKET/PREFIX"):
            backend.check_address(wrong)
    assert backend.in_bucket("s3://bucket/prefix") is True
    assert backend.in_bucket(url) is False


@pytest.mark.parametrize("key", ["c", "folder", "folder/c", "a/b", "none/c"])
def test_where_nothing_is_nothing_is_read(url: str, key: str):
    assert backend.read_key(url, key) is None
    assert backend.read_parts(url, key, [(0, 1)]) is None


def test_links_inside_a_store_are_not_followed_and_those_above_it_are(url: str, tmp_path: Path):
    (tmp_path / "store" / "link").symlink_to(tmp_path / "store" / "a")
    (tmp_path / "store" / "linked").symlink_to(tmp_path / "store" / "folder")
    for key in ("link", "linked/b"):
        assert backend.read_key(url, key) is None
        assert backend.read_parts(url, key, [(0, 1)]) is None
    (tmp_path / "other").symlink_to(url)
    for key in ("a", "folder/b"):
        assert backend.read_key(str(tmp_path / "other"), key) == b"0123456789"
        assert backend.read_parts(str(tmp_path / "other"), key, [(0, 2)]) == [b"01"]


@pytest.mark.timeout(20)
def test_pipes_and_endless_files_are_no_part_of_a_store(url: str, tmp_path: Path):
    os.mkfifo(tmp_path / "store" / "pipe")
    with (tmp_path / "store" / "endless").open("wb") as file:
        file.truncate(2**40)
    (tmp_path / "store" / "device").symlink_to("/dev/zero")
    for key in ("pipe", "endless", "device"):
        assert backend.read_key(url, key) is None
        assert backend.read_parts(url, key, [(0, 1)]) is None


def test_a_key_is_written_whole_or_not_at_all(url: str):
    backend.put(url, "folder/b", b"new")
    backend.put(url, "c", b"")
    assert (backend.read_key(url, "folder/b"), backend.read_key(url, "c")) == (b"new", b"")
    before = below(url)
    with pytest.raises(FileNotFoundError):
        backend.put(url, "none/c", b"new")
    assert below(url) == before
    backend.put(url, "folder", b"new")  # its files are no part of a store
    assert backend.read_key(url, "folder") == b"new"


def test_files_and_folders_make_room_for_what_is_written_and_removed(url: str):
    Path(url, backend.PARTIAL).write_bytes(b"")
    backend.place(url, backend.write_partial(url, b"new"), "folder")
    backend.place(url, backend.write_partial(url, b"new"), "a/c")
    assert (backend.read_key(url, "folder"), backend.read_key(url, "a/c")) == (b"new", b"new")
    for key in ("folder/b", "folder", "a"):
        backend.delete(url, key)
    assert backend.names_in(url) == [backend.PARTIAL]


def test_places_are_made_and_hold_names(url: str, tmp_path: Path):
    place = str(tmp_path / "deep" / "stores")
    backend.make_place(place)
    backend.make_place(place)
    assert backend.write_fault(place) is None
    assert backend.write_fault("s3://bucket/prefix") is None
    assert backend.names_in(url) == ["a", "folder"]
    assert backend.names_in(place) == backend.names_in(str(tmp_path / "none")) == []


def test_a_folder_is_removed_with_what_an_interrupted_removal_left(url: str, tmp_path: Path):
    Path(f"{url}{backend.DELETED}", "earlier").mkdir(parents=True)
    backend.remove(url)
    assert below(tmp_path) == set()
    backend.remove(url)  # it is gone


def test_what_a_link_leads_to_stays(url: str, tmp_path: Path):
    before, link = below(url), tmp_path / "other"
    for name in ("other", f"other{backend.DELETED}"):  # the second one of an interrupted removal
        (tmp_path / name).symlink_to(url)
    backend.remove(str(link))
    assert (below(url), backend.names_in(str(tmp_path))) == (before, ["store"])


@pytest.mark.parametrize("at", [0, 31, 32, -1])
def test_a_checkpoint_that_was_changed_is_none(url: str, at: int):
    store.write_checkpoint(url, 7, {"lines": np.arange(3)})
    file = Path(url, ".checkpoint-7")
    content = bytearray(file.read_bytes())
    content[at] ^= 1
    file.write_bytes(content)
    assert store.read_checkpoint(url, 7) is None


def test_a_checkpoint_of_objects_is_none(url: str):
    """Its arrays would be unpickled, and that can run any code."""
    store.write_checkpoint(url, 7, {"lines": np.array([{}], object)})
    assert store.read_checkpoint(url, 7) is None
