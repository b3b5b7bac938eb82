"""What a chunk costs beside its computation.

    python -m benchmarks.chunks [files] [s3] [rate] [--chunks 100000] [--workers 1000]

`files`: system calls per chunk, counted by strace, which must be there. `s3`: requests and round trips per
chunk in a bucket (moto, in a thread). Both compute chunks of a few cells, as a worker does.

`rate`: chunks per second of plan, ledger and supervisor, with a durable ledger (synchronous=FULL), on
simulated workers that report each chunk at once; and of Dask with two worker processes of this machine, empty
tasks, 64 in flight. The lower of the two rates limits a cluster.
"""

import math
import os
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from pathlib import Path
from socketserver import ThreadingMixIn
from typing import Any, NamedTuple
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

import httpx2
import psutil

from benchmarks.measuring import describe, options, short, table
from service.jobs.manager import JobManager
from service.ledger.ledger import Ledger
from service.ledger.model import JobState
from service.settings import Settings
from worker import store
from worker.executors.base import ClusterState
from worker.executors.dask import Dask
from worker.studies import run_task, study_of
from worker.study import Chunk, ChunkOptions, ChunkReport, Plan
from worker.study.chunks import TARGET_SECONDS, with_options
from worker.sweep import SweepSpec
from worker.sweep.plan import make_plan

SMALL: dict[str, Any] = {
    "gamma": {"start": 0.8, "stop": 5.0, "num": 64}, "omega": {"start": 0.4, "stop": 0.9, "num": 8},
    "xi": [0.05, 0.26], "model": {"kind": "rigid"}, "settle": 5, "observe": 5, "keep": 8,
}  # fmt: skip
RAMP = SMALL | {"protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"}}
SWEEPS = {"from rest": SMALL, "ramp": RAMP}

#: The system calls that are counted.
CALLS = ("fsync", "openat", "open", "mkdir", "rename", "unlink", "stat", "newfstatat", "getdents64")


def created(spec: SweepSpec, url: str) -> Plan:
    """The plan of a sweep in chunks of a few cells, its store created."""
    plan = make_plan(spec, chunk_shape=(1, 2, 16))
    store.create(url, study_of(spec).variables(spec, plan.chunk_shape))
    return plan


def compute(name: str, url: str, chunks: int) -> None:
    """Compute the first chunks of a sweep: what `files` traces."""
    spec = SweepSpec(**SWEEPS[name])
    with with_options(ChunkOptions(3600.0)):  # the first one compiles
        for chunk in list(created(spec, url))[:chunks]:
            run_task(spec, chunk, url)


def traced(name: str, chunks: int) -> Counter[str]:
    """System calls of a process that computes this many chunks, with the paths of its store alone."""
    with tempfile.TemporaryDirectory() as folder:
        log, url = f"{folder}/trace", f"{folder}/sweep.zarr"
        command = [
            sys.executable,
            "-c",
            f"from benchmarks.chunks import compute; compute({name!r}, {url!r}, {chunks})",
        ]
        # -y: with the paths of file descriptors, so that fsync names its file
        traced = ["strace", "-f", "-y", "-e", f"trace={','.join(CALLS)}", "-o", log, *command]
        subprocess.run(traced, check=True, capture_output=True, env={**os.environ, "NUMBA_NUM_THREADS": "1"})
        lines = [line for line in Path(log).read_text().splitlines() if "sweep.zarr" in line]
    calls = Counter[str]()
    for line in lines:
        if match := re.match(r"\d+ +(\w+)\(", line):
            calls[{"open": "openat", "newfstatat": "stat"}.get(match[1], match[1])] += 1
    return calls


def files() -> None:
    """Print system calls per chunk."""
    rows = []
    names = ("fsync", "openat", "mkdir", "rename", "unlink", "stat", "getdents64")
    for name in SWEEPS:
        few, many = traced(name, 2), traced(name, 18)
        rows.append([name, *(f"{(many[call] - few[call]) / 16:.1f}" for call in names)])
    print(table(["sweep", *names], rows))


