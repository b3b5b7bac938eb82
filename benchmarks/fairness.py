"""Fairness: how long small jobs wait beside large ones, how soon a cancel works, and who waits longest.

    python -m benchmarks.fairness [--workers 2] [--jobs 500] [--repeat 5] [--seconds 120]

Over HTTP, with `bounce serve`. A small job has 100 cells; its time is from submission to done, beside
`--jobs` jobs of ten core-seconds each, and beside jobs of cells of 20 million plate periods. Then 20 jobs of
a minute each run for `--seconds` beside a stream of small ones: the longest time in which none of a job's
chunks is done is compared with the bound of docs/reliability.md.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

from benchmarks.machine import describe
from benchmarks.serving import Serving
from service.client import Client, Job

SOFT: dict[str, Any] = {"kind": "soft", "restitution": 0.01, "penetration": 1e-3}

#: Jobs whose cells take a minute or more each, by what is special about them.
ENDLESS: dict[str, dict[str, Any]] = {
    "eight soft cells": {"model": SOFT, "gamma": {"start": 2.0, "stop": 5.0, "num": 8}},
    "64 rigid cells, in lanes": {"model": {"kind": "rigid"}, "gamma": {"start": 2.0, "stop": 5.0, "num": 64}},
    "eight cells of a ramp, four exponents": {
        "model": SOFT,
        "gamma": {"start": 2.0, "stop": 5.0, "num": 8},
        "protocol": {"kind": "ramp", "axis": "gamma", "direction": "up"},
        "exponents": 4,
    },
    "eight stepped cells": {
        "model": {"kind": "stepped", "penetration": 0.05},
        "gamma": {"start": 2.0, "stop": 5.0, "num": 8},
    },
}
#: Undamped springs that never leave the plate: each cell is one contact, which is not divided.
UNDIVIDED: dict[str, Any] = {"model": SOFT, "gamma": {"start": 0.1, "stop": 0.6, "num": 8}, "xi": 0.0}
LONGEST = {"settle": 10_000_000, "observe": 10_000_000, "settle_early": False, "omega": 0.5, "xi": 0.26}

#: Jobs of the last part, and their core-seconds.
OLD_JOBS, OLD_SECONDS = 20, 60.0

_numbers = count(1)


def small() -> dict[str, Any]:
    """100 cells, another job every time."""
    omega = 0.5 + 1e-6 * next(_numbers)
    return {"name": "small", "gamma": {"start": 1.0, "stop": 6.0, "num": 100}, "omega": omega, "xi": 0.26}


def large(core_seconds: float) -> dict[str, Any]:
    """A sweep of about so many core-seconds by the cost table, another job every time."""
    omega = 0.7 + 1e-6 * next(_numbers)
    cells = round(core_seconds / 2.4e-3)
    gamma = {"start": 1.0, "stop": 6.0, "num": cells}
    return {
        "name": "large",
        "gamma": gamma,
        "omega": omega,
        "xi": 0.26,
        "model": SOFT,
        "settle": 1500,
        "settle_early": False,
    }


def times(client: Client, repeat: int) -> list[float]:
    """Seconds from the submission of a small job to its end, one job after the other."""
    taken = []
    for _ in range(repeat):
        began = time.perf_counter()
        client.submit(small()).wait(progress=False)
        taken.append(time.perf_counter() - began)
    return taken


def cancelled(job: Job) -> float:
    """Seconds from a cancel to the job's end."""
    began = time.perf_counter()
    job.cancel()
    while job.refresh().state != "cancelled":
        time.sleep(0.02)
    return time.perf_counter() - began


def row(name: str, taken: list[float], note: str = "") -> None:
    """Print the range of some times."""
    print(f"{name:58}{min(taken):8.2f}{max(taken):8.2f}  {note}", flush=True)


def beside_many(client: Client, jobs: int, repeat: int) -> None:
    """Small jobs beside many from one client."""
    began = time.perf_counter()
    many = [client.submit(large(10.0)) for _ in range(jobs)]
    note = f"{jobs} submitted in {time.perf_counter() - began:.1f} s"
    row(f"a small job beside {jobs} jobs of 10 core-seconds, s", times(client, repeat), note)
    row("cancelling each of them, s", [cancelled(job) for job in many])


def begun(client: Client, changes: dict[str, Any]) -> Job:
    """A job of the longest windows, when every worker is in one of its cells."""
    brief = {"settle": 1, "observe": 10, "name": "compiles"}
    client.submit(LONGEST | changes | brief).wait(progress=False)
    endless = client.submit(LONGEST | changes | {"name": "endless"})
    while endless.refresh().state != "running":
        time.sleep(0.05)
    time.sleep(2.0)
    return endless


def beside_endless(client: Client, repeat: int) -> None:
    """Small jobs beside cells that take a minute or more, and cancels of these."""
    for name, changes in ENDLESS.items():
        endless = begun(client, changes)
        row(f"a small job beside {name}, s", times(client, repeat))
        row(f"cancelling {name}, s", [cancelled(endless)])
    row("cancelling cells of one contact each, s", [cancelled(begun(client, UNDIVIDED))])


def gaps(client: Client, seconds: float) -> Iterator[float]:
    """Of each old job, the longest time in which none of its chunks was done; small jobs stream beside."""
    old = [client.submit(large(OLD_SECONDS)) for _ in range(OLD_JOBS)]
    began = time.perf_counter()
    seen = {job.id: (0, began) for job in old}  # chunks done, and since when
    longest = dict.fromkeys(seen, 0.0)
    stream: list[Job] = []
    while (now := time.perf_counter()) < began + seconds:
        stream = [job for job in stream if job.refresh().state != "done"]
        stream += [client.submit(small()) for _ in range(4 - len(stream))]
        for job in old:
            done, since = seen[job.id]
            if job.refresh().state == "done":
                continue
            longest[job.id] = max(longest[job.id], now - since)
            if job.progress.chunks_done > done:
                seen[job.id] = (job.progress.chunks_done, now)
        time.sleep(0.1)
    for job in old:
        if job.refresh().state != "done":
            job.cancel()
    yield from longest.values()


@contextmanager
def running(folder: Path, workers: int) -> Iterator[str]:
    """The address of a service with so many workers."""
    serving = Serving(folder, "--workers", str(workers))
    try:
        yield serving.url
    finally:
        serving.end()


def main() -> None:
    """Run the benchmark and print the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--jobs", type=int, default=500)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=120.0, help="of the stream of small jobs")
    arguments = parser.parse_args()
    print(describe("dask", "zarr"))
    # A process of its own: workers that replace others load its kernels from the cache.
    with (
        tempfile.TemporaryDirectory() as folder,
        running(Path(folder), arguments.workers) as url,
        Client(url) as client,
    ):
        times(client, 3)
        print(f"{'':58}{'least':>8}{'most':>8}")
        row("a small job alone, s", times(client, arguments.repeat))
        beside_endless(client, arguments.repeat)
        beside_many(client, arguments.jobs, arguments.repeat)
        bound = 30.0 + 8.0 * (OLD_JOBS + 4) / min(arguments.workers, 4)
        row(
            f"{OLD_JOBS} old jobs beside small ones, longest without a chunk, s",
            list(gaps(client, arguments.seconds)),
            f"bound {bound:g} s",
        )


if __name__ == "__main__":
    main()
