"""Temporary folders of this process: removed at the end of their block, or when the process ends early.

Imports the standard library only.
"""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

_folders: Final[set[Path]] = set()


def make(prefix: str) -> Path:
    """A new folder for this user alone, to be removed by `remove`."""
    folder = Path(tempfile.mkdtemp(prefix=prefix))
    _folders.add(folder)
    return folder


def remove(folder: Path) -> None:
    """Remove a folder and its contents."""
    shutil.rmtree(folder, ignore_errors=True)
    _folders.discard(folder)


@contextmanager
def temporary_folder(prefix: str) -> Iterator[Path]:
    """A new folder for this user alone, removed at the end of the block."""
    folder = make(prefix)
    try:
        yield folder
    finally:
        remove(folder)


def remove_all() -> None:
    """Remove all folders in use, because the process ends at once."""
    for folder in list(_folders):
        remove(folder)
