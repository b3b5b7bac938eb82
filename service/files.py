"""Files that are written completely or not at all. Imports the standard library only."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Final

#: Links in these folders stand for streams that are open.
_STREAMS: Final = tuple(map(Path, ("/dev", "/dev/fd", "/proc/self/fd")))


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
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    with open(partial, "xb", opener=_private if private else None) as file:
        try:
            if not private and path.is_file() and not path.is_symlink():
                os.fchmod(file.fileno(), path.stat().st_mode & 0o7777)
            yield file
            file.close()
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)


def _private(path: str, flags: int) -> int:
    return os.open(path, flags, 0o600)
