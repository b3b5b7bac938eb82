"""Processes that compute answers at a lower priority, beside a service that goes on answering requests.

In the service's own process an answer that takes a second of Python would delay every other request, because
one thread runs at a time, and it would take as much of the processors as a worker.
"""

import ctypes
import multiprocessing
import os
import pickle
import queue
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, Final, Protocol, TypeVar

from service.errors import NotComputed
from worker.kernel_cache import claim_cache

Result = TypeVar("Result")

#: Added to the niceness of these processes: two of them take a fifth of two busy processors.
NICER: Final = 6


class Background(Protocol):
    """Where answers are computed. May be used from any thread."""

    def run(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """`function(*arguments)`, all of which can be pickled. Raises what it raises, and NotComputed."""

    def close(self) -> None:
        """End what is being computed."""


class InThisProcess:
    """Computes in the thread of the caller: for tests, and for services of a single user."""

    def run(self, function: Callable[..., Result], *arguments: Any) -> Result:
        return function(*arguments)

    def close(self) -> None: ...


class Processes:
    """At most `count` processes, each started when all others are busy; they end with this process."""

    def __init__(self, count: int) -> None:
        self._idle: queue.LifoQueue[_Process | None] = queue.LifoQueue()  # None: one may be started
        self._started: set[_Process] = set()
        for _ in range(count):
            self._idle.put(None)

    def run(self, function: Callable[..., Result], *arguments: Any) -> Result:
        process = self._idle.get()
        try:
            if process is None:
                process = _Process()
                self._started.add(process)
            succeeded, value = process.call(function, arguments)
        except (EOFError, OSError) as error:
            if process is not None:
                self._started.discard(process)
                process.end()
                process = None
            raise NotComputed("the process that computed the answer has died: repeat the request") from error
        finally:
            self._idle.put(process)
        if not succeeded:
            raise value
        result: Result = value
        return result

    def close(self) -> None:
        for process in list(self._started):
            process.end()


class _Process:
    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_compute, args=(theirs,), name="bounce-answers", daemon=True)
        self._process.start()
        theirs.close()  # so that either side notices when the other dies

    def call(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[bool, Any]:
        """Whether it succeeded, and the result or the exception. Raises EOFError or OSError if it died."""
        self._connection.send((function, arguments))
        answer: tuple[bool, Any] = self._connection.recv()
        return answer

    def end(self) -> None:
        self._process.terminate()
        self._connection.close()


def _compute(connection: Connection) -> None:
    """Compute what comes until the service ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the service
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.nice(NICER)
    claim_cache()  # before anything imports a kernel
    while True:
        try:
            function, arguments = connection.recv()
        except (EOFError, OSError):
            return
        try:
            answer = (True, function(*arguments))
        except Exception as error:  # noqa: BLE001 - raised again where it was called
            answer = (False, error)
        try:
            connection.send(answer)
        except (TypeError, AttributeError, pickle.PicklingError):
            connection.send((False, RuntimeError(f"cannot be sent: {answer[1]!r}")))
        del function, arguments, answer
        return_memory()


def return_memory() -> None:
    """Give what the C library keeps for later allocations back to the system, where it can."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
