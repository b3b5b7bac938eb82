"""The cancel flag, an empty file beside a store, and the partial files of killed writers inside it."""

import math
import time
from pathlib import Path
from typing import Final

from worker.store import backend

_SUFFIX: Final = ".cancelled"


#: A bucket without the flag is not asked again for this long by any task of this process, for at most this
#: many stores.
REMEMBERED_SECONDS: Final = 1.0
MOST_REMEMBERED: Final = 256
_unset: dict[str, float] = {}  # when the flag was found not set, by store


def set_cancelled(url: str) -> None:
    """Set the cancel flag, which makes every task of this store stop. The store need not exist yet."""
    _unset.pop(url, None)
    backend.put_flag(f"{url}{_SUFFIX}")


def clear_cancelled(url: str) -> None:
    """Remove the cancel flag, if it is set."""
    backend.clear_flag(f"{url}{_SUFFIX}")


def is_cancelled(url: str) -> bool:
    """Whether the cancel flag is set; in a bucket, whether it was a second ago."""
    if not backend.in_bucket(url):
        return backend.has_flag(f"{url}{_SUFFIX}")
    now = time.monotonic()
    if now - _unset.get(url, -math.inf) < REMEMBERED_SECONDS:
        return False
    if backend.has_flag(f"{url}{_SUFFIX}"):
        return True
    if len(_unset) >= MOST_REMEMBERED:
        _unset.clear()
    _unset[url] = now
    return False


def sweep_leftovers(url: str) -> int:
    """Remove partial files of killed writers and return their number.

    A task of an earlier start that is still writing fails; nobody takes its result. Buckets have no
    partial objects: writing one is atomic.
    """
    if backend.in_bucket(url):
        return 0
    # The second folder holds checkpoints.
    leftovers = [*Path(url, backend.PARTIAL).glob("*.partial"), *Path(url).glob(".*.partial")]
    for path in leftovers:
        path.unlink(missing_ok=True)
    return len(leftovers)
