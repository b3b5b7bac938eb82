"""The folder of compiled kernels, and the kernels that are being compiled; without numba."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple


class Compilation(NamedTuple):
    """An entry that this process compiles, or that it waits for while another process compiles it."""

    kernel: str  # its contact model, such as "rigid kernel"
    began: float  # time.time()

    @property
    def seconds(self) -> float:
        """Seconds so far; the clock of the machine that compiles may be ahead."""
        return max(time.time() - self.began, 0.0)


#: Where entries are kept; None: nowhere.
_folder: Path | None = None

#: The compilations of this process, by thread.
_under_way: dict[int, Compilation] = {}


def set_cache(folder: Path | None) -> None:
    """Keep compiled entries in this folder, which must exist; anyone who writes to it decides what runs."""
    global _folder  # noqa: PLW0603 - one cache for all kernels of a process
    _folder = folder


def cache_folder() -> Path | None:
    """The folder of `set_cache`."""
    return _folder


def compilations() -> list[Compilation]:
    """The compilations of this process now; empty where plain `numba.njit` compiles."""
    return list(_under_way.values())


@contextmanager
def compiling(kernel: str) -> Iterator[None]:
    """List this kernel in `compilations` during the block."""
    thread = threading.get_ident()
    _under_way[thread] = Compilation(kernel, time.time())
    try:
        yield
    finally:
        del _under_way[thread]
