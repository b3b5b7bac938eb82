"""Compiles every kernel into the cache, for the image and beside an idle worker.

python -m worker.precompile
"""

import fcntl
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Final

from worker.kernel_cache import use_cache

_BESIDE: Final = "--beside-a-worker"
_LOCK: Final = "precompiling"
_NICENESS: Final = 19


class Precompiling:
    """A process of the lowest priority that compiles every kernel until `stop` or until this process ends."""

    def __init__(self, root: str | None) -> None:
        command = [sys.executable, "-m", "worker.precompile", _BESIDE, *([root] if root else [])]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )

    def stop(self) -> None:
        """End the process; finished kernels stay in the cache."""
        self._process.kill()
        self._process.communicate()


def main(arguments: list[str]) -> None:
    """Compile the kernels that the cache lacks."""
    beside = _BESIDE in arguments
    roots = [argument for argument in arguments if argument != _BESIDE]
    if beside:
        os.nice(_NICENESS)
        threading.Thread(target=_end_with_parent, daemon=True).start()
    folder = use_cache(roots[0] if roots else None)
    if not beside:
        _compile()
        return
    with (Path(folder) / _LOCK).open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:  # another worker is compiling
            return
        _compile()


def _compile() -> None:
    from worker.tasks import compile_kernels  # noqa: PLC0415 - loads every library that computes

    compile_kernels()


def _end_with_parent() -> None:
    os.read(0, 1)  # returns when the pipe is closed; sys.stdin would abort the exit
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1:])
