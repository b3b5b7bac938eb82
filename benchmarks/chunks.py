"""What one chunk costs beside its computation, and what a job of a million chunks costs the service.

    python -m benchmarks.chunks files      system calls per chunk, counted by strace (which must be there)
    python -m benchmarks.chunks s3         requests and round trips per chunk in a bucket (moto, in a thread)
    python -m benchmarks.chunks restart    a service started again in a job of 10^6 chunks, half of them done
    python -m benchmarks.chunks kill       a real service in a job of 10^6 chunks, killed and started again
    python -m benchmarks.chunks scheduler  Dask's scheduler with 64 pretended workers

`files` and `s3` compute chunks of a few cells, as a worker does. `restart` fills a ledger, and pretends that
every stored chunk is there and as it was written; each key that is read takes --read-seconds. `kill`
pretends nothing: two workers compute chunks of 100 cells for --seconds, the service is killed with SIGKILL
twice, and in the end its chunks are compared with others of the same cells. `scheduler` runs a scheduler in a
process of its own and 64 workers in another, whose tasks do nothing.
"""

import argparse
import asyncio
import hashlib
import itertools
import json
import multiprocessing
import os
import random
import re
import resource
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from socketserver import ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

import httpx2
import psutil
from distributed import Worker, WorkerPlugin

from benchmarks.machine import describe
from benchmarks.million import Simulated
from benchmarks.serving import Serving
from benchmarks.tables import table
from kernel.params import KERNEL_VERSION
from service.jobs.ledger import Ledger
from service.jobs.manager import _new_job
from service.jobs.transactions import StoredChunk
from service.server import embedded
from worker import store, tasks, watchdog
from worker.executors import dask as executor_module
from worker.plan import Plan, make_plan
from worker.spec import SweepSpec
from worker.store import chunks as stored
from worker.studies import run_task, study_of
from worker.tasks import ChunkReport

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
    for chunk in list(created(spec, url))[:chunks]:
        run_task(spec, chunk, url)


def traced(name: str, chunks: int) -> Counter[str]:
    """System calls of a process that computes so many chunks, with the paths of its store alone."""
    with tempfile.TemporaryDirectory() as folder:
        log, url = f"{folder}/trace", f"{folder}/sweep.zarr"
        command = [sys.executable, "-m", "benchmarks.chunks", "compute", name, url, str(chunks)]
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


def begun() -> AbstractContextManager[None]:
    """Have a chunk computed that was never submitted before, as a worker is told."""
    return tasks.on_terms(tasks.Terms(begins=True)) if hasattr(tasks, "on_terms") else nullcontext()


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
    """A bucket `results` whose requests take so many seconds each."""
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
            run_task(spec, plan[0], url)  # compiles
            counts, trips, kinds = [], [], Counter[str]()
            for chunk in list(plan)[1:9]:
                before, began = len(counting.requests), time.perf_counter()
                with begun():
                    run_task(spec, chunk, url)
                trips.append((time.perf_counter() - began) / latency)
                made = counting.requests[before:]
                counts.append(len(made))
                kinds.update(request.split()[0] for request in made)
            each = ", ".join(f"{kind} {count / len(counts):.1f}" for kind, count in sorted(kinds.items()))
            rows.append([name, f"{statistics.mean(counts):.1f}", each, f"{statistics.median(trips):.1f}"])
    print(table(["sweep", "requests per chunk", "of these", f"time / latency of {latency:g} s"], rows))


CONTENT = b"x" * 200


