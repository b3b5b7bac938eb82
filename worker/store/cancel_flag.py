"""Room: what lies around a store's arrays: the cancel mark beside it, leftovers inside it.

Used through worker.store, which re-exports every function here.
"""

from pathlib import Path
from typing import Final

from worker.store import backend

_SUFFIX: Final = ".cancelled"


def set_cancelled(url: str) -> None:
    """Ask every task writing to this store to stop. The store need not exist yet."""
    backend.put_mark(f"{url}{_SUFFIX}")


def clear_cancelled(url: str) -> None:
    """Take the mark away; no harm if there is none."""
    backend.clear_mark(f"{url}{_SUFFIX}")


def is_cancelled(url: str) -> bool:
    """Whether tasks were asked to stop."""
    return backend.has_mark(f"{url}{_SUFFIX}")


def sweep_leftovers(url: str) -> int:
    """Remove what killed writers left half written; only while nobody writes. Returns how many.

    A bucket has none: an object appears whole or not at all.
    """
    leftovers = [] if backend.in_bucket(url) else list(Path(url).rglob("*.partial"))
    for path in leftovers:
        path.unlink(missing_ok=True)
    return len(leftovers)
