"""The program `bounce`: its commands, which Ctrl-C ends at any moment.

Ctrl-C means exit code 130 and no traceback, also while modules are imported, kernels compiled and workers
started. A command that is not at its end soon after is ended: results on the disk are whole at any moment.
"""

import logging
import multiprocessing
import os
import signal
import sys
import threading
from contextlib import suppress
from types import FrameType
from typing import Final

from worker.ownership import remove_temporary_folders

#: Seconds that a command may take to end orderly after Ctrl-C.
GRACE_SECONDS: Final = 1.2
#: The exit code of a command that Ctrl-C ended: 128 + SIGINT.
INTERRUPTED: Final = 130


def main() -> None:
    """Run the command that the arguments name."""
    interrupts = _Interrupts()
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as scripts start what runs beside them
        signal.signal(signal.SIGINT, interrupts.handle)
    code: object = None
    try:
        from service.cli.main import main as command

        command()
    except KeyboardInterrupt:
        code = INTERRUPTED
    except SystemExit as end:
        code = end.code
        raise
    finally:
        # The interpreter would wait for threads at its end, and free compiled code.
        if interrupts.came or code == INTERRUPTED:
            _end_now()


class _Interrupts:
    """What SIGINT does: the first one raises KeyboardInterrupt, the second one, or time, ends the process."""

    def __init__(self) -> None:
        self.came = False

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Called by Python in the main thread."""
        if self.came:
            _end_now()
        self.came = True
        logging.disable()  # what libraries say of connections that end
        timer = threading.Timer(GRACE_SECONDS, _end_now)
        timer.daemon = True
        timer.start()
        raise KeyboardInterrupt


def _end_now() -> None:
    """End this process with all that it has started, and remove its temporary folders."""
    for process in multiprocessing.active_children():
        process.kill()
    remove_temporary_folders()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # nobody reads it
            stream.flush()
    _remove_semaphores()
    os._exit(INTERRUPTED)


def _remove_semaphores() -> None:
    """Remove the semaphores that this process shares with those that it has started.

    A process that ends in this way runs no finalizers, and multiprocessing's tracker would remove what is
    left with a warning on the terminal. Other finalizers may wait for threads: they are not run.
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
