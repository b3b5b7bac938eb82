"""Executors that a test controls, which compute with the real task; sweeps for them; waiting."""

import random
import socket
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from typing import Any

import pytest
from studies import spec_of

from worker.executors.base import ClusterState, Executor
from worker.executors.inline import Inline
from worker.studies import run_task
from worker.study import Chunk, ChunkOptions, ChunkReport
from worker.study.chunks import USUAL
from worker.sweep import SweepSpec
from worker.sweep.task import run_chunk

#: Seconds within which anything must happen, on an overloaded machine.
DEADLINE = 240.0


#: The errors that each chunk raises before it is computed, one per try.
Script = dict[int, list[Exception]]


class Scripted(Inline):
    """Computes like Inline, but first raises the errors that the script has for a chunk, one per try."""

    def __init__(self, script: Script | None = None) -> None:
        super().__init__()
        self.script = defaultdict(list, {chunk: list(errors) for chunk, errors in (script or {}).items()})
        self.tried: list[int] = []
        self.before: Callable[[], object] = lambda: None  # runs before each chunk

    def submit(self, spec: SweepSpec, chunk: Chunk, store_url: str, *_: Any) -> "Future[ChunkReport]":
        return self._threads.submit(self._run, spec, chunk, store_url)

    def _run(self, spec: SweepSpec, chunk: Chunk, store_url: str) -> ChunkReport:
        self.tried.append(chunk.index)
        self.before()
        if self.script[chunk.index]:
            raise self.script[chunk.index].pop(0)
        if isinstance(spec, SweepSpec) and not spec.fills_in:
            return run_chunk(spec, chunk, store_url)  # in one piece
        return run_task(spec, chunk, store_url)


class Held:
    """Keeps chunks until the test has them computed; reports `capacity` workers."""

    def __init__(self, capacity: int = 2) -> None:
        self.capacity = capacity
        self.lock = threading.Lock()
        self.chunks: list[tuple[Future[ChunkReport], SweepSpec, Chunk, str]] = []
        self.priorities: dict[int, float] = {}  # by the future's id
        self.order: list[tuple[str, int]] = []  # the spec's name and the chunk, as submitted

    def submit(
        self, spec: SweepSpec, chunk: Chunk, store_url: str, options: ChunkOptions = USUAL
    ) -> "Future[ChunkReport]":
        future: Future[ChunkReport] = Future()
        self.priorities[id(future)] = options.priority
        with self.lock:
            self.chunks.append((future, spec, chunk, store_url))
            self.order.append((spec.name, chunk.index))
        return future

    def call(self, *_: Any) -> "Future[Any]":
        """A call that is never computed."""
        return Future()

    def state(self) -> ClusterState:
        return ClusterState(self.capacity > 0, self.capacity)

    def compiling(self, store_url: str) -> None:
        return None

    def ask_for(self, seconds: float, tasks: int) -> None:
        self.asked = (seconds, tasks)

    def close(self) -> None: ...

    def held(self, name: str | None = None) -> int:
        with self.lock:
            return sum(name in (None, spec.name) for _, spec, _, _ in self.chunks)

    def let_go_first(self) -> None:
        """Compute the chunk with the highest priority, if there is one."""
        with self.lock:
            self.chunks.sort(key=lambda chunk: -self.priorities[id(chunk[0])])
        if self.chunks:
            self.let_go()

    def let_go(self) -> None:
        """Compute the chunk that was submitted first."""
        with self.lock:
            future, *task = self.chunks.pop(0)
        if not future.set_running_or_notify_cancel():
            return
        try:
            future.set_result(run_chunk(*task))
        except Exception as error:  # noqa: BLE001 - as an executor does
            future.set_exception(error)

    def let_go_all(self) -> None:
        """Compute the chunks held now, and those submitted meanwhile."""
        while self.held():
            self.let_go()

    def let_go_until(self, condition: Callable[[], bool]) -> None:
        """Compute chunks as they are submitted until the condition holds."""

        def holds() -> bool:
            if condition():
                return True
            if self.held():
                self.let_go()
            return False

        wait_for(holds)


