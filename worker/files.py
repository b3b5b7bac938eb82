"""Files that are written completely or not at all, and outlast a power cut once they are written.

Imports the standard library only.
"""

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import IO, Final

#: Links in these folders stand for streams that are open.
_STREAMS: Final = tuple(map(Path, ("/dev", "/dev/fd", "/proc/self/fd")))

#: Errors of writing alone, which do not name the file.
_OF_WRITES: Final = (errno.EDQUOT, errno.EFBIG, errno.ENOSPC)


@contextmanager
def complete_file(path: Path, *, private: bool = False) -> Iterator[IO[bytes]]:
    """A file that takes the place of `path` once the block has ended without an error.

    A symbolic link is replaced, and what it points to is left alone. A pipe or a device is written to, not
    replaced. A `private` file is for this user alone, and replaces these too. Raises OSError.
    """
    if not private and (path.parent in _STREAMS or (path.exists() and not path.is_file())):
        with path.open("wb") as stream:
            yield stream
        return
    with replacing(path, private=private) as file:
        if not private and path.is_file() and not path.is_symlink():
            os.fchmod(file.fileno(), path.stat().st_mode & 0o7777)
        yield file


@contextmanager
def replacing(path: Path, *, private: bool = False) -> Iterator[IO[bytes]]:
    """As `complete_file`, but replaces anything at `path` except a folder.

    Errors name `path`, not the file that takes its place.
    """
    if not path.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "there is no such folder", str(path.parent))
    draft = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        with synced(draft, private=private) as file:
            yield file
        draft.replace(path)
    except OSError as error:
        if error.filename != str(draft) and (error.filename or error.errno not in _OF_WRITES):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        draft.unlink(missing_ok=True)
    sync(path.parent)


@contextmanager
def synced(path: Path, *, private: bool = False) -> Iterator[IO[bytes]]:
    """A new file whose contents are on the disk after the block; `sync` of its folder secures its name."""
    with open(path, "xb", opener=partial(os.open, mode=0o600) if private else None) as file:
        yield file
        file.flush()
        os.fsync(file.fileno())


def make_folder(folder: Path, mode: int = 0o777) -> None:
    """Create a folder and its parents where they are missing, on the disk too."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(mode, parents=True, exist_ok=True)
    for path in missing:
        sync(path.parent)


def sync(path: Path) -> None:
    """Sync a file, or the names in a folder, to disk. Raises OSError."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except PermissionError:  # a folder that may be written to and not read
        return
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some network file systems cannot sync a folder
            raise
    finally:
        os.close(descriptor)
