"""Processes that compute answers at a lower priority, so that the service keeps answering requests."""

import ctypes
import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable
from contextvars import ContextVar
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final, TypeVar

from kernel.numerics.cache import compilations
from service.errors import NotComputed
from worker.kernel_cache import use_cache

Result = TypeVar("Result")

#: Added to the niceness of these processes: two of them take at most a quarter of two busy processors.
NICER: Final = 9
#: A process that has grown by more bytes than this since its start ends after an answer, to return its
#: memory. What answers of all kinds import takes 140 MB of it, and a new process seconds of a processor.
MOST_GROWN: Final = 192 * 2**20
#: Growth in bytes after which a process has the C library return memory.
MUCH: Final = 16 * 2**20
#: Seconds without work after which all processes but one end.
IDLE_SECONDS: Final = 5.0
#: Seconds in which a process that should end may compile; one that is frozen is killed then.
STOP_SECONDS: Final = 60.0


def _do_nothing() -> None: ...


class Asker:
    """The client of an answer, by its connection. When it leaves, the computation for it ends."""

    def __init__(self, connection: object = None) -> None:
        self._lock = threading.Lock()
        self._stop: Callable[[], None] = _do_nothing
        self.connection, self.left = connection, False

    def run(self, work: Callable[[], Result]) -> Result:
        """Run `work`; all answers that it gets from `Processes` are for this client."""
        token = _ASKER.set(self)
        try:
            return work()
        finally:
            _ASKER.reset(token)

    def leave(self) -> None:
        """End the current computation. No other begins."""
        with self._lock:
            self.left = True
            self._stop()

    def on_leave(self, stop: Callable[[], None]) -> None:
        """Set the function to call when the client leaves; calls it at once if the client has left."""
        with self._lock:
            self._stop = stop
            if self.left:
                stop()


_ASKER: Final[ContextVar[Asker | None]] = ContextVar("asker", default=None)


def asker() -> Asker:
    """The client for which this thread computes; outside of `Asker.run` one that never leaves."""
    return _ASKER.get() or Asker()


class InThisProcess:
    """Computes in the caller's thread, for tests and for a single user."""

    def run(self, function: Callable[..., Result], *arguments: Any) -> Result:
        return function(*arguments)


class Processes:
    """At most `count` processes, each started when all others are busy; they end with this process.

    A process ends if it has grown by more than MOST_GROWN bytes after an answer. After IDLE_SECONDS without
    work all but one end: the next answer need not wait for a process to start.

    warm: called in each process before its priority is lowered, to import what answers need. One process
    starts at a time: an answer may find another one idle before its own would have started.
    """

    def __init__(self, count: int, warm: Callable[[], object] = _do_nothing) -> None:
        self._changed = threading.Condition()
        self._most, self._starting, self._warm = count, False, warm
        self._failure: BaseException | None = None  # of the latest start
        self._idle: list[tuple[float, _Process]] = []  # idle since, the latest last
        self._started: set[_Process] = set()
        self._look: threading.Timer | None = None
        self._closed = False

    def start(self) -> None:
        """Start a process, before an answer needs it, unless there is one."""
        with self._changed:
            if not (self._started or self._closed):
                self._start_another()

    def run(self, function: Callable[..., Result], *arguments: Any) -> Result:
        process: _Process | None = None
        keep, client = False, asker()
        try:
            process = self._take()
            if client.left:  # while it started: the next answer needs it
                keep = True
                raise NotComputed("the client has left")
            client.on_leave(process.stop)
            succeeded, value, may_stay = process.call(function, arguments)
            client.on_leave(_do_nothing)
            if client.left:
                raise EOFError("it was stopped")
            keep = may_stay
        except (EOFError, OSError) as error:
            raise NotComputed("the process that computed the answer has died: repeat the request") from error
        finally:  # an answer that cannot be unpickled ends it, too: the pipe may hold the rest
            if process is not None:
                self._put_back(process, keep)
            if client.left:
                self.start()  # the next client need not wait for it
        if not succeeded:
            raise value
        result: Result = value
        return result

    def close(self) -> None:
        with self._changed:
            self._closed = True
            processes = list(self._started)
            self._changed.notify_all()
        for process in processes:
            process.end()

    def _take(self) -> "_Process":
        """An idle process, or a new one if that comes first. Raises EOFError or OSError if none starts."""
        with self._changed:
            while not self._closed:
                while self._idle:
                    _, idle = self._idle.pop()
                    if idle.is_alive():
                        return idle
                    idle.end()
                    self._started -= {idle}
                if len(self._started) < self._most:
                    self._start_another()
                self._changed.wait()
                if self._failure is not None and not self._idle:
                    failure, self._failure = self._failure, None  # of one answer: others start another
                    raise failure
        raise OSError("closed")

    def _start_another(self) -> None:
        if not self._starting:
            threading.Thread(target=self._begin, daemon=True).start()
            self._starting, self._failure = True, None

    def _begin(self) -> None:
        """Start a process for the answer that takes it first."""
        process = failure = None
        try:
            process = _Process()
            self._started.add(process)
            process.call(self._warm, ())
            self._put_back(process, keep=True)
        except BaseException as error:  # noqa: BLE001 - raised in a thread that waits for it
            failure = error
            if process is not None:
                self._end(process)
        with self._changed:
            self._starting, self._failure = False, failure
            self._changed.notify_all()  # another one may start now

    def _put_back(self, process: "_Process", keep: bool) -> None:
        """Free the process, or the place of one that is not to be kept."""
        with self._changed:
            if keep and not self._closed:
                self._idle.append((time.monotonic(), process))
                self._changed.notify()
                self._look_later()
                return
        self._end(process)

    def _look_later(self) -> None:
        """Look again when the next process has been idle for long; one timer at a time."""
        if self._look is None and len(self._idle) > 1:
            due = self._idle[0][0] + IDLE_SECONDS
            self._look = threading.Timer(max(due - time.monotonic(), 0.0), self._end_idle)
            self._look.daemon = True
            self._look.start()

    def _end_idle(self) -> None:
        """End the processes that have been idle for long, but not the one that was busy last."""
        with self._changed:
            self._look, until = None, time.monotonic() - IDLE_SECONDS
            long = [process for since, process in self._idle[:-1] if since <= until]
            self._idle = [(since, process) for since, process in self._idle if process not in long]
            self._look_later()
        for process in long:
            self._end(process)

    def _end(self, process: "_Process") -> None:
        process.end()
        with self._changed:
            self._started -= {process}
            self._changed.notify()


