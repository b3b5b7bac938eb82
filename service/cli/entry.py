"""The program `bounce`, which signals end at any moment.

SIGINT, SIGTERM and SIGHUP mean exit code 128 + the signal and no traceback, also while modules are imported,
kernels compiled and workers started. A command that takes long to end is killed: files on the disk are
whole at any moment. `bounce serve` handles SIGINT and SIGTERM itself.
"""

import logging
import multiprocessing
import os
import signal
import sys
import threading
from contextlib import suppress
from functools import partial
from io import TextIOWrapper
from types import FrameType
from typing import Final

from worker.ownership import remove_temporary_folders

_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
#: Seconds that a command may take to end orderly after a signal.
GRACE_SECONDS: Final = 1.2


def main() -> None:
    """Run the command that the arguments name."""
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # ignored under nohup and in a script's background
            signal.signal(number, _end)
    if isinstance(sys.stdout, TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")  # for letters that the encoding lacks
    code: object = None
    try:
        from service.cli.main import main as command

        command()
    except SystemExit as end:
        code = end.code
        raise
    finally:
        # The interpreter would wait for threads at its end, and free compiled code.
        if isinstance(ending := signal.getsignal(signal.SIGTERM), partial):
            ending()
        if isinstance(code, int):
            _end_now(code)


def _end(number: int, frame: FrameType | None) -> None:
    """Raise SystemExit in the main thread; another signal or time ends the process at once."""
    end_now = partial(_end_now, 128 + number)
    for other in _SIGNALS:
        signal.signal(other, end_now)
    sys.unraisablehook = end_now  # Python would only print a SystemExit that interrupts a finalizer
    logging.disable()  # what libraries say of connections that end
    timer = threading.Timer(GRACE_SECONDS, end_now)
    timer.daemon = True
    timer.start()
    if number == signal.SIGINT:
        with suppress(OSError):
            os.write(2, b"\n")  # after ^C
    sys.exit(128 + number)


def _end_now(code: int, *_: object) -> None:
    """End this process with all that it has started, and remove its temporary folders."""
    for process in multiprocessing.active_children():
        process.kill()
    remove_temporary_folders()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # nobody reads it
            stream.flush()
    _remove_semaphores()
    os._exit(code)


def _remove_semaphores() -> None:
    """Remove the semaphores that this process shares with those that it has started.

    `os._exit` runs no finalizers, and multiprocessing's tracker would remove the semaphores with a warning on
    the terminal. Other finalizers may wait for threads: they are not run.
    """
    if "multiprocessing.synchronize" not in sys.modules:  # nothing was shared
        return
    from multiprocessing import synchronize, util

    remove = synchronize.SemLock._cleanup  # type: ignore[attr-defined]
    for finalizer in list(util._finalizer_registry.values()):  # type: ignore[attr-defined]
        if finalizer._callback is remove:
            with suppress(Exception):  # another thread has removed it
                finalizer()


if __name__ == "__main__":
    main()
