"""Files and folders that other users of the machine must not change or read.

Imports the standard library only: the kernel cache is checked before anything else is loaded.
"""

import fcntl
import logging
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from worker.files import make_folder

log = logging.getLogger(__name__)

#: Permissions of group and others, and their permission to write.
_OTHERS: Final = 0o077
_OTHERS_WRITE: Final = 0o022
#: The permissions of a folder, and of a file, for one user alone.
PRIVATE_FOLDER: Final = 0o700
PRIVATE_FILE: Final = 0o600

#: In a temporary folder, locked as long as its process lives.
_MARK: Final = ".in-use"

_ROOT: Final = Path("/")

_temporary: Final[set[Path]] = set()


class NotOurs(Exception):
    """Another user owns a file or folder, or can write to it; the text names it and the remedy."""


def make_private(folder: Path) -> None:
    """Create a folder that only this user can enter; an existing one is closed, with a warning.

    Raises NotOurs if another user owns it or something in it, or all users share it, and OSError.
    """
    make_folder(folder, PRIVATE_FOLDER)
    status = folder.stat()
    if not _is_ours(status):
        raise NotOurs(f"{folder} belongs to another user, who could change its contents")
    mode = stat.S_IMODE(status.st_mode)
    if not mode & _OTHERS:
        return
    if (mode & stat.S_ISVTX and mode & stat.S_IWOTH) or _is_of_system(folder.resolve()):
        raise NotOurs(f"{folder} is shared by all users of this machine: name a folder in it")
    try:
        folder.chmod(mode & ~_OTHERS)
        log.warning("%s was open to other users of this machine (mode %04o); it is closed now", folder, mode)
    except PermissionError:  # owned by root, as a container's volume can be
        log.warning("%s is open to other users of this machine (mode %04o)", folder, mode)
    if mode & _OTHERS_WRITE:
        for path in folder.iterdir():
            if not _is_ours(path.lstat()):
                raise NotOurs(f"{path} belongs to another user, who could write to {folder}")


def _is_of_system(folder: Path) -> bool:
    """Whether this is the root, or a folder in it with folders, beside our own, that others may enter."""
    return folder.parent == _ROOT and any(
        inner.is_dir() and inner.stat().st_mode & stat.S_IXOTH
        for inner in folder.iterdir()
        if inner.name != "stores" and ".zarr" not in inner.suffixes
    )


def check_unshared(root: Path) -> None:
    """Raise NotOurs unless only this user or root can have written everything in `root`.

    A missing folder passes. Inside a folder that only this user can enter, only owners matter, not
    permissions: the folder may have been open before.
    """
    try:
        status = root.stat()
    except FileNotFoundError:
        return
    for above in root.resolve().parents:
        mode = above.stat().st_mode
        if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
            raise NotOurs(f"{above} can be written by every user of this machine, who could replace {root}")
    _check(root, status, _OTHERS_WRITE)


def _check(path: Path, status: os.stat_result, forbidden: int) -> None:
    """Check a file, or a folder and everything in it. `forbidden`: permissions that they must not give."""
    if not _is_ours(status):
        raise NotOurs(f"{path} belongs to another user")
    if status.st_mode & forbidden:
        raise NotOurs(f"{path} can be written by other users (mode {stat.S_IMODE(status.st_mode):04o})")
    if not stat.S_ISDIR(status.st_mode):
        return
    for inner in path.iterdir():
        with suppress(FileNotFoundError):  # another process has just replaced or moved it
            inner_status = inner.lstat()
            if stat.S_ISLNK(inner_status.st_mode):
                raise NotOurs(f"{inner} is a link: its target may belong to another user")
            _check(inner, inner_status, forbidden if status.st_mode & _OTHERS else 0)


def _is_ours(status: os.stat_result) -> bool:
    return status.st_uid in (os.geteuid(), 0)


@contextmanager
def temporary_folder(prefix: str) -> Iterator[Path]:
    """A new folder for this user alone, removed at the end of the block, or by the next one after a kill."""
    _remove_left(prefix)
    folder = Path(tempfile.mkdtemp(prefix=prefix))
    _temporary.add(folder)
    try:
        with (folder / f"{_MARK}.new").open("x") as mark:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(mark, fcntl.LOCK_EX)
                (folder / f"{_MARK}.new").rename(folder / _MARK)  # nobody sees it unlocked
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _temporary.discard(folder)


def _remove_left(prefix: str) -> None:
    """Remove the temporary folders of processes that were killed."""
    for mark in Path(tempfile.gettempdir()).glob(f"{prefix}*/{_MARK}"):
        with suppress(OSError):  # another process has it, or another user
            file = os.open(mark, os.O_RDONLY | os.O_NONBLOCK)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(mark.parent)
            finally:
                os.close(file)


def remove_temporary_folders() -> None:
    """Remove all temporary folders in use, because the process ends at once."""
    for folder in list(_temporary):
        shutil.rmtree(folder, ignore_errors=True)
