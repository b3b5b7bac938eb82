"""Warming a kernel cache in this process: who compiles, and who copies what others have compiled."""

import os
import time
from pathlib import Path

import pytest

from worker import kernel_cache, tasks
from worker.kernel_cache import claim_cache, default_root, warm


class Slot:
    """A cache that this process holds; compiling adds a file to it."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.compiled = folder, 0
        folder.mkdir(parents=True)

    def compile(self) -> None:
        self.compiled += 1
        self.found = self.files(self.folder)
        (self.folder / f"{self.compiled}.nbc").touch()

    @property
    def ready(self) -> Path:
        return self.folder.parent / "ready"

    @staticmethod
    def files(folder: Path) -> list[str]:
        return sorted(path.name for path in folder.glob("*.nbc"))


@pytest.fixture
def slot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Slot:
    held = Slot(tmp_path / "digest" / "slot-0")
    monkeypatch.setattr(kernel_cache, "_held", [held.folder])
    monkeypatch.setattr(tasks, "compile_kernels", held.compile)
    return held


def test_the_first_process_compiles_for_the_others(slot: Slot):
    assert claim_cache() == slot.folder
    warm()
    assert (slot.compiled, slot.found) == (1, [])
    assert slot.files(slot.ready) == ["1.nbc"]
    assert (slot.folder.parent / "compiling").exists()  # others wait for it


def test_the_first_process_forgets_caches_that_were_not_used_for_long(slot: Slot, tmp_path: Path):
    """But for its own."""
    long_ago = time.time() - 15 * 24 * 3600
    for name, last_used in (("digest", long_ago), ("old", long_ago), ("recent", time.time())):
        lock = tmp_path / name / "slot-0" / "held"
        lock.parent.mkdir(parents=True, exist_ok=True)
        lock.touch()
        os.utime(lock, (last_used, last_used))
    warm()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["digest", "recent"]
    assert slot.files(slot.ready) == ["1.nbc"]


def test_others_copy_what_it_has_compiled_and_wait_for_nobody(slot: Slot):
    slot.ready.mkdir()
    (slot.ready / "ready.nbc").touch()
    warm()
    assert (slot.compiled, slot.found) == (1, ["ready.nbc"])
    assert slot.files(slot.ready) == ["ready.nbc"]
    assert not (slot.folder.parent / "compiling").exists()


def test_what_is_compiled_already_stays(slot: Slot):
    slot.compile()
    slot.ready.mkdir()
    (slot.ready / "ready.nbc").touch()
    warm()
    assert slot.found == ["1.nbc"]


def test_one_that_waited_copies_what_was_compiled_meanwhile(slot: Slot, monkeypatch: pytest.MonkeyPatch):
    def compiled_meanwhile(*_: object) -> None:
        slot.ready.mkdir()
        (slot.ready / "ready.nbc").touch()

    monkeypatch.setattr(kernel_cache.fcntl, "flock", compiled_meanwhile)
    warm()
    assert slot.found == ["ready.nbc"]
    assert slot.files(slot.ready) == ["ready.nbc"]


def test_kernels_that_keep_no_cache_are_compiled_all_the_same(slot: Slot, monkeypatch: pytest.MonkeyPatch):
    """They were declared before a cache was claimed."""
    monkeypatch.setattr(kernel_cache, "_held", [])
    assert claim_cache() is None
    warm()
    assert slot.compiled == 1
    assert not slot.ready.exists()


def test_the_root_is_the_one_of_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    slot = tmp_path / "digest" / "slot-3"
    slot.mkdir(parents=True)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(slot))
    assert default_root() == slot
    (slot / "held").touch()  # it is a slot that this process was handed down
    assert default_root() == tmp_path
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_root() == tmp_path / "bouncing-spring"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert default_root() == tmp_path / ".cache" / "bouncing-spring"
