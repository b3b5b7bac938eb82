"""Checkpoints of long chunks: their progress, in a file in the store.

A checkpoint only saves time. A missing or damaged one is no error: the chunk begins
anew, with the same result.
"""

import hashlib
import io
from collections.abc import Mapping
from typing import Any, Final
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from worker.store import backend

_PREFIX: Final = ".checkpoint-"
_DIGEST_BYTES = hashlib.sha256().digest_size


def write_checkpoint(url: str, chunk: int, arrays: Mapping[str, Any]) -> None:
    """Keep arrays of a chunk in the store at `url`, replacing earlier ones.

    Raises OSError, or one of `store.UNREACHABLE`.
    """
    file = io.BytesIO()
    np.savez(file, **arrays)
    content = file.getvalue()
    backend.put(url, _key(chunk), hashlib.sha256(content).digest() + content)


def read_checkpoint(url: str, chunk: int) -> dict[str, NDArray[Any]] | None:
    """The arrays of a chunk's checkpoint; None if it is missing or damaged."""
    stored = backend.read_key(url, _key(chunk))
    if stored is None or hashlib.sha256(stored[_DIGEST_BYTES:]).digest() != stored[:_DIGEST_BYTES]:
        return None
    try:
        with np.load(io.BytesIO(stored[_DIGEST_BYTES:]), allow_pickle=False) as arrays:
            return dict(arrays)
    except (ValueError, BadZipFile):  # from another release
        return None


def checkpoints_in(url: str) -> list[int]:
    """The chunks that have a checkpoint in a store."""
    names = (name.removeprefix(_PREFIX) for name in backend.names_in(url) if name.startswith(_PREFIX))
    return [int(number) for number in names if number.isdecimal()]


def remove_checkpoint(url: str, chunk: int) -> None:
    """Remove a chunk's checkpoint, if there is one."""
    backend.delete(url, _key(chunk))


def _key(chunk: int) -> str:
    return f"{_PREFIX}{chunk}"
