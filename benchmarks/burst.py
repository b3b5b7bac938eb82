"""What a burst of costly requests leaves to jobs, polls and memory, and when it is answered.

    python -m benchmarks.burst [--requests 200] [--clients 8] [--cells 100000] [--seconds 20]
    python -m benchmarks.burst --small-only [--costly 200] [--cells 100000]

Runs `bounce serve` with two workers. The jobs' throughput alone, before and after, and while `clients`
connections send `requests` costly GETs in all: pictures, tables, lines, maps, files, thresholds, chunks of
the store, of a sweep of `cells` cells; who is told to come again does. The clients stand for other machines,
so their threads run at the lowest priority. Then twenty diagrams of a million flights at once, and a hundred
answers that nobody reads. At last the diagram of a finished job of 60 cells, read again and again: beside an
atlas that two workers compute, and beside that and `costly` costly requests at once. Exits with 1 if a
promise is broken: the service takes 1.5 GB or more, the 99th percentile of polls or of these small reads is
250 ms or more, one of them is refused, or jobs have less than 70% of their throughput alone.
"""

import argparse
import http.client
import itertools
import multiprocessing
import os
import socket
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import httpx2
import numpy as np

from benchmarks.measuring import describe, options
from benchmarks.serving import MB, TIMEOUT, Polls, Serving, sweep, used

MAX_MEMORY_MB = 1_500.0
MAX_P99 = 0.250
MIN_THROUGHPUT = 0.70

#: Jobs kept unfinished while throughput is measured; each is about a second of one core.
UNFINISHED = 6
KEEP = 20

#: Seconds for which a client that is told to come again does.
PATIENCE = 120.0
#: Of the threads that send costly requests: they stand for other machines.
CLIENTS_NICENESS = 19


def large(cells: int) -> dict[str, Any]:
    """A sweep of `cells` cells along Γ, of up to KEEP flights each."""
    return {
        "name": "large",
        "gamma": {"start": 1.0, "stop": 8.0, "num": cells},
        "omega": [0.5],
        "xi": 0.26,
        "model": {"kind": "rigid"},
        "settle": 20,
        "observe": 2 * KEEP,
        "keep": KEEP,
    }


def wide() -> dict[str, Any]:
    """A sweep over Γ and Ω, for maps and thresholds."""
    return {
        **large(300),
        "name": "wide",
        "omega": {"start": 0.3, "stop": 1.5, "num": 100},
        "protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"},
    }


def small() -> dict[str, Any]:
    """A sweep of 60 cells."""
    return {**large(60), "name": "small"}


def atlas() -> dict[str, Any]:
    """A sweep that takes two workers many minutes, in chunks of a second."""
    return {
        **large(1_000),
        "name": "atlas",
        "omega": {"start": 0.3, "stop": 1.5, "num": 320},
        "settle": 20_000,
    }


class Peak:
    """The most memory of the service with the processes of its answers, and file handles, during a block."""

    def __init__(self, service: Serving) -> None:
        self._service, self._over = service, threading.Event()
        self._thread = threading.Thread(target=self._sample)
        self.memory, self.handles = 0.0, 0

    def __enter__(self) -> "Peak":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _sample(self) -> None:
        while not self._over.wait(0.1):
            self.memory = max(self.memory, used(self._service))
            self.handles = max(self.handles, self._service.used()[1])


class Jobs:
    """Keeps UNFINISHED small jobs in the queue during a block, and counts the cells that are done."""

    def __init__(self, service: Serving) -> None:
        self._numbers, self._over = itertools.count(), threading.Event()
        self._thread = threading.Thread(target=self._feed)
        self._http = httpx2.Client(base_url=service.url, timeout=TIMEOUT)

    def __enter__(self) -> "Jobs":
        self._thread.start()
        while not self.cells():
            time.sleep(0.05)
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        while self._left():
            time.sleep(0.1)
        self._http.close()

    def cells(self) -> float:
        """Cells done of all jobs."""
        lines = self._http.get("/metrics").text.splitlines()
        return float(next(line.split()[1] for line in lines if line.startswith("bounce_cells_done")))

    def _left(self) -> int:
        states = ("queued", "running")
        return sum(self._http.get(f"/v1/jobs?state={state}&limit=1").json()["total"] for state in states)

    def _feed(self) -> None:
        while not self._over.wait(0.2):
            for _ in range(UNFINISHED - self._left()):
                self._http.post("/v1/jobs", json=sweep(next(self._numbers))).raise_for_status()


def costly(large_job: str, wide_job: str, every: int) -> list[str]:
    """One request of each kind; tables have a million flights."""
    chunks = "zarr/flight_time/c.0.0.0.0.0"
    return [
        f"{large_job}/diagram?format=png",
        f"{large_job}/diagram?every={every}",
        f"{large_job}/diagram?format=bin&every={every}",
        f"{large_job}/diagram?format=csv&every={10 * every}",
        f"{wide_job}/modes",
        f"{wide_job}/modes?min_flight=0.2&format=bin",
        f"{large_job}/diagram?format=bin&every={2 * every}",
        f"{large_job}/diagram?format=svg&every={every}",
        f"{large_job}/export?format=nc",
        f"{large_job}/export?format=parquet",
        f"{wide_job}/threshold",
        f"{wide_job}/threshold?tolerance=1e-4",
        f"{large_job}/{chunks}",
        f"{wide_job}/diagram?omega=0.5&format=png",
        f"{wide_job}/trajectory?gamma=2&omega=0.5",
    ]


def _yield_to_others() -> None:
    """Lower the priority of this thread, where threads have their own."""
    if sys.platform == "linux":
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), CLIENTS_NICENESS)


class Burst:
    """Costly requests, `clients` at a time: how each ended, how often it was told to wait, how long it took.

    Who is told to come again does, after the time that the answer names, for PATIENCE seconds. Bodies are
    read and dropped: a client library would use more processor time than the service. The clients' threads
    have the niceness CLIENTS_NICENESS.
    """

    def __init__(self, port: int, paths: list[str], requests: int, clients: int) -> None:
        self._port, self._paths, self._requests = port, paths, requests
        self._numbers, self._lock = itertools.count(), threading.Lock()
        self.statuses, self.refusals = Counter[int](), 0
        self.seconds: list[float] = []
        with ThreadPoolExecutor(clients, initializer=_yield_to_others) as pool:
            list(pool.map(self._client, range(clients)))

    def _client(self, _: int) -> None:
        while True:
            with self._lock:
                number = next(self._numbers)
            if number >= self._requests:
                return
            self._request(self._paths[number % len(self._paths)])

    def _request(self, path: str) -> None:
        began = time.perf_counter()
        while True:
            status, pause = self._try(path)
            took = time.perf_counter() - began
            if status != 429 or took > PATIENCE:
                break
            with self._lock:
                self.refusals += 1
            time.sleep(pause)
        with self._lock:
            self.statuses[status] += 1
            self.seconds.append(took)

    def _try(self, path: str) -> tuple[int, float]:
        """The status of an answer, and the seconds after which to come again."""
        with closing(http.client.HTTPConnection("127.0.0.1", self._port, timeout=600)) as connection:
            connection.request("GET", path)
            answer = connection.getresponse()
            while answer.read(MB):
                pass
            return answer.status, float(answer.headers.get("Retry-After", 0.0))

    def __str__(self) -> str:
        median, late = np.percentile(self.seconds, (50, 95))
        ends = ", ".join(f"{count} x {status}" for status, count in sorted(self.statuses.items()))
        return (
            f"{ends}; answered after {median:.1f} s (median), {late:.1f} s (95%), {max(self.seconds):.1f} s "
            f"(longest); told to come again {self.refusals} times"
        )