#: Computes answers: `run(function, *arguments)` raises the errors of the function, and NotComputed. May be
#: used from any thread. For processes the function and its arguments must be picklable.
Background = InThisProcess | Processes


class _Process:
    def __init__(self) -> None:
        self._ending = threading.Lock()
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_compute, args=(theirs,), name="bounce-answers", daemon=True)
        # Ctrl-C is for the service, SIGTERM for one thread of the process (`_end_when_told`): all its threads
        # inherit the signals that this thread blocks
        resource_tracker.ensure_running()  # starting it later would unblock Ctrl-C
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT, signal.SIGTERM])
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        theirs.close()  # so that each side notices the other's death

    def call(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[bool, Any, bool]:
        """Call a function: whether it succeeded, its result or exception, and whether to keep the process.

        Raises EOFError or OSError if the process died.
        """
        self._connection.send((function, arguments))
        succeeded, value = self._connection.recv()
        return succeeded, value, self._connection.recv()

    def is_alive(self) -> bool:
        return self._process.is_alive()

    def stop(self) -> None:
        """End the process soon, once no kernel compiles; a thread that waits in `call` notices."""
        self._process.terminate()
        later = threading.Timer(STOP_SECONDS, self._process.kill)
        later.daemon = True
        later.start()

    def end(self) -> None:
        with self._ending:  # two threads that close a connection may close another file
            self._process.kill()
            self._process.join()
            self._connection.close()


def _compute(connection: Connection) -> None:
    """Answer calls until the service ends."""
    threading.Thread(target=_end_when_told, daemon=True).start()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    use_cache()
    trimmed = at_start = 0
    while True:
        try:
            function, arguments = connection.recv()
        except (EOFError, OSError):
            os._exit(0)
        try:
            answer = (True, function(*arguments))
        except Exception as error:  # noqa: BLE001 - raised again in the caller
            answer = (False, error)
        try:
            connection.send(answer)
        except (TypeError, AttributeError, pickle.PicklingError):
            connection.send((False, RuntimeError(f"cannot be sent: {answer[1]!r}")))
        del function, arguments, answer
        held = _bytes_held()
        if held > trimmed + MUCH:
            return_memory()
            held = trimmed = _bytes_held()
        connection.send(not at_start or held <= at_start + MOST_GROWN)
        if not at_start:  # the first call imports, which beside busy workers would take a minute
            at_start = max(held, 1)
            _lower_priority()


def _lower_priority() -> None:
    os.nice(NICER)
    if hasattr(os, "SCHED_BATCH"):  # Linux: batch processes do not interrupt a running worker
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def _end_when_told() -> None:
    """End this process at SIGTERM, but store a kernel first: whoever repeats the request needs it too."""
    signal.sigwait({signal.SIGTERM})
    while compilations():
        time.sleep(0.05)
    os._exit(0)


def _end_with_parent() -> None:
    """End this process when the service has ended, at once, whatever it computes.

    On a busy machine a process of low priority would otherwise take many seconds to free its memory.
    """
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(0)


def _bytes_held() -> int:
    """Memory of this process in bytes; 0 if the system does not report it."""
    try:
        resident = Path("/proc/self/statm").read_text().split()[1]
    except OSError:
        return 0
    return int(resident) * os.sysconf("SC_PAGE_SIZE")


def return_memory() -> None:
    """Return the memory that the C library keeps for later allocations to the system, if possible."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
