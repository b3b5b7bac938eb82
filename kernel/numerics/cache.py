"""The folder of compiled kernels, and the kernels that are being compiled; without numba."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple

#: Seconds that kernels take, until this process has compiled one (docs/performance.md).
USUAL: Final = {"rigid kernel": 14.0, "soft kernel": 17.0}
OTHERS: Final = 10.0
LOADED: Final = 2.0  # a kernel that took less was in the cache


class Compilation(NamedTuple):
    """An entry that this process compiles, or that it waits for while another process compiles it."""

    kernel: str  # its contact model, such as "rigid kernel"
    began: float  # time.time()
    usual: float  # seconds that it took the last time, or usually takes

    @property
    def seconds(self) -> float:
        """Seconds so far; the clock of the machine that compiles may be ahead."""
        return max(time.time() - self.began, 0.0)


#: The folder, which must exist, of compiled entries; None: none are kept. Who writes to it decides what runs.
folder: Path | None = None

#: The compilations of this process, by thread, and the seconds that kernels took.
_under_way: dict[int, Compilation] = {}
_took: dict[str, float] = {}


def compilations() -> list[Compilation]:
    """The compilations of this process now; empty where plain `numba.njit` compiles."""
    return list(_under_way.values())


@contextmanager
def compiling(kernel: str) -> Iterator[None]:
    """List this kernel in `compilations` during the block."""
    thread = threading.get_ident()
    usual = _took.get(kernel, USUAL.get(kernel, OTHERS))
    _under_way[thread] = Compilation(kernel, time.time(), usual)
    try:
        yield
        if (took := _under_way[thread].seconds) > LOADED:
            _took[kernel] = took
    finally:
        del _under_way[thread]