@contextmanager
def unread(port: int, path: str, count: int) -> Iterator[None]:
    """So many connections that ask and do not read, during the block."""
    with ExitStack() as connections:
        for _ in range(count):
            connection = connections.enter_context(socket.create_connection(("127.0.0.1", port)))
            connection.sendall(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
        yield


def rate(jobs: Jobs, work: Callable[[], Any]) -> tuple[float, Any]:
    """Cells done per second while `work` runs, and its result."""
    before, began = jobs.cells(), time.perf_counter()
    result = work()
    return (jobs.cells() - before) / (time.perf_counter() - began), result


class Report:
    """Prints figures and remembers broken promises."""

    def __init__(self, service: Serving, path: str) -> None:
        self._service, self._path, self.broken = service, path, False

    def phase(self, what: str, work: Callable[[], Any]) -> Any:
        """Do some work beside polls; one line about polls and memory."""
        with Peak(self._service) as peak:
            result = self.beside(what, self._path, work, connections=8, pause=0.25)
        print(
            f"    at most {peak.memory:.0f} MB and {peak.handles} handles, then {used(self._service):.0f} MB",
            flush=True,
        )
        self.broken |= peak.memory >= MAX_MEMORY_MB
        return result

    def beside(
        self, what: str, path: str, work: Callable[[], Any], connections: int = 4, pause: float = 0.1
    ) -> Any:
        """Do some work beside reads of a path; one line about these."""
        began = time.perf_counter()
        with Polls(self._service.port, path, connections, pause) as polls:
            result = work()
        took = time.perf_counter() - began
        p50, p99 = np.percentile(polls.seconds, (50, 99))
        print(
            f"{what}: {took:.0f} s, {len(polls.seconds)} reads, median {1e3 * p50:.0f} ms, p99 "
            f"{1e3 * p99:.0f} ms, longest {1e3 * max(polls.seconds):.0f} ms, {len(polls.wrong)} refused "
            f"{polls.wrong[:3]}; load {os.getloadavg()[0]:.1f}",
            flush=True,
        )
        self.broken |= p99 >= MAX_P99 or bool(polls.wrong)
        return result


def _in_a_process(port: int, paths: list[str], costly: int) -> str:
    """A burst of this many requests at once; its threads would make those that measure wait for Python."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_burst, port, paths, costly).result()


def _burst(port: int, paths: list[str], costly: int) -> str:
    return str(Burst(port, paths, costly, costly))


def measure_small(service: Serving, report: Report, paths: list[str], arguments: argparse.Namespace) -> None:
    """Small reads beside an atlas, and beside costly requests as well."""
    here = service.submit(small())
    service.wait(here)
    running = service.submit(atlas())
    while not service.cells_done(running):
        time.sleep(0.1)
    diagram = f"{here}/diagram"
    report.beside("beside an atlas", diagram, lambda: time.sleep(arguments.seconds))
    burst = report.beside(
        f"beside an atlas and {arguments.costly} costly requests at once",
        diagram,
        lambda: _in_a_process(service.port, paths, arguments.costly),
    )
    print(f"    {burst}")
    service.cancel(running)


def measure(service: Serving, arguments: argparse.Namespace) -> bool:
    """Print the figures; whether a promise is broken."""
    large_job, wide_job = service.submit(large(arguments.cells)), service.submit(wide())
    service.wait(large_job)
    service.wait(wide_job)
    paths = costly(large_job, wide_job, -(-arguments.cells * KEEP // 1_000_000))
    report = Report(service, large_job)
    if arguments.small_only:
        measure_small(service, report, paths, arguments)
        return report.broken

    def requests() -> Burst:
        return Burst(service.port, paths, arguments.requests, arguments.clients)

    def lines() -> None:
        with unread(service.port, paths[6], 100):
            time.sleep(arguments.seconds)

    print(f"idle: {used(service):.0f} MB", flush=True)
    with Jobs(service) as jobs:

        def undisturbed() -> float:
            cells: float
            cells, _ = report.phase("jobs alone", lambda: rate(jobs, lambda: time.sleep(arguments.seconds)))
            return cells

        before = undisturbed()
        who = f"{arguments.clients} clients of niceness {CLIENTS_NICENESS}"
        what = f"{arguments.requests} GETs by {who} beside jobs"
        beside, burst = report.phase(what, lambda: rate(jobs, requests))
        alone = (before + undisturbed()) / 2.0  # the machine's speed changes meanwhile
    print(f"    {burst}")
    print(f"jobs: {alone:.0f} cells/s alone, {beside:.0f} beside the burst: {beside / alone:.0%}", flush=True)
    report.broken |= beside < MIN_THROUGHPUT * alone
    burst = report.phase(
        "20 JSON diagrams of a million flights at once", lambda: Burst(service.port, paths[1:2], 20, 20)
    )
    print(f"    {burst}")
    report.phase("100 lines that nobody reads", lines)
    measure_small(service, report, paths, arguments)
    return report.broken


def main() -> int:
    """Print the figures."""
    arguments = options(
        __doc__, requests=200, clients=8, cells=100_000, seconds=20.0, costly=200, small_only=False
    )
    print(describe("fastapi", "uvicorn", "matplotlib"))
    with tempfile.TemporaryDirectory() as folder, Serving(Path(folder)) as service:
        return int(measure(service, arguments))


if __name__ == "__main__":
    sys.exit(main())