class Counting:
    """An executor that records the chunks submitted to it, and the sweeps of those computed, in order."""

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self.chunks: list[int] = []
        self.ended: list[str] = []

    @property
    def submitted(self) -> int:
        return len(self.chunks)

    def submit(self, spec: SweepSpec, chunk: Chunk, url: str, *options: Any) -> "Future[ChunkReport]":
        future = self._executor.submit(spec, chunk, url, *options)
        self.chunks.append(chunk.index)
        future.add_done_callback(
            lambda done: done.cancelled() or done.exception() or self.ended.append(spec.name)
        )
        return future

    def __getattr__(self, name: str) -> Any:
        return getattr(self._executor, name)


class Few(Counting):
    """Has the first `most` chunks computed; the others wait until they are given back."""

    def __init__(self, executor: Executor, most: int) -> None:
        super().__init__(executor)
        self.most = most
        self._kept: list[Future[ChunkReport]] = []

    def submit(self, spec: SweepSpec, chunk: Chunk, url: str, *options: Any) -> "Future[ChunkReport]":
        if len({*self.chunks, chunk.index}) <= self.most:
            return super().submit(spec, chunk, url, *options)
        self._kept.append(kept := Future())
        return kept

    def give_back(self) -> None:
        while self._kept:
            self._kept.pop().cancel()


def wait_for(
    condition: Callable[[], bool],
    describe: Callable[[], str] = lambda: "the condition never held",
    seconds: float = DEADLINE,
) -> None:
    """Ask until the condition holds; the longer it takes the less often, as asking takes processor time.

    It does not hold while a file that it reads is missing, or is removed as it is read.
    """
    began = time.monotonic()
    while True:
        with suppress(FileNotFoundError):
            if condition():
                return
        waited = time.monotonic() - began
        assert waited < seconds, describe()
        time.sleep(min(max(0.005, 0.1 * waited), 0.05))


@contextmanager
def hanging(
    patch: pytest.MonkeyPatch, owner: Any, name: str
) -> Iterator[tuple[threading.Event, threading.Event]]:
    """A function of `owner` waits in this block: when it is reached, and what lets it go on."""
    reached, go_on, real = threading.Event(), threading.Event(), getattr(owner, name)

    def wait(*given: Any) -> Any:
        reached.set()
        assert go_on.wait(DEADLINE)
        return real(*given)

    patch.setattr(owner, name, wait)
    try:
        yield reached, go_on
    finally:
        go_on.set()


#: UDP's ports of the numbers that this process has taken: no other test gets the same.
_taken: list[socket.socket] = []


def free_port() -> int:
    """A port for a server to listen on later, outside the range from which connections get theirs."""
    for port in random.sample(range(20_000, 32_000), 100):
        mark = socket.socket(type=socket.SOCK_DGRAM)
        try:
            mark.bind(("127.0.0.1", port))
            with socket.socket() as probe:
                probe.bind(("127.0.0.1", port))
        except OSError:
            mark.close()
            continue
        _taken.append(mark)
        return port
    raise AssertionError("no free port")


def small(**changes: Any) -> SweepSpec:
    """A sweep of 2 x 3 x 10 cheap cells (xi, omega, gamma), with these fields changed."""
    fields = spec_of((0.5, 5.0, 10), [0.5, 0.7, 1.0], [0.05, 0.26], window=(20, 20, 8))
    return SweepSpec(**(fields | changes))


#: 2 x 46 cells along gamma, from rest through the mode (1, 1) and beyond; as JSON, to submit.
TWO_LINES = spec_of((0.5, 5.0, 46), [0.5, 0.7], 0.26, window=(20, 20, 8))


def sweep(name: str = "", **changes: Any) -> SweepSpec:
    """A sweep of 60 cells at or near rest, in eight chunks whatever the cost table says."""
    # with exponents cells are computed one by one, and not a vector of them at once
    fields = spec_of((0.5, 1.2, 60), 0.5, 0.26, name=name, exponents=1, window=(1500, 10, 4))
    fields |= {"model": {"kind": "soft"}}
    return SweepSpec(**(fields | changes))


def costing(name: str = "", chunks: int = 8, seconds: float = 0.06, **changes: Any) -> SweepSpec:
    """A sweep of `chunks` chunks of about `seconds` core-seconds each, by the cost table."""
    cell = 0.01
    cells, settle = max(round(chunks * seconds / cell), 1), round(cell / 0.4e-6)
    fields = spec_of((0.5, 1.2, cells), 0.5, 0.26, name=name, window=(settle, 10, 4))
    return SweepSpec(**(fields | changes))
