"""Watches whether the files of an open ledger are still at their paths.

Files can be moved, replaced and overwritten under a running service, by a restore, a synchronised folder or a
mistake. SQLite does not notice: it would keep writing to a file that nobody finds again, or mix two ledgers.
"""

import logging
import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from itertools import chain, count
from pathlib import Path
from typing import Final

from service.errors import LedgerUnusable

log = logging.getLogger(__name__)

#: File systems shared between machines: SQLite's WAL mode needs memory shared by all users of the file.
NETWORK: Final = frozenset(
    (
        "9p", "afs", "beegfs", "ceph", "cifs", "fuse.glusterfs", "fuse.s3fs", "fuse.sshfs", "glusterfs",
        "gpfs", "lustre", "ncpfs", "nfs", "nfs4", "smb3", "smbfs",
    )
)  # fmt: skip

#: Reasons for a copy of a ledger beside it, in the copy's name.
COPIES: Final = ("as-found", "rescued", "replaced")

_Inode = tuple[int, int]


def wal_of(path: Path) -> Path:
    """The write-ahead log of a ledger."""
    return path.with_name(f"{path.name}-wal")


def shm_of(path: Path) -> Path:
    """The index of the write-ahead log."""
    return path.with_name(f"{path.name}-shm")


def lock_of(path: Path) -> Path:
    """The file that the user of a ledger locks."""
    return path.with_suffix(".lock")


def aside(path: Path, why: str) -> Path:
    """A free path beside a ledger for another copy, with the time in its name."""
    stem = f"{path.stem}-{why}-{time.strftime('%Y%m%dT%H%M%S')}"
    names = chain([stem], (f"{stem}-{number}" for number in count(2)))
    paths = (path.with_name(f"{name}{path.suffix}") for name in names)
    return next(free for free in paths if not free.exists())


class OpenFiles:
    """The open files of a ledger, as of creation: after the files were opened and written to."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._inodes = {file: _inode(file) for file in (path.parent, lock_of(path), path)}
        self._logs = {file: _inode(file) for file in (wal_of(path), shm_of(path))}
        self._written = self._state()
        self._rescued = False

    def note_written(self) -> None:
        """Note that the caller has written to the ledger, whose file may have been moved meanwhile."""
        self._written = self._state()

    def changed_from_outside(self) -> bool:
        """Whether another program has written to the main file, which is still the same."""
        state = self._state()
        if self._written is None:  # it was away when the caller had written to it
            self._written = state
        return state is not None and state != self._written

    def replaced(self) -> str | None:
        """Which of folder, lock and main file is no longer the open one, and what to do; None if none."""
        for file, opened in self._inodes.items():
            now = _inode(file)
            if now != opened:
                what = "is gone" if now is None else "is another one now"
                folder = "the data folder" if file == self._path.parent else "the data folder's"
                return (
                    f"{folder} {file.name} {what}, moved or replaced while the service runs: nothing is "
                    "accepted or written; put it back, or stop the service and start it again"
                )
        return None

    def lost_wal(self) -> bool:
        """Whether the write-ahead log or its index is no longer the open one."""
        return any(_inode(file) != opened for file, opened in self._logs.items())

    def set_logs_aside(self) -> None:
        """Move away foreign files at the paths of the log and its index."""
        for file, opened in self._logs.items():
            if _inode(file) not in (None, opened):
                file.rename(aside(file, "foreign"))

    def rescue_path(self) -> Path | None:
        """Where to copy the open ledger once, if only the main file was removed or replaced."""
        others = (file for file in self._inodes if file != self._path)
        if self._rescued or any(_inode(file) != self._inodes[file] for file in others):
            return None
        self._rescued = True
        return aside(self._path, "rescued")

    def _state(self) -> tuple[int, int] | None:
        """Size and time of change of the main file; None while it is not at its path."""
        try:
            status = self._path.stat()
        except OSError:
            return None
        is_ours = (status.st_dev, status.st_ino) == self._inodes[self._path]
        return (status.st_size, status.st_mtime_ns) if is_ours else None


@contextmanager
def as_found(path: Path) -> Iterator[None]:
    """Keep a ledger with an unfinished write-ahead log as found, if the block finds it unusable.

    Opening and closing it moves the log's contents to the main file, which cannot be undone if the log
    belongs to another copy. The error names the copies beside the ledger.
    """
    copy = aside(path, "as-found")
    with ExitStack() as stack:
        stack.callback(_remove, copy)
        if path.exists() and size_of(wal_of(path)):
            _copy_with_log(path, copy)
        try:
            yield
        except LedgerUnusable as error:
            stack.pop_all()
            copies = ", ".join(str(other) for other in copies_of(path))
            raise LedgerUnusable(f"{error}; beside it: {copies}" if copies else str(error)) from error


def copies_of(path: Path) -> list[Path]:
    """The copies of a ledger made beside it by this module and by restores, the newest last."""
    return sorted(
        (copy for why in COPIES for copy in path.parent.glob(f"{path.stem}-{why}-*{path.suffix}")),
        key=lambda copy: copy.stat().st_mtime,
    )


def _copy_with_log(path: Path, copy: Path) -> None:
    try:
        shutil.copy2(path, copy)
        shutil.copy2(wal_of(path), wal_of(copy))
    except OSError as error:  # a full disk: the service must be able to start
        log.warning("no copy of %s is made before its log is applied: %s", path, error)
        _remove(copy)


def _remove(copy: Path) -> None:
    for file in (copy, wal_of(copy)):
        with suppress(OSError):
            file.unlink(missing_ok=True)


def size_of(path: Path) -> int:
    """Bytes of a file; 0 if it is missing."""
    return path.stat().st_size if path.exists() else 0


def network_file_system(path: Path) -> str | None:
    """The type of `path`'s file system if other machines share it; None if not, or unknown."""
    kind = file_system(path)
    return kind if kind in NETWORK else None


def file_system(path: Path) -> str | None:
    """The type of `path`'s file system, from the system's table of mounts; None if unknown."""
    try:
        mounts = [line.split() for line in Path("/proc/self/mounts").read_text().splitlines()]
    except OSError:
        return None
    kinds = {Path(point.replace("\\040", " ")): kind for _, point, kind, *_ in mounts}
    return next((kinds[at] for at in (path.absolute(), *path.absolute().parents) if at in kinds), None)


def _inode(path: Path) -> _Inode | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino
