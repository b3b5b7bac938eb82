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
import os
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.machine import describe
from benchmarks.tables import table
from worker import store
from worker.plan import Plan, make_plan
from worker.spec import SweepSpec
from worker.studies import run_task, study_of

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
    import httpx2

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


def main() -> None:
    """Print the table that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["files", "s3", "compute"])
    parser.add_argument("rest", nargs="*", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.what == "compute":
        name, url, chunks = arguments.rest
        compute(name, url, int(chunks))
        return
    print(describe("dask", "zarr"), flush=True)
    {"files": files, "s3": s3}[arguments.what]()


if __name__ == "__main__":
    main()
