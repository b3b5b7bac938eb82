"""The power is cut at any moment: a service gets ready by itself on what was synced, and nothing is lost."""

import os
import random
import re
import shutil
import sqlite3
import stat
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import httpx2
from scripted import DEADLINE, costing, wait_for
from served import computing_at, done
from stores import files, marked_and_sound, store_in

from service.settings import Settings

TRIALS = int(os.environ.get("BOUNCE_TEST_TRIALS", "6"))
RAMPS = {"kind": "ramp", "axis": "gamma", "direction": "both"}
SWEEP = costing(chunks=1, seconds=0.05, omega=[0.5 + k / 10 for k in range(12)], protocol=RAMPS)  # 20 chunks
DATA, LEDGER = Path("data"), Path("data/ledger.sqlite")


class Disk:
    """What a power cut would leave of a folder, at TRIALS random moments before a call of fsync.

    Names are left once their folder is synced, or at any time before. A file that was not synced is empty
    then. The ledger is left as committed: SQLite syncs it.
    """

    def __init__(self, root: Path) -> None:
        self.root, self.fsync, self.lock, self.moments = root, os.fsync, threading.Lock(), 0
        self.synced: dict[int, bytes | dict[str, int]] = {}  # by inode: contents of a file, names in a folder
        self.kept: list[int] = []  # descriptors, so that no inode is another file's later
        self.cuts: list[dict[Path, bytes | None]] = []

    def sync(self, descriptor: int) -> None:
        path, status = Path(f"/proc/self/fd/{descriptor}").resolve(), os.fstat(descriptor)
        with self.lock:
            if path.is_relative_to(self.root):
                self.cut()
                self.kept.append(os.dup(descriptor))
                is_folder = stat.S_ISDIR(status.st_mode)
                self.synced[status.st_ino] = self.names(path) if is_folder else path.read_bytes()
            self.fsync(descriptor)

    def names(self, folder: Path) -> dict[str, int]:
        paths = [path for path in folder.iterdir() if not re.search(r"^ledger\.|\.partial$", path.name)]
        return {path.name: path.lstat().st_ino for path in paths}

    def cut(self) -> None:
        self.moments += 1
        place = len(self.cuts) if len(self.cuts) < TRIALS else random.randrange(self.moments)
        if place < TRIALS:
            left = dict(self.left(self.root, random.random() < 0.5))
            if (self.root / LEDGER).exists():
                with closing(sqlite3.connect(self.root / LEDGER)) as ledger:
                    left[LEDGER] = ledger.serialize()
            self.cuts[place : place + 1] = [left]

    def left(self, folder: Path, at_once: bool) -> Iterator[tuple[Path, bytes | None]]:
        """Contents of files in a folder, None for folders. `at_once`: names need no sync."""
        names = self.names(folder) if at_once else self.synced.get(folder.stat().st_ino, {})
        assert isinstance(names, dict)
        for name, inode in names.items():
            path = folder / name
            content = None if path.is_dir() else self.synced.get(inode, b"")
            assert not isinstance(content, dict)
            yield path.relative_to(self.root), content
            if content is None:
                yield from self.left(path, at_once)


def test_a_service_is_ready_after_a_power_cut_and_has_what_was_done(tmp_path, monkeypatch):
    disk = Disk(tmp_path / "disk")
    disk.root.mkdir()
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", disk.sync)
        with computing_at(disk.root / DATA) as address:
            job_id = done(address, SWEEP.as_submitted())
    for descriptor in disk.kept:
        os.close(descriptor)
    whole, marked = files(store_in(disk.root / DATA, job_id)), 0
    for left in disk.cuts:
        assert DATA in left or LEDGER not in left, "the folder of the ledger was not synced"
        folder = tmp_path / "left"
        for path, content in {Path(): None, **left}.items():
            (folder / path).mkdir() if content is None else (folder / path).write_bytes(content)
        settings = Settings(data=folder / DATA)
        marked += marked_and_sound(settings, job_id)
        with computing_at(folder / DATA) as address:
            wait_for(lambda at=address: httpx2.get(f"{at}/readyz", timeout=DEADLINE).status_code == 200)
            assert done(address, SWEEP.as_submitted()) == job_id
        assert files(store_in(settings.data, job_id)) == whole
        shutil.rmtree(folder)
    assert marked > 0
