"""Room: compiled kernels ready before the first task, each process with a cache of its own.

Standard library only. Must be imported before any kernel is, and imports none itself until told
to: numba reads `NUMBA_CACHE_DIR` when kernels are declared.

Two processes writing one numba cache can crash, and numba notices a changed source only in
the outermost function. So compiled kernels live in

    ROOT/DIGEST/slot-N/     one process at a time, held by a lock that dies with it
    ROOT/DIGEST/ready/      what the first to finish compiling left for the others to copy

where DIGEST names the kernel's sources, and ROOT is what is asked for, or NUMBA_CACHE_DIR,
or a folder in the user's cache.
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

_VARIABLE: Final = "NUMBA_CACHE_DIR"
_LOCK: Final = "held"
_READY: Final = "ready"
_COMPILED: Final = "*.nbc"
_OLD_SECONDS: Final = 14 * 24 * 3600

#: The slot this process holds, until it ends: its lock is never closed on purpose.
_held: list[Path] = []


def warm(root: str | Path | None = None) -> None:
    """Claim a cache for this process and compile every kernel into it, or read what is there.

    Takes a second or so from a cache, and half a minute the first time; of several processes
    that start together one compiles and the others wait for it.
    """
    slot = claim_cache(root)
    # Not at the top: the kernels' declarations look for the cache that was just claimed.
    from worker.tasks import compile_kernels  # noqa: PLC0415

    if slot is None or (slot.parent / _READY).exists():
        if slot is not None:
            _seed(slot)  # it may have been claimed before there was anything to copy
        compile_kernels()
        return
    with (slot.parent / "compiling").open("a") as turn:
        fcntl.flock(turn, fcntl.LOCK_EX)
        _seed(slot)
        compile_kernels()
        _publish(slot)


def claim_cache(root: str | Path | None = None) -> Path | None:
    """Point numba at a cache folder that no other living process uses; it outlives this one.

    The same folder if called again; None if kernels were declared without one already.
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


def default_root() -> Path:
    """Where caches go unless told otherwise."""
    given = os.environ.get(_VARIABLE)
    if not given:
        return Path(os.environ.get("XDG_CACHE_HOME") or _home() / ".cache") / "bouncing-spring"
    # A process that claimed a slot hands its environment down to those it starts.
    inherited = (Path(given) / _LOCK).exists()
    return Path(given).parent.parent if inherited else Path(given)


def _home() -> Path:
    try:
        return Path.home()
    except RuntimeError:  # a user unknown to the system, as in containers: a folder that is nobody else's
        return Path(tempfile.mkdtemp(prefix="bouncing-spring-"))


def _claim(root: Path) -> Path:
    try:
        return _first_free_slot(root / _digest())
    except OSError:  # no home, a read-only disk, a file system without locks
        return _first_free_slot(Path(tempfile.mkdtemp(prefix="bouncing-spring-")))


def _first_free_slot(folder: Path) -> Path:
    for number in count():
        slot = folder / f"slot-{number}"
        slot.mkdir(parents=True, exist_ok=True)
        lock = os.open(slot / _LOCK, os.O_RDWR | os.O_CREAT)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            continue
        os.utime(lock)  # when it was last used
        _held.append(slot)
        _seed(slot)
        return slot
    raise AssertionError


def _seed(slot: Path) -> None:
    """Give a cache without anything compiled what the first process left, if it has finished."""
    ready = slot.parent / _READY
    # Not "an empty cache": numba makes its folders in it when kernels are declared.
    if ready.is_dir() and not any(slot.rglob(_COMPILED)):
        shutil.copytree(ready, slot, dirs_exist_ok=True)


def _publish(slot: Path) -> None:
    """Leave a finished cache for others; it appears whole, once, and is never written again."""
    if (slot.parent / _READY).exists():
        return
    draft = Path(tempfile.mkdtemp(prefix="draft-", dir=slot.parent))
    shutil.copytree(slot, draft, dirs_exist_ok=True, ignore=shutil.ignore_patterns(_LOCK))
    draft.rename(slot.parent / _READY)
    _forget_old(slot.parent.parent, keep=slot.parent)


def _forget_old(root: Path, keep: Path) -> None:
    """Remove caches of kernels that nobody has run for a fortnight; touches nothing but our own folders."""
    for lock in root.glob(f"*/slot-0/{_LOCK}"):
        folder = lock.parents[1]
        if folder != keep and time.time() - lock.stat().st_mtime > _OLD_SECONDS:
            shutil.rmtree(folder, ignore_errors=True)


def _digest() -> str:
    """A name for this version of the kernel's sources, by what numba looks at and what it overlooks."""
    package = find_spec("kernel")
    folder = Path(next(iter(package.submodule_search_locations or ()))) if package else Path()
    digest = hashlib.sha256(f"{platform.python_version()} {platform.machine()}".encode())
    for source in sorted(folder.rglob("*.py")):
        digest.update(f"{source.relative_to(folder)} {source.stat().st_mtime_ns}\n".encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]
