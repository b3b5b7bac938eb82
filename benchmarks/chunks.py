"""What one chunk costs beside its computation, and what a job of a million chunks costs the service.

    python -m benchmarks.chunks files      system calls per chunk, counted by strace (which must be there)
    python -m benchmarks.chunks s3         requests and round trips per chunk in a bucket (moto, in a thread)
    python -m benchmarks.chunks restart    a service started again in a job of 10^6 chunks, half of them done
    python -m benchmarks.chunks scheduler  Dask's scheduler with 64 pretended workers

`files` and `s3` compute chunks of a few cells, as a worker does. `restart` fills a ledger, and pretends that
every stored chunk is there and as it was written; each key that is read takes --read-seconds. `scheduler`
runs a scheduler in a process of its own and 64 workers in another, whose tasks do nothing.
"""

import argparse
import hashlib
import itertools
import os
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
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx2

from benchmarks.machine import describe
from benchmarks.million import Simulated, sweep
from benchmarks.tables import table
from kernel.params import KERNEL_VERSION
from service.jobs.ledger import Ledger
from service.jobs.manager import _new_job
from service.server import embedded
from worker import store
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


@contextmanager
def bucket(seconds: float) -> Iterator[Counting]:
    """A bucket `results` whose requests take so many seconds each."""
    from moto.server import DomainDispatcherApplication, create_backend_app
    from werkzeug.serving import make_server

    counting = Counting(DomainDispatcherApplication(create_backend_app), seconds)
    server = make_server("127.0.0.1", 0, counting, threaded=True)
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
    import logging

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    latency, rows = 0.2, []
    with bucket(latency) as counting:
        for name, fields in SWEEPS.items():
            spec, url = SweepSpec(**fields), f"s3://results/{name.replace(' ', '-')}.zarr"
            plan = created(spec, url)
            run_task(spec, plan[0], url)  # compiles
            counts, trips, kinds = [], [], Counter[str]()
            for chunk in list(plan)[1:9]:
                before, began = len(counting.requests), time.perf_counter()
                run_task(spec, chunk, url)
                trips.append((time.perf_counter() - began) / latency)
                made = counting.requests[before:]
                counts.append(len(made))
                kinds.update(request.split()[0] for request in made)
            each = ", ".join(f"{kind} {count / len(counts):.1f}" for kind, count in sorted(kinds.items()))
            rows.append([name, f"{statistics.mean(counts):.1f}", each, f"{statistics.median(trips):.1f}"])
    print(table(["sweep", "requests per chunk", "of these", f"time / latency of {latency:g} s"], rows))


CONTENT = b"x" * 200


def filled(folder: Path, chunks: int) -> str:
    """A data folder with a job of so many chunks, half of them done; returns the job's id."""
    spec = sweep(chunks)
    plan = make_plan(spec)
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
        plan = make_plan(sweep(chunks))

        def sizes_in(url: str, folder: str) -> Iterator[tuple[str, int]]:
            extra = ".0" if folder in ("flight_time", "takeoff_phase") else ""
            for coords in itertools.product(range(1), *map(range, plan.counts)):
                yield f"c.{'.'.join(map(str, coords))}{extra}", len(CONTENT)

        stored.sizes_in = sizes_in


class Requests(threading.Thread):
    """Repeats a request until the block ends; `seconds`: of each."""

    def __init__(self, ask: Callable[[], httpx2.Response], pause: float = 0.05) -> None:
        super().__init__(daemon=True)
        self._ask, self._pause, self._over = ask, pause, threading.Event()
        self.seconds: list[float] = []

    def __enter__(self) -> "Requests":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self.join()

    def run(self) -> None:
        """Ask, pause, ask."""
        while not self._over.wait(self._pause):
            began = time.perf_counter()
            self._ask().raise_for_status()
            self.seconds.append(time.perf_counter() - began)

    @property
    def text(self) -> str:
        """Median, 99th percentile and maximum, ms."""
        ordered = sorted(1e3 * second for second in self.seconds)
        if not ordered:
            return "none"
        high = ordered[min(int(0.99 * len(ordered)), len(ordered) - 1)]
        return f"{statistics.median(ordered):.0f}, {high:.0f}, {ordered[-1]:.0f} ms of {len(ordered)}"


def restart(chunks: int, read_seconds: float, seconds: float) -> None:
    """Print what a service does that starts in a job of so many chunks."""
    with tempfile.TemporaryDirectory() as data:
        folder = Path(data)
        job_id = filled(folder, chunks)
        size = sum(file.stat().st_size for file in folder.glob("ledger.*"))
        print(f"ledger: {size / 2**20:.0f} MiB, {size / (chunks // 2):.0f} bytes per done chunk", flush=True)
        pretend(chunks, read_seconds)
        executor, first = Simulated(64, 1.0), threading.Event()
        submit = executor.submit
        executor.submit = lambda *given, **more: (first.set(), submit(*given, **more))[1]  # type: ignore[method-assign]
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
                Requests(lambda: client.get(here)) as polls,
                Requests(lambda: client.post("/v1/jobs?validate_only=true", json=small)) as estimates,
            ):
                went_on = first.wait(120)
                after = time.perf_counter() - began
                time.sleep(seconds)
            print(f"answers after {up:.1f} s, goes on after {after:.1f} s{'' if went_on else ' (not yet)'}")
            print(f"polls: {polls.text}\nvalidate_only: {estimates.text}  (median, 99th percentile, maximum)")
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
            print(f"memory of the process, at most: {peak:.0f} MiB", flush=True)
            client.post(f"{here}/cancel").raise_for_status()
            while client.get(here).json()["state"] != "cancelled":
                time.sleep(0.1)
            counter = itertools.count(1)

            def accept() -> httpx2.Response:
                return client.post("/v1/jobs", json=SMALL | {"xi": 0.1 + 1e-4 * next(counter)})

            with Requests(accept, 0.2) as submissions:
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


def main() -> None:
    """Print the table that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["files", "s3", "restart", "compute"])
    parser.add_argument(
        "--chunks", type=int, default=1_000_000, help="of the job that `restart` goes on with"
    )
    parser.add_argument("--read-seconds", type=float, default=1e-4, help="of a key that `restart` verifies")
    parser.add_argument("--seconds", type=float, default=20.0, help="for which `restart` asks")
    parser.add_argument("rest", nargs="*", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.what == "compute":
        name, url, chunks = arguments.rest
        compute(name, url, int(chunks))
        return
    print(describe("dask", "zarr"), flush=True)
    if arguments.what == "restart":
        restart(arguments.chunks, arguments.read_seconds, arguments.seconds)
    else:
        {"files": files, "s3": s3}[arguments.what]()


if __name__ == "__main__":
    main()
