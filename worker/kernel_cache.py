"""Numba's cache of compiled kernels, one folder per process.

numba reads `NUMBA_CACHE_DIR` when kernels are declared, so a process claims its cache before it imports any
kernel. This module therefore uses the standard library only and imports kernels in `warm` alone.

Two processes that write to the same numba cache can crash, and numba notices a change of a source file only
in the outermost function. So compiled kernels are kept in

    ROOT/DIGEST/slot-N/     the cache of one process at a time, held by a lock that ends with the process
    ROOT/DIGEST/ready/      a copy made by the first process that finished compiling, to start others from

where DIGEST identifies the kernel's sources. ROOT is the argument of `claim_cache`, else `NUMBA_CACHE_DIR`,
else `bouncing-spring` in the user's cache folder. Whoever can write to ROOT decides what code runs here, so
it is made for this user alone, and one that others own or can write to is refused.
"""

import fcntl
import hashlib
import os
import platform
import shutil
import sys
import tempfile
import time
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import Final

from worker.ownership import PRIVATE_FOLDER, NotOurs, check_unshared

_VARIABLE: Final = "NUMBA_CACHE_DIR"
_LOCK: Final = "held"
_READY: Final = "ready"
_COMPILED: Final = "*.nbc"
_OLD_SECONDS: Final = 14 * 24 * 3600


class CacheRefused(Exception):
    """Other users could have written the compiled kernels; the text says where, and what to do."""


#: The slot this process holds. The lock's file descriptor stays open until the process ends.
_held: list[Path] = []


def warm(root: str | Path | None = None) -> None:
    """Claim a cache for this process, and compile every kernel or load it from the cache.

    Loading takes about a second, compiling half a minute. Of several processes that start together, one
    compiles and the others wait for it. May run in a thread if the cache is claimed already.
    Raises CacheRefused.
    """
    slot = claim_cache(root)
    # Not at the top of the module: kernels are declared here, with the cache that was just claimed.
    from worker.tasks import compile_kernels  # noqa: PLC0415

    if slot is None or (slot.parent / _READY).exists():
        if slot is not None:
            _seed(slot)  # the slot may have been claimed before `ready` existed
        compile_kernels()
        return
    with (slot.parent / "compiling").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        _seed(slot)
        compile_kernels()
        _publish(slot)


def claim_cache(root: str | Path | None = None) -> Path | None:
    """Set `NUMBA_CACHE_DIR` to a cache folder that no other running process uses, and return the folder.

    Called again, returns the same folder. Returns None if kernels have been declared without a cache.
    The folder stays when the process ends, for the next one. Call it before starting threads: it changes
    the environment. Raises CacheRefused, or ModuleNotFoundError if there is no kernel.
    """
    if _held:
        return _held[0]
    if "kernel.numerics.jit" in sys.modules:
        return None
    slot = _claim(Path(root) if root else default_root())
    os.environ[_VARIABLE] = str(slot)
    if "numba" in sys.modules:
        sys.modules["numba"].core.config.reload_config()
    return slot


def _check(root: Path) -> None:
    """Raise CacheRefused if other users own or can write to `root`, or anything in it."""
    try:
        check_unshared(root)
    except NotOurs as error:
        raise CacheRefused(
            f"the kernel cache {root} is not safe to use: {error}, so others could run code here; remove it, "
            f"and it is made anew for you alone, or set {_VARIABLE} to a folder of your own"
        ) from error


def default_root() -> Path:
    """The folder of all caches if the caller names none."""
    configured = os.environ.get(_VARIABLE)
    if not configured:
        return Path(os.environ.get("XDG_CACHE_HOME") or _home() / ".cache") / "bouncing-spring"
    # Inherited from a process that claimed a slot: the variable names that slot, not the root.
    is_slot = (Path(configured) / _LOCK).exists()
    return Path(configured).parent.parent if is_slot else Path(configured)


def _home() -> Path:
    try:
        return Path.home()
    except RuntimeError:  # a user without an entry in the password database, as in containers
        return Path(tempfile.mkdtemp(prefix="bouncing-spring-"))


def _claim(root: Path) -> Path:
    try:
        _check(root)
        return _first_free_slot(root / _digest())
    except OSError:  # no home, a read-only disk, a file system without locks
        return _first_free_slot(Path(tempfile.mkdtemp(prefix="bouncing-spring-")))


def _first_free_slot(folder: Path) -> Path:
    for number in count():
        slot = folder / f"slot-{number}"
        _make(slot)
        lock = os.open(slot / _LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            continue
        os.utime(lock)  # the time of last use, for _remove_old
        _held.append(slot)
        _seed(slot)
        return slot
    raise AssertionError


def _make(folder: Path) -> None:
    """Make a folder, and those above it that are missing, for this user alone."""
    if not folder.parent.exists():
        _make(folder.parent)
    folder.mkdir(PRIVATE_FOLDER, exist_ok=True)


def _seed(slot: Path) -> None:
    """Copy the compiled kernels in `ready`, if it exists, to a slot that has none."""
    ready = slot.parent / _READY
    # Compiled files, not any files: numba creates folders in the slot when kernels are declared.
    if ready.is_dir() and not any(slot.rglob(_COMPILED)):
        shutil.copytree(ready, slot, dirs_exist_ok=True)


def _publish(slot: Path) -> None:
    """Copy a complete cache to `ready`, by renaming, so that others never see part of it. Done once."""
    if (slot.parent / _READY).exists():
        return
    draft = Path(tempfile.mkdtemp(prefix="draft-", dir=slot.parent))
    shutil.copytree(slot, draft, dirs_exist_ok=True, ignore=shutil.ignore_patterns(_LOCK))
    draft.rename(slot.parent / _READY)
    _remove_old(slot.parent.parent, keep=slot.parent)


def _remove_old(root: Path, keep: Path) -> None:
    """Remove the caches of other kernel sources that were last used two weeks ago or earlier."""
    for lock in root.glob(f"*/slot-0/{_LOCK}"):
        folder = lock.parents[1]
        if folder != keep and time.time() - lock.stat().st_mtime > _OLD_SECONDS:
            shutil.rmtree(folder, ignore_errors=True)


def _digest() -> str:
    """An identifier of the kernel's sources: modification times, as numba compares, and contents.

    Raises ModuleNotFoundError if there is no kernel.
    """
    if (package := find_spec("kernel")) is None:
        raise ModuleNotFoundError("No module named 'kernel'", name="kernel")
    folder = Path(next(iter(package.submodule_search_locations or ())))
    digest = hashlib.sha256(f"{platform.python_version()} {platform.machine()}".encode())
    for source in sorted(folder.rglob("*.py")):
        digest.update(f"{source.relative_to(folder)} {source.stat().st_mtime_ns}\n".encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]
