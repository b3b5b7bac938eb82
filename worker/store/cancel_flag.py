"""The cancel flag, an empty file beside a store, and the partial files of killed writers inside it."""

from pathlib import Path
from typing import Final

from worker.store import backend

_SUFFIX: Final = ".cancelled"


def set_cancelled(url: str) -> None:
    """Set the cancel flag, which makes every task of this store stop. The store need not exist yet."""
    backend.put_flag(f"{url}{_SUFFIX}")


def clear_cancelled(url: str) -> None:
    """Remove the cancel flag, if it is set."""
    backend.clear_flag(f"{url}{_SUFFIX}")


def is_cancelled(url: str) -> bool:
    """Whether the cancel flag is set."""
    return backend.has_flag(f"{url}{_SUFFIX}")


def sweep_leftovers(url: str) -> int:
    """Remove partial files of killed writers and return their number; no task may be writing.

    Buckets have no partial objects: writing one is atomic.
    """
    leftovers = [] if backend.in_bucket(url) else list(Path(url).rglob("*.partial"))
    for path in leftovers:
        path.unlink(missing_ok=True)
    return len(leftovers)