class Counting:
    """Counts and delays the requests of a WSGI application."""

    def __init__(self, application: Any, seconds: float) -> None:
        self._application, self._seconds = application, seconds
        self.requests: list[str] = []

    def __call__(self, environ: dict[str, Any], start: Any) -> Any:
        """Answer one request."""
        self.requests.append(f"{environ['REQUEST_METHOD']} {environ['PATH_INFO'].rsplit('.zarr', 1)[-1]}")
        time.sleep(self._seconds)
        return self._application(environ, start)


class ThreadedServer(ThreadingMixIn, WSGIServer):
    """Answers each request in a thread of its own."""

    daemon_threads = True


class QuietHandler(WSGIRequestHandler):
    """Logs nothing."""

    def log_message(self, *_: Any) -> None:
        """Called for each request."""


@contextmanager
def bucket(seconds: float) -> Iterator[Counting]:
    """A bucket `results` whose requests take this many seconds each."""
    from moto.server import DomainDispatcherApplication, create_backend_app

    counting = Counting(DomainDispatcherApplication(create_backend_app), seconds)
    server = make_server("127.0.0.1", 0, counting, ThreadedServer, QuietHandler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    address = f"http://127.0.0.1:{server.server_port}"
    os.environ |= {
        "AWS_ENDPOINT_URL": address, "AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_REGION": "us-east-1", "AWS_ALLOW_HTTP": "true",
    }  # fmt: skip
    httpx2.put(f"{address}/results").raise_for_status()
    yield counting
    server.shutdown()


def s3() -> None:
    """Print requests and round trips per chunk."""
    latency, rows = 0.2, []
    with bucket(latency) as counting:
        for name, fields in SWEEPS.items():
            spec, url = SweepSpec(**fields), f"s3://results/{name.replace(' ', '-')}.zarr"
            plan = created(spec, url)
            with with_options(ChunkOptions(3600.0)):  # compiles
                run_task(spec, plan[0], url)
            counts, trips, kinds = [], [], Counter[str]()
            for chunk in list(plan)[1:9]:
                before, began = len(counting.requests), time.perf_counter()
                with with_options(ChunkOptions(begins=True)):
                    run_task(spec, chunk, url)
                trips.append((time.perf_counter() - began) / latency)
                made = counting.requests[before:]
                counts.append(len(made))
                kinds.update(request.split()[0] for request in made)
            each = ", ".join(f"{kind} {count / len(counts):.1f}" for kind, count in sorted(kinds.items()))
            rows.append([name, f"{statistics.mean(counts):.1f}", each, f"{statistics.median(trips):.1f}"])
    print(table(["sweep", "requests per chunk", "of these", f"time / latency of {latency:g} s"], rows))


class Simulated:
    """An executor of this many workers, which reports each chunk at once, in a thread."""

    def __init__(self, workers: int) -> None:
        self._workers, self._thread = workers, ThreadPoolExecutor(1)

    def submit(self, spec: SweepSpec, chunk: Chunk, store_url: str, *options: Any) -> "Future[ChunkReport]":
        """Report a chunk."""
        index, cells = chunk.index, chunk.cells
        return self.call(ChunkReport, index, cells, 1.0, 0.95, f"{index:064x}", (0, cells, 0, 0))

    def call(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """Call a function."""
        return self._thread.submit(function, *arguments)

    def state(self) -> ClusterState:
        """Always connected."""
        return ClusterState(connected=True, workers=self._workers)

    def ask_for(self, seconds: float, tasks: int) -> None:
        """The number of workers does not change."""

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown(cancel_futures=True)


def huge(chunks: int) -> SweepSpec:
    """A sweep of about this many chunks of the default shape."""
    grid = {"gamma": 1000, "omega": 1000, "xi": 2}
    axes = {"gamma": (0.5, 6.0), "omega": (0.1, 5.0), "xi": (0.02, 5.0)}

    def spec() -> SweepSpec:
        ranges = {n: {"start": a, "stop": b, "num": grid[n]} for n, (a, b) in axes.items()}
        return SweepSpec.model_validate(
            {**ranges, "model": {"kind": "rigid"}, "settle": 200, "observe": 100, "keep": 16}
        )

    grid["xi"] = max(2, math.ceil(chunks / len(make_plan(spec(), longest=TARGET_SECONDS)) * 2))
    return spec()


class Driven(NamedTuple):
    """Measurements of one job."""

    chunks: int
    wall: float  # s
    processor: float  # s
    memory: int  # growth, bytes
    files: int  # bytes of the ledger

    @property
    def rate(self) -> float:
        """Chunks per second."""
        return self.chunks / self.wall

    @property
    def ledger_bytes(self) -> float:
        """Bytes of the ledger per chunk."""
        return self.files / self.chunks


def drive(spec: SweepSpec, workers: int, folder: Path) -> Driven:
    """Run one job from submission to completion on simulated workers."""
    limits: dict[str, Any] = {"max_cells": 10**12, "max_bytes": 10**15, "max_core_seconds": 1e9}
    settings = Settings(data=folder, longest_chunk_seconds=TARGET_SECONDS, **limits)
    executor = Simulated(workers)
    memory = psutil.Process().memory_info
    before, peak = memory().rss, 0
    with Ledger(settings.ledger_path) as ledger:
        manager = JobManager(ledger, executor, settings)
        manager.start()
        wall, processor = time.perf_counter(), time.process_time()
        job = manager.submit(spec).job
        while job.state in (JobState.QUEUED, JobState.RUNNING):
            time.sleep(0.1)
            found = ledger.find(job.id)
            assert found is not None
            job, peak = found, max(peak, memory().rss)
        wall, processor = time.perf_counter() - wall, time.process_time() - processor
        manager.stop()
        executor.close()
        assert job.state is JobState.DONE, job.error
        files = sum(file.stat().st_size for file in folder.glob("ledger.*"))
    return Driven(job.chunks_done, wall, processor, peak - before, files)


def through_dask(tasks: int, in_flight: int = 64) -> float:
    """Tasks per second of the Dask executor with two worker processes and `in_flight` tasks in flight."""
    with closing(Dask(workers=2)) as executor:
        executor.call(abs, 0).result()
        start = time.perf_counter()
        waiting: deque[Future[int]] = deque()
        for number in range(tasks):
            if len(waiting) == in_flight:
                waiting.popleft().result()
            waiting.append(executor.call(abs, number))
        for future in waiting:
            future.result()
        return tasks / (time.perf_counter() - start)


def rate(chunks: int, workers: int) -> None:
    """Print both rates."""
    with tempfile.TemporaryDirectory() as folder:
        done = drive(huge(chunks), workers, Path(folder))
    head = [
        "workers",
        "chunks",
        "s",
        "chunks/s",
        "CPU µs per chunk",
        "memory, MiB",
        "ledger, bytes per chunk",
    ]
    spent = (
        f"{done.processor / done.chunks * 1e6:.0f}",
        f"{done.memory / 2**20:.0f}",
        f"{done.ledger_bytes:.0f}",
    )
    print(table(head, [[f"{workers:,}", f"{done.chunks:,}", f"{done.wall:.0f}", short(done.rate), *spent]]))
    print(f"\nDask: {statistics.median(through_dask(2_000) for _ in range(3)):.0f} tasks/s")


def main() -> None:
    """Print the tables that are asked for."""
    given = options(__doc__, what=["files", "s3", "rate"], chunks=100_000, workers=1000)
    print(describe("dask", "zarr"), flush=True)
    if "files" in given.what:
        files()
    if "s3" in given.what:
        s3()
    if "rate" in given.what:
        rate(given.chunks, given.workers)


if __name__ == "__main__":
    main()
