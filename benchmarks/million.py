"""The plan, the ledger and the supervisor with a million chunks, on simulated workers.

    python -m benchmarks.million [--chunks 1000000] [--workers 1000,100,2] [--seconds 0]

Every chunk is reported at once, or after --seconds, so the time is the service's: the rate at which it plans,
submits and commits chunks to a durable ledger (synchronous=FULL). The first number of workers computes all
chunks, the others a tenth. Then the rate of a Dask cluster on this machine: empty tasks, 64 in flight. The
lower of the two rates limits a cluster.
"""

import argparse
import heapq
import math
import statistics
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import psutil

from benchmarks.machine import describe
from benchmarks.tables import short, table
from service.jobs.ledger import Ledger
from service.jobs.manager import JobManager
from service.jobs.model import JobState
from service.jobs.transactions import WriteTransaction
from service.settings import Settings
from worker.executors.base import ClusterState
from worker.executors.dask import Dask
from worker.plan import TARGET_SECONDS, Chunk, make_plan
from worker.spec import SweepSpec
from worker.tasks import ChunkReport


class Simulated:
    """An executor of so many workers that reports each chunk `seconds` after its submission."""

    def __init__(self, workers: int, seconds: float) -> None:
        self._workers, self._seconds = workers, seconds
        self._due: list[tuple[float, int, int, Future[ChunkReport]]] = []
        self._wake = threading.Condition()
        self._open = True
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def submit(self, spec: SweepSpec, chunk: Chunk, store_url: str, **limits: float) -> "Future[ChunkReport]":
        """Schedule the report of a chunk."""
        future: Future[ChunkReport] = Future()
        with self._wake:
            heapq.heappush(self._due, (time.monotonic() + self._seconds, chunk.index, chunk.cells, future))
            self._wake.notify()
        return future

    def call(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """Not used."""
        raise NotImplementedError

    def ready(self) -> bool:
        """Always true."""
        return True

    def workers(self) -> int:
        """The number of simulated workers."""
        return self._workers

    def state(self) -> ClusterState:
        """Always connected."""
        return ClusterState(connected=True, workers=self._workers)

    def ask_for(self, seconds: float, tasks: int) -> None:
        """The number of workers does not change."""

    def close(self) -> None:
        """End the thread."""
        with self._wake:
            self._open = False
            self._wake.notify()
        self._thread.join()

    def _work(self) -> None:
        while self._open:
            with self._wake:
                while self._open and not (self._due and self._due[0][0] <= time.monotonic()):
                    wait = self._due[0][0] - time.monotonic() if self._due else None
                    self._wake.wait(wait)
                due = [heapq.heappop(self._due)] if self._due else []
                while self._due and self._due[0][0] <= time.monotonic():
                    due.append(heapq.heappop(self._due))
            for _, index, cells, future in due:
                if future.set_running_or_notify_cancel():
                    future.set_result(ChunkReport(index, cells, 1.0, 0.95, f"{index:064x}", (0, cells, 0, 0)))


class Counted(Ledger):
    """A ledger that counts its transactions."""

    commits = 0

    @contextmanager
    def writing(self) -> Iterator[WriteTransaction]:
        """A counted transaction."""
        with super().writing() as ledger:
            yield ledger
        self.commits += 1


def sweep(chunks: int) -> SweepSpec:
    """A sweep of about so many chunks of the default shape."""
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

    workers: int
    chunks: int
    wall: float  # s
    first: float  # s to the first commit
    last_rate: float  # chunks per second in the last tenth
    commits: int
    processor: float  # CPU time, s
    memory: int  # growth, bytes
    files: int  # bytes of the ledger
    reread: float  # s to read which chunks are done, as after a restart

    @property
    def rate(self) -> float:
        """Chunks per second."""
        return self.chunks / self.wall

    @property
    def ledger_bytes(self) -> float:
        """Bytes of the ledger per chunk."""
        return self.files / self.chunks

    def row(self) -> list[str]:
        """A row of the table."""
        return [
            f"{self.workers:,}", f"{self.chunks:,}", f"{self.wall:.0f}", f"{self.first:.1f}",
            short(self.rate), short(self.last_rate), short(self.commits / self.wall),
            short(self.processor / self.chunks * 1e6), f"{self.memory / 2**20:.0f}",
            f"{self.ledger_bytes:.0f}", f"{self.reread:.1f}",
        ]  # fmt: skip


def drive(spec: SweepSpec, workers: int, seconds: float, folder: Path) -> Driven:
    """Run one job from submission to completion."""
    limits: dict[str, Any] = {"max_cells": 10**12, "max_bytes": 10**15, "max_core_seconds": 1e9}
    settings = Settings(data=folder, longest_chunk_seconds=TARGET_SECONDS, **limits)
    executor = Simulated(workers, seconds)
    before = psutil.Process().memory_info().rss
    with Counted(settings.ledger_path) as ledger:
        manager = JobManager(ledger, executor, settings)
        manager.start()
        start = time.perf_counter()
        job_id = manager.submit(spec).job.id
        marks, peak, processor = [], 0, time.process_time()
        while True:
            time.sleep(0.1)
            job = ledger.find(job_id)
            assert job is not None
            peak = max(peak, psutil.Process().memory_info().rss)
            marks.append((time.perf_counter() - start, job.chunks_done))
            if job.state is not JobState.RUNNING and job.state is not JobState.QUEUED:
                break
        wall, chunks = marks[-1]
        processor = time.process_time() - processor
        manager.stop()
        executor.close()
        assert job.state is JobState.DONE, job.error
        commits = ledger.commits
        files = sum(file.stat().st_size for file in folder.glob("ledger.*"))
        began = time.perf_counter()
        ledger.done_mask(job)
        reread = time.perf_counter() - began
    first = next(when for when, done in marks if done)
    tail = [(when, done) for when, done in marks if done >= 0.9 * chunks]
    last_rate = (chunks - tail[0][1]) / (tail[-1][0] - tail[0][0]) if tail[-1][0] > tail[0][0] else math.nan
    return Driven(workers, chunks, wall, first, last_rate, commits, processor, peak - before, files, reread)


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


HEAD = [
    "workers", "chunks", "s", "s to the first", "chunks/s", "in the last tenth", "commits/s",
    "CPU µs per chunk", "memory, MiB", "ledger, bytes per chunk", "s to reread it",
]  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--chunks", type=int, default=1_000_000)
    parser.add_argument("--workers", default="1000,100,2", help="numbers of workers, separated by commas")
    parser.add_argument("--seconds", type=float, default=0.0, help="simulated time of a chunk")
    arguments = parser.parse_args()
    print(describe("dask", "zarr"), flush=True)
    rows = []
    for i, workers in enumerate(int(number) for number in arguments.workers.split(",")):
        spec = sweep(arguments.chunks if i == 0 else arguments.chunks // 10)
        with tempfile.TemporaryDirectory() as folder:
            rows.append(drive(spec, workers, arguments.seconds, Path(folder)).row())
    print("\n" + table(HEAD, rows))
    rates = [through_dask(2_000) for _ in range(3)]
    print(f"\nDask, two worker processes of this machine: {statistics.median(rates):.0f} tasks/s")


if __name__ == "__main__":
    main()