def huge(chunks: int) -> tuple[SweepSpec, Plan]:
    """A sweep, and its plan in so many chunks, whatever their cost."""
    spec = SweepSpec(**SMALL | {
        "gamma": {"start": 0.5, "stop": 6.0, "num": 1000}, "omega": {"start": 0.1, "stop": 5.0, "num": 1000},
        "xi": {"start": 0.02, "stop": 5.0, "num": max(chunks // 10_000, 2)},
    })  # fmt: skip
    return spec, make_plan(spec, chunk_shape=(1, 10, 10))


def filled(folder: Path, chunks: int) -> str:
    """A data folder with a job of so many chunks, half of them done; returns the job's id."""
    spec, plan = huge(chunks)
    layout = study_of(spec).variables(spec, plan.chunk_shape)
    digest = hashlib.sha256()
    for array in layout.arrays:
        digest.update(f"{array.name} {len(CONTENT)}\n".encode() + CONTENT)
    done = len(plan) // 2
    with Ledger(folder / "ledger.sqlite") as ledger:
        with ledger.writing() as writing:
            writing.insert(_new_job(spec, plan, None), time.time())
            job = writing.find(spec.job_id(KERNEL_VERSION))
            assert job is not None
            writing.run(job, time.time())
        cells = plan[0].cells
        for first in range(0, done, 20_000):
            reports = [
                ChunkReport(i, cells, 1.0, 0.95, digest.hexdigest(), (0, cells, 0, 0, 0, 0))
                for i in range(first, min(first + 20_000, done))
            ]
            with ledger.writing() as writing:
                writing.mark_done(job, reports)
    store.create(str(folder / "stores" / f"{job.id}.zarr"), layout)
    return job.id


def pretend(chunks: int, seconds: float) -> None:
    """Have every chunk be there, as it was written; reading a key takes so many seconds."""
    real = stored.read_key

    def read_key(url: str, key: str) -> bytes | None:
        if not re.search(r"/c[./]\d+[./]\d+[./]", key):
            return real(url, key)
        time.sleep(seconds)
        return CONTENT

    stored.read_key = read_key  # type: ignore[assignment]
    if hasattr(stored, "sizes_in"):
        _, plan = huge(chunks)

        def sizes_in(url: str, folder: str) -> Iterator[tuple[str, int]]:
            extra = ".0" if folder in ("flight_time", "takeoff_phase") else ""
            for coords in itertools.product(range(1), *map(range, plan.counts)):
                yield f"c.{'.'.join(map(str, coords))}{extra}", len(CONTENT)

        stored.sizes_in = sizes_in


class Requests:
    """Repeats a request from another process until the block ends; `seconds`: of each.

    body: of a POST. numbered: each request is of another sweep.
    """

    def __init__(
        self, url: str, body: dict[str, Any] | None = None, *, pause: float = 0.05, numbered: bool = False
    ) -> None:
        spawn = multiprocessing.get_context("spawn")
        self._over, self._here = spawn.Event(), spawn.SimpleQueue()
        given = url, body, pause, numbered, self._over, self._here
        self._process = spawn.Process(target=_repeat, args=given, daemon=True)
        self.seconds: list[float] = []

    def __enter__(self) -> "Requests":
        self._process.start()
        self._here.get()  # it has imported all that it needs
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self.seconds = self._here.get()
        self._process.join()

    @property
    def text(self) -> str:
        """Median, 95th and 99th percentile and maximum, ms."""
        ordered = sorted(1e3 * second for second in self.seconds)
        if not ordered:
            return "none"
        high = [ordered[int(share * (len(ordered) - 1))] for share in (0.5, 0.95, 0.99, 1.0)]
        return f"{', '.join(f'{value:.0f}' for value in high)} ms of {len(ordered)}"


def _repeat(
    url: str, body: dict[str, Any] | None, pause: float, numbered: bool, over: Any, results: Any
) -> None:
    """What the process of `Requests` does: ask, pause, ask."""
    seconds: list[float] = []
    with httpx2.Client(timeout=60) as client:
        results.put(None)
        while not over.wait(pause):
            if numbered and body is not None:
                body["xi"] = round(0.1 + 1e-4 * (1 + len(seconds)), 4)
            began = time.perf_counter()
            (client.get(url) if body is None else client.post(url, json=body)).raise_for_status()
            seconds.append(time.perf_counter() - began)
    results.put(seconds)


def restart(chunks: int, read_seconds: float, seconds: float) -> None:
    """Print what a service does that starts in a job of so many chunks."""
    sys.setswitchinterval(embedded._SWITCH_SECONDS)  # as `bounce serve` has it
    with tempfile.TemporaryDirectory() as data:
        folder = Path(data)
        job_id = filled(folder, chunks)
        size = sum(file.stat().st_size for file in folder.glob("ledger.*"))
        print(f"ledger: {size / 2**20:.0f} MiB, {size / (chunks // 2):.0f} bytes per done chunk", flush=True)
        pretend(chunks, read_seconds)
        executor, submitted = Simulated(64, 1.0), list[float]()
        submit = executor.submit

        def noted(*given: Any, **more: Any) -> Future[ChunkReport]:
            submitted.append(time.perf_counter())
            return submit(*given, **more)

        executor.submit = noted  # type: ignore[method-assign]
        settings = embedded.settings(
            data=folder, port=0, max_cells=10**12, max_bytes=10**15, max_core_seconds=1e9
        )
        small = SMALL | {"xi": 0.07}
        began = time.perf_counter()
        with (
            embedded.running(settings, executor) as address,
            httpx2.Client(base_url=address, timeout=60) as client,
        ):
            up = time.perf_counter() - began
            here = f"/v1/jobs/{job_id}"
            with (
                Requests(f"{address}{here}") as polls,
                Requests(f"{address}/v1/jobs?validate_only=true", small) as estimates,
            ):
                time.sleep(seconds)
            after = f"after {submitted[0] - began:.1f} s" if submitted else "not yet"
            print(f"answers after {up:.1f} s, goes on {after}; {len(submitted)} chunks submitted")
            print(f"polls: {polls.text}\nvalidate_only: {estimates.text}  (median, 95 %, 99 %, maximum)")
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
            print(f"memory of the process, at most: {peak:.0f} MiB", flush=True)
            client.post(f"{here}/cancel").raise_for_status()
            while client.get(here).json()["state"] != "cancelled":
                time.sleep(0.1)
            with Requests(f"{address}/v1/jobs", dict(SMALL), pause=0.2, numbered=True) as submissions:
                began = time.perf_counter()
                client.delete(here).raise_for_status()
                answered = time.perf_counter() - began
                left = 1
                while left and time.perf_counter() - began < 120:
                    time.sleep(0.2)
                    with sqlite3.connect(f"file:{folder}/ledger.sqlite?mode=ro", uri=True) as reading:
                        [left] = reading.execute("SELECT count(*) FROM deletions WHERE step < 2").fetchone()
                gone = time.perf_counter() - began
            print(f"deletion: answered after {answered:.2f} s, complete after {gone:.1f} s")
            print(f"submissions beside it: {submissions.text}")
        executor.close()
        with sqlite3.connect(folder / "ledger.sqlite") as ledger:
            ledger.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        size = sum(file.stat().st_size for file in folder.glob("ledger.*"))
        print(f"ledger afterwards: {size / 2**20:.1f} MiB")


def kill(chunks: int, seconds: float, compared: int = 100) -> None:
    """Print how a service goes on with a job of so many chunks after it was killed, and what it stored."""
    os.environ |= {
        "BOUNCE_MAX_CELLS": str(10**12), "BOUNCE_MAX_BYTES": str(10**15), "BOUNCE_MAX_CORE_SECONDS": "1e9",
    }  # fmt: skip
    spec, plan = huge(chunks)
    rows: list[list[str]] = []
    marked: list[list[StoredChunk]] = []
    with tempfile.TemporaryDirectory() as name, ExitStack() as ending:
        folder = Path(name)
        with Ledger(folder / "data" / "ledger.sqlite") as ledger, ledger.writing() as writing:
            writing.insert(_new_job(spec, plan, None), time.time())
        for life in ("first start", "after SIGKILL", "after SIGKILL"):
            began = time.perf_counter()
            service = Serving(folder, "--workers", "2")
            ending.callback(service.process.kill)
            up, job = time.perf_counter() - began, f"{service.url}/v1/jobs/{spec.job_id(KERNEL_VERSION)}"
            before = done = len(marked[-1]) if marked else 0
            while done == before:
                done = httpx2.get(job, timeout=60).json()["progress"]["chunks_done"]
                time.sleep(0.02)
            after = time.perf_counter() - began
            small = SMALL | {"xi": 0.07}
            with (
                Requests(job) as polls,
                Requests(f"{service.url}/v1/jobs?validate_only=true", small) as costs,
            ):
                time.sleep(seconds)
            status = Path(f"/proc/{service.process.pid}/status").read_text()
            peak = int(re.findall(r"VmHWM:\s+(\d+)", status)[0]) / 2**10
            workers = service.me.children(recursive=True)
            service.process.kill()
            service.process.wait()
            _, left = psutil.wait_procs(workers, timeout=60)
            assert not left, f"{left} outlived the service"
            with Ledger(service.data / "ledger.sqlite") as ledger, ledger.reading() as reading:
                record = reading.find(spec.job_id(KERNEL_VERSION))
                assert record is not None
                marked.append(reading.stored_chunks(record, 0, len(plan)))
            counts = f"{before}", f"{len(marked[-1])}"
            rows.append([life, *counts, f"{up:.1f}", f"{after:.1f}", f"{peak:.0f}", polls.text, costs.text])
        head = ["", "chunks at the start", "at the end", "answers, s", "goes on, s", "memory, MiB"]
        print(table([*head, "polls", "validate_only"], rows), flush=True)
        assert set(marked[0]) <= set(marked[1]) <= set(marked[2]), "a chunk was lost or computed otherwise"
        layout = study_of(spec).variables(spec, plan.chunk_shape)
        url = str(service.data / "stores" / f"{spec.job_id(KERNEL_VERSION)}.zarr")
        corrupt = list(store.find_corrupt(url, layout, [(plan[n], checksum) for n, checksum, _ in marked[2]]))
        print(f"{len(marked[2])} chunks read again: {len(corrupt)} differ from what the ledger has of them")
        again = f"{folder}/again.zarr"
        store.create(again, layout)
        chosen = random.Random(1).sample(marked[2], compared)
        with tasks.on_terms(tasks.Terms(3600.0)):  # the first one compiles
            reports = [(run_task(spec, plan[one.number], again), one) for one in chosen]
        differing = [one.number for report, one in reports if report.checksum != one.checksum]
        print(f"{compared} chunks computed by another process: {len(differing)} differ")


class NoKernels(WorkerPlugin):
    """In place of the plugin that compiles kernels: pretended workers need none."""

    def __init__(self, *_: Any) -> None:
        pass

    async def setup(self, worker: Any) -> None: ...

    async def teardown(self, worker: Any) -> None: ...


def computed_at_once(spec: Any, chunk: Any, *_: Any) -> ChunkReport:
    """What a pretended worker does with a chunk."""
    return ChunkReport(chunk.index, chunk.cells, 1.0, 0.95, "0" * 64, (0, chunk.cells, 0, 0, 0, 0))


def pretended_workers(address: str, number: int) -> None:
    """So many workers in this process, which report each chunk at once."""
    watchdog.run_watched = computed_at_once  # type: ignore[assignment]
    if find_spec("worker.executors.sent_specs"):
        import_module("worker.executors.sent_specs").run_watched = computed_at_once

    async def work() -> None:
        workers = [Worker(address, nthreads=1, dashboard=False) for _ in range(number)]
        await asyncio.gather(*workers)
        await asyncio.gather(*(worker.finished() for worker in workers))

    asyncio.run(work())


def keep_busy(executor: Any, spec: SweepSpec, plan: Plan, url: str, workers: int, chunks: int) -> None:
    """Two chunks in flight per worker, as the supervisor has them, submitted as others come back."""
    submitted, flying = 0, set[Future[Any]]()
    while submitted < chunks or flying:
        while submitted < chunks and len(flying) < 2 * workers:
            flying.add(executor.submit(spec, plan[submitted % len(plan)], url, seconds=60.0))
            submitted += 1
        done, flying = wait(flying, return_when=FIRST_COMPLETED)
        for future in done:
            future.result()


def scheduler(workers: int, chunks: int) -> None:
    """Print the processor time of Dask's scheduler, of the workers and of this process per chunk."""
    executor_module.PreparedWorker = NoKernels  # type: ignore[assignment, misc]
    lists = SMALL | {"gamma": [round(0.5 + 5e-4 * i, 6) for i in range(10_000)], "xi": [0.05]}
    rows = []
    for name, fields in (("ranges", SMALL), ("10,000 values", lists)):
        with tempfile.TemporaryDirectory() as folder:
            file, url = Path(folder, "scheduler.json"), f"{folder}/sweep.zarr"
            command = [
                sys.executable,
                "-m",
                "distributed.cli.dask_scheduler",
                "--port",
                "0",
                "--no-dashboard",
            ]
            serving = subprocess.Popen(
                [*command, "--scheduler-file", file, "--host", "127.0.0.1", "--port", "0"]
            )
            while not file.exists():
                time.sleep(0.05)
            address = json.loads(file.read_text())["address"]
            pretended = multiprocessing.get_context("spawn").Process(
                target=pretended_workers, args=(address, workers), daemon=True
            )
            pretended.start()
            spec = SweepSpec(**fields)
            plan = created(spec, url)
            measured = [psutil.Process(pid) for pid in (serving.pid, pretended.pid, os.getpid())]
            with closing(executor_module.Dask(address)) as executor:
                while executor.workers() < workers:
                    time.sleep(0.1)

                keep_busy(executor, spec, plan, url, workers, 4 * workers)
                before = [sum(process.cpu_times()[:2]) for process in measured]
                began = time.perf_counter()
                keep_busy(executor, spec, plan, url, workers, chunks)
                took = time.perf_counter() - began
                spent = [sum(p.cpu_times()[:2]) - was for p, was in zip(measured, before, strict=True)]
            pretended.terminate()
            serving.terminate()
            serving.wait()
            rows.append([name, *(f"{1e3 * seconds / chunks:.2f}" for seconds in (*spent, took))])
    head = ["axes", "scheduler, ms of CPU", "64 workers", "service", "all, ms of wall"]
    print(table(head, rows))


def main() -> None:
    """Print the table that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["files", "s3", "restart", "kill", "scheduler", "compute"])
    parser.add_argument(
        "--chunks", type=int, default=1_000_000, help="of the job that `restart` and `kill` go on with"
    )
    parser.add_argument("--read-seconds", type=float, default=1e-4, help="of a key that `restart` verifies")
    parser.add_argument(
        "--seconds", type=float, default=20.0, help="for which `restart` asks, and `kill` before each SIGKILL"
    )
    parser.add_argument("rest", nargs="*", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.what == "compute":
        name, url, chunks = arguments.rest
        compute(name, url, int(chunks))
        return
    print(describe("dask", "zarr"), flush=True)
    if arguments.what == "restart":
        restart(arguments.chunks, arguments.read_seconds, arguments.seconds)
    elif arguments.what == "kill":
        kill(arguments.chunks, arguments.seconds)
    elif arguments.what == "scheduler":
        scheduler(64, 4_000)
    else:
        {"files": files, "s3": s3}[arguments.what]()


if __name__ == "__main__":
    main()
