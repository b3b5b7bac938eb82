"""Small files beside a store's arrays: marker, cancel flag, checkpoints."""

import hashlib
import io
import math
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from worker.store import backend

#: The file beside the stores with the id of the service's ledger, written once. It proves to a worker that it
#: sees the service's folder, and to the service that the folder is there.
MARKER: Final = ".ledger"

#: Seconds for which no task of this process asks a bucket again that had no cancel flag, and most stores that
#: are remembered.
REMEMBERED_SECONDS: Final = 1.0
MOST_REMEMBERED: Final = 256
_unset: dict[str, float] = {}  # when the flag was found not set, by store

_CHECKPOINT: Final = ".checkpoint-"
_DIGEST_BYTES = hashlib.sha256().digest_size


def write_marker(url: str, content: str) -> None:
    """Mark a folder of stores, or prefix of a bucket. Raises OSError, or `store.Unreachable`."""
    backend.make_place(url)
    backend.put(url, MARKER, content.encode())


def read_marker(url: str) -> str | None:
    """The mark of the stores at an address; None without one. Raises as `write_marker`."""
    content = backend.read_key(url, MARKER)
    return None if content is None else content.decode(errors="replace")


def set_cancelled(url: str) -> None:
    """Set the cancel flag, which makes every task of this store stop. The store need not exist yet."""
    _unset.pop(url, None)
    folder, name = _flag(url)
    backend.make_place(folder)
    backend.put(folder, name, b"")


def clear_cancelled(url: str) -> None:
    """Remove the cancel flag, if it is set."""
    backend.delete(*_flag(url))


def is_cancelled(url: str) -> bool:
    """Whether the cancel flag is set; in a bucket, whether it was a second ago."""
    now = time.monotonic()
    if now - _unset.get(url, -math.inf) < REMEMBERED_SECONDS:
        return False
    if backend.read_key(*_flag(url)) is not None:
        return True
    if backend.in_bucket(url):
        if len(_unset) >= MOST_REMEMBERED:
            _unset.clear()
        _unset[url] = now
    return False


def _flag(url: str) -> tuple[str, str]:
    """The folder that has the store and its flag, and the name of the flag."""
    folder, name = os.path.split(url)
    return folder, f"{name}.cancelled"


def sweep_leftovers(url: str, *, done: bool = False) -> None:
    """Remove partial files of killed writers.

    A task of an earlier start that is still writing fails; nobody takes its result. Buckets have no
    partial objects: writing one is atomic. done: all chunks are, and checkpoints, which tasks of an earlier
    start wrote, are removed too.
    """
    for chunk in checkpoints_in(url) if done else ():
        remove_checkpoint(url, chunk)
    if backend.in_bucket(url):
        return
    partial = Path(url, backend.PARTIAL)
    leftovers = [] if partial.is_symlink() else list(partial.glob("*.partial"))
    leftovers += Path(url).glob(".*.partial")  # of checkpoints
    for path in leftovers:
        backend.clear(path)


def write_checkpoint(url: str, chunk: int, arrays: Mapping[str, Any]) -> None:
    """Keep the progress of a chunk in the store at `url`, replacing earlier arrays.

    Without it the chunk begins again, with the same result. Raises OSError, or `store.Unreachable`.
    """
    file = io.BytesIO()
    np.savez(file, **arrays)
    content = file.getvalue()
    backend.put(url, f"{_CHECKPOINT}{chunk}", hashlib.sha256(content).digest() + content)


def read_checkpoint(url: str, chunk: int) -> dict[str, NDArray[Any]] | None:
    """The arrays of a chunk's checkpoint; None if it is missing or damaged."""
    stored = backend.read_key(url, f"{_CHECKPOINT}{chunk}")
    if stored is None or hashlib.sha256(stored[_DIGEST_BYTES:]).digest() != stored[:_DIGEST_BYTES]:
        return None
    try:
        with np.load(io.BytesIO(stored[_DIGEST_BYTES:]), allow_pickle=False) as arrays:
            return dict(arrays)
    except (ValueError, BadZipFile):  # from another release
        return None


def checkpoints_in(url: str) -> list[int]:
    """The chunks that have a checkpoint in a store."""
    names = (name.removeprefix(_CHECKPOINT) for name in backend.names_in(url) if name.startswith(_CHECKPOINT))
    return [int(number) for number in names if number.isdecimal()]


def remove_checkpoint(url: str, chunk: int) -> None:
    """Remove a chunk's checkpoint, if there is one."""
    backend.delete(url, f"{_CHECKPOINT}{chunk}")
