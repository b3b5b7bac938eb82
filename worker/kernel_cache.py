"""Where compiled kernels are kept: ROOT/DIGEST, shared by all processes of this user.

DIGEST identifies the kernel's sources and the compiler. ROOT is `NUMBA_CACHE_DIR`, or else `bouncing-spring`
in the user's cache folder. Anyone who can write to ROOT decides what code runs here, so it is created for
this user alone and refused if others own it or can write to it.

`python -m worker.kernel_cache` compiles every kernel into the default cache.
"""

import atexit
import functools
import hashlib
import logging
import os
import platform
import resource
import shutil
import time
from contextlib import ExitStack, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Final

from worker.ownership import PRIVATE_FOLDER, NotOurs, check_unshared, temporary_folder

log = logging.getLogger(__name__)

#: The folder of the project's packages.
_PACKAGES: Final = Path(__file__).parents[1]
_VARIABLE: Final = "NUMBA_CACHE_DIR"
_USED: Final = "used"
_OLD_SECONDS: Final = 14 * 24 * 3600
#: Least address space of a process with compiled kernels.
_LEAST_BYTES: Final = 1_000_000_000


class CacheRefused(Exception):
    """Other users could have written the compiled kernels; the text says where and what to do."""


@functools.cache
def use_cache() -> Path:
    """Make this process use the cache of compiled kernels, and return its folder.

    Raises CacheRefused, and MemoryError where LLVM would abort, or importing hang.
    """
    if 0 <= resource.getrlimit(resource.RLIMIT_AS)[0] < _LEAST_BYTES:
        raise MemoryError(f"compiled kernels need {_LEAST_BYTES:,} bytes of address space (ulimit -v)")
    folder = _cache_folder(default_root())
    from kernel.numerics import cache, jit  # noqa: PLC0415 - imports numba

    if not jit.PLAIN:
        cache.folder = folder
    return folder


def default_root() -> Path:
    """ROOT."""
    if configured := os.environ.get(_VARIABLE):
        return Path(configured)
    if caches := os.environ.get("XDG_CACHE_HOME"):
        return Path(caches, "bouncing-spring")
    try:
        return Path.home() / ".cache" / "bouncing-spring"
    except RuntimeError:  # in a container the user may have no entry in the password database
        return _temporary_root()


def _temporary_root() -> Path:
    """A folder for this process and those that it starts, which is removed when it ends."""
    folders = ExitStack()
    root = folders.enter_context(temporary_folder("bouncing-spring-"))
    atexit.register(folders.close)
    os.environ[_VARIABLE] = str(root)
    return root


def _cache_folder(root: Path) -> Path:
    """The folder of this kernel's cache in `root`, or in a temporary folder where that cannot be written."""
    compiler = platform.python_version(), platform.machine(), version("numba"), version("llvmlite")
    digest = digest_of("kernel", *compiler)
    try:
        check_unshared(root)
        folder = root / digest
        _make(folder)
        (folder / _USED).touch()  # records the last use
    except NotOurs as error:
        raise CacheRefused(
            f"the kernel cache {root} is not safe to use: {error}, so others could run code here; remove it, "
            f"and it is made anew for you alone, or set {_VARIABLE} to a folder of your own"
        ) from error
    except OSError:  # no home, a read-only disk
        log.warning("the kernel cache %s cannot be written: every start compiles its kernels anew", root)
        folder = _temporary_root() / digest
        _make(folder)
    else:
        _remove_old(root, keep=folder)
    return folder


def _make(folder: Path) -> None:
    """Create a folder and its missing parents, for this user alone."""
    if not folder.parent.exists():
        _make(folder.parent)
    folder.mkdir(PRIVATE_FOLDER, exist_ok=True)


def _remove_old(root: Path, keep: Path) -> None:
    """Remove the caches of other kernel sources unused for two weeks."""
    for used in root.glob(f"*/{_USED}"):
        with suppress(OSError):  # another process may remove it
            if used.parent != keep and time.time() - used.stat().st_mtime > _OLD_SECONDS:
                shutil.rmtree(used.parent, ignore_errors=True)


def digest_of(package: str, *more: str) -> str:
    """Digest of the contents of a package's sources, without their times, which differ between machines."""
    folder = _PACKAGES / package
    digest = hashlib.sha256(" ".join(more).encode())
    for source in sorted(folder.rglob("*.py")):
        content = source.read_bytes()
        digest.update(f"{source.relative_to(folder)} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:16]


if __name__ == "__main__":
    use_cache()
    from worker.work import compile_kernels  # loads every library that computes

    compile_kernels()
