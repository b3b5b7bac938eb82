"""Room: what lies around a store's arrays: the cancel mark beside it, leftovers inside it.

Standard library only. Used through worker.store, which re-exports every function here.
"""

from pathlib import Path
from typing import Final

_SUFFIX: Final = ".cancelled"


def set_cancelled(url: str) -> None:
    """Ask every task writing to this store to stop. The store need not exist yet."""
    mark = _mark(url)
    mark.parent.mkdir(parents=True, exist_ok=True)
    mark.touch()


def clear_cancelled(url: str) -> None:
    """Take the mark away; no harm if there is none."""
    _mark(url).unlink(missing_ok=True)


def is_cancelled(url: str) -> bool:
    """Whether tasks were asked to stop."""
    return _mark(url).exists()


def sweep_leftovers(url: str) -> int:
    """Remove what killed writers left half written; only while nobody writes. Returns how many."""
    leftovers = list(Path(url).rglob("*.partial"))
    for path in leftovers:
        path.unlink(missing_ok=True)
    return len(leftovers)


def _mark(url: str) -> Path:
    return Path(f"{url}{_SUFFIX}")
