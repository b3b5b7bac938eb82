"""Executors whose course a test decides, computing with the real task; a sweep for them; waiting."""

import random
import socket
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from worker import store
from worker.executors.inline import Inline
from worker.plan import Chunk
from worker.spec import SweepSpec
from worker.tasks import ChunkReport, run_chunk

#: Seconds for anything to happen, on a machine with far too much to do.
DEADLINE = 240.0


#: What happens to each chunk before it can be computed.
Script = dict[int, list[Exception]]


class Scripted(Inline):
    """Computes like Inline, but first raises what the script has for a chunk, one error a try."""

    def __init__(self, script: Script | None = None) -> None:
        super().__init__()
        self.script = defaultdict(list, {chunk: list(errors) for chunk, errors in (script or {}).items()})
        self.tried: list[int] = []

    def submit(self, spec: SweepSpec, chunk: Chunk, store_url: str, **_: float) -> "Future[ChunkReport]":
        return self._thread.submit(self._run, spec, chunk, store_url)

    def _run(self, spec: SweepSpec, chunk: Chunk, store_url: str) -> ChunkReport:
        self.tried.append(chunk.index)
        if self.script[chunk.index]:
            raise self.script[chunk.index].pop(0)
        return run_chunk(spec, chunk, store_url)


class Held:
    """Keeps chunks until the test lets them go; `capacity` workers."""

    def __init__(self, capacity: int = 2) -> None:
        self.capacity = capacity
        self.lock = threading.Lock()
        self.chunks: list[tuple[Future[ChunkReport], SweepSpec, Chunk, str]] = []
        self.priorities: dict[int, float] = {}  # by the future's id
        self.order: list[tuple[str, int]] = []  # the spec's name and the chunk, as submitted

    def submit(
        self, spec: SweepSpec, chunk: Chunk, store_url: str, *, priority: float = 0, **_: float
    ) -> "Future[ChunkReport]":
        future: Future[ChunkReport] = Future()
        self.priorities[id(future)] = priority
        with self.lock:
            self.chunks.append((future, spec, chunk, store_url))
            self.order.append((spec.name, chunk.index))
        return future

    def ready(self) -> bool:
        return self.capacity > 0

    def workers(self) -> int:
        return self.capacity

    def close(self) -> None: ...

    def held(self, name: str | None = None) -> int:
        with self.lock:
            return sum(name in (None, spec.name) for _, spec, _, _ in self.chunks)

    def let_go_first(self) -> None:
        """Compute the chunk of the highest priority, if there is one."""
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
        """Compute what is held now, and what comes meanwhile."""
        while self.held():
            self.let_go()

    def let_go_until(self, condition: Callable[[], bool]) -> None:
        """Compute whatever comes, chunk by chunk, until the condition holds."""

        def holds() -> bool:
            if condition():
                return True
            if self.held():
                self.let_go()
            return False

        wait_for(holds)

    def told_to_stop(self) -> bool:
        """Whether the sweeps of all chunks that are held bear the cancel mark."""
        with self.lock:
            urls = {url for *_, url in self.chunks}
        return all(store.is_cancelled(url) for url in urls)


def wait_for(
    condition: Callable[[], bool],
    told: Callable[[], str] = lambda: "it never came",
    seconds: float = DEADLINE,
) -> None:
    give_up = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < give_up, told()
        time.sleep(0.005)


def free_port() -> int:
    """A port for a server to come: none that the system gives to connections in the meantime."""
    for port in random.sample(range(20_000, 32_000), 100):
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise AssertionError("no port is free")


def small(**given: Any) -> SweepSpec:
    """2 x 3 x 10 cheap cells (xi, omega, gamma); any field can be given."""
    fields: dict[str, Any] = {
        "gamma": {"start": 0.5, "stop": 5.0, "num": 10},
        "omega": [0.5, 0.7, 1.0],
        "xi": [0.05, 0.26],
        "model": {"kind": "rigid"},
        "settle": 20,
        "observe": 20,
        "keep": 8,
    }
    return SweepSpec(**(fields | given))


#: 2 x 46 cells along gamma, with rest, a mode (1, 1) and what comes after it, as it is handed in.
TWO_LINES: dict[str, Any] = {
    "gamma": {"start": 0.5, "stop": 5.0, "num": 46},
    "omega": [0.5, 0.7],
    "xi": 0.26,
    "model": {"kind": "rigid"},
    "settle": 20,
    "observe": 20,
    "keep": 8,
}


def sweep(name: str = "", **given: Any) -> SweepSpec:
    """60 cells at rest or nearly so, in eight chunks: by any table of costs."""
    fields: dict[str, Any] = {
        "name": name,
        "gamma": {"start": 0.5, "stop": 1.2, "num": 60},
        "omega": 0.5,
        "xi": 0.26,
        "model": {"kind": "soft"},
        "settle": 1500,
        "observe": 10,
        "keep": 4,
    }
    return SweepSpec(**(fields | given))
