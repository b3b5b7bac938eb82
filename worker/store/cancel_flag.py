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


def sweep_leftovers(url: str, *, everywhere: bool = False) -> int:
    """Remove partial files of killed writers and return their number.

    A task of an earlier start that still writes fails: its result is taken by nobody.
    everywhere: in every folder, where releases before 0.2.0 left them; takes long where there are many.

    Buckets have no partial objects: writing one is atomic.
    """
    if backend.in_bucket(url):
        return 0
    leftovers = list(Path(url, backend.PARTIAL).glob("*.partial"))
    if everywhere:
        leftovers += [path for path in Path(url).rglob("*.partial") if path.name != backend.PARTIAL]
    for path in set(leftovers):
        path.unlink(missing_ok=True)
    return len(set(leftovers))
