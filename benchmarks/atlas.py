"""Atlas: Gamma x Omega x xi cells of `rigid` or `soft`, over HTTP on the embedded cluster.

    python -m benchmarks.atlas [--gamma 1000 --omega 100 --xi 10] [--workers 2] [--queries 40]
        [--model soft] [--ramp] [--every-cycle]

From rest, with `--ramp` along Gamma up and down: twice as many cells.

Prints the wall time from submission to completion on warm workers, the share of kernel time, the peak memory
of every process, the size of the store, and the latency of diagram queries over HTTP along each axis.
"""

import argparse
import math
import statistics
import tempfile
import time
from concurrent.futures import Future
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import psutil

from benchmarks.machine import describe
from service.client import Client, Job
from service.server import embedded
from worker.executors.dask import Dask
from worker.plan import Chunk
from worker.spec import SweepSpec
from worker.tasks import ChunkReport


def atlas(
    gamma: int, omega: int, xi: int, model: str = "rigid", *, ramp: bool = False, settle_early: bool = True
) -> dict[str, Any]:
    """The specification; 300 plate periods per cell."""
    protocol = {"kind": "ramp", "axis": "gamma", "direction": "both"} if ramp else {"kind": "rest"}
    return {
        "name": f"atlas {gamma} x {omega} x {xi}",
        "gamma": {"start": 0.5, "stop": 6.0, "num": gamma},
        "omega": {"start": 0.1, "stop": 5.0, "num": omega, "spacing": "log"},
        "xi": {"start": 0.02, "stop": 5.0, "num": xi, "spacing": "log"},
        "model": {"kind": model},
        "protocol": protocol,
        "settle_early": settle_early,
        "settle": 200,
        "observe": 100,
        "keep": 16,
    }


def warm(client: Client, model: str = "rigid") -> None:
    """Run one small job, so that every worker has compiled its kernels."""
    spec = {**atlas(64, 2, 2, model), "omega": 1.0, "xi": 0.1, "settle": 1, "observe": 1, "name": "warm"}
    client.submit(spec).wait(progress=False)


def peaks() -> list[tuple[str, float]]:
    """Peak resident memory, GiB, of this process and its children."""
    own = psutil.Process()
    rows = []
    for process in (own, *own.children(recursive=True)):
        status = Path(f"/proc/{process.pid}/status").read_text()
        high = next(line for line in status.splitlines() if line.startswith("VmHWM")).split()[1]
        rows.append((process.name(), int(high) / 2**20))
    return sorted(rows, key=lambda row: -row[1])


class Counting(Dask):
    """The embedded cluster; sums the times in the reports of its tasks."""

    kernel_seconds = 0.0
    task_seconds = 0.0

    def submit(self, spec: SweepSpec, chunk: Chunk, store_url: str, **limits: float) -> "Future[ChunkReport]":
        future = super().submit(spec, chunk, store_url, **limits)
        future.add_done_callback(self._add_times)
        return future

    def _add_times(self, future: "Future[ChunkReport]") -> None:
        if future.cancelled() or future.exception() is not None:  # it paused
            return
        report = future.result()
        self.kernel_seconds += report.kernel_seconds
        self.task_seconds += report.seconds


def queries(url: str, job: Job, spec: dict[str, Any], count: int) -> None:
    """Time diagrams along each axis, the other parameters random values of the grid."""
    rng = np.random.default_rng(1)
    values = {
        axis["label"]: (np.geomspace if axis.get("spacing") == "log" else np.linspace)(
            axis["start"], axis["stop"], axis["num"]
        )
        for axis in ({"label": name, **spec[name]} for name in ("gamma", "omega", "xi"))
    }
    print(f"\n{'diagram along':16}{'p50 ms':>10}{'p95 ms':>10}{'values':>10}")
    with httpx2.Client(base_url=url, timeout=60) as http:
        for along, axis in values.items():
            times = []
            for _ in range(count):
                fixed = {name: float(rng.choice(others)) for name, others in values.items() if name != along}
                start = time.perf_counter()
                answer = http.get(f"/v1/jobs/{job.id}/diagram", params={"along": along, **fixed})
                answer.raise_for_status()
                times.append((time.perf_counter() - start) * 1e3)
            low, high = statistics.median(times), float(np.quantile(times, 0.95))
            print(f"{along:16}{low:10.1f}{high:10.1f}{len(axis):10d}")


def main() -> None:
    """Run the benchmark and print the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, size in (("gamma", 1000), ("omega", 100), ("xi", 10), ("workers", 2), ("queries", 40)):
        parser.add_argument(f"--{name}", type=int, default=size)
    parser.add_argument("--model", choices=("rigid", "soft"), default="rigid")
    parser.add_argument("--ramp", action="store_true")
    parser.add_argument("--every-cycle", action="store_true", help="settle_early false")
    arguments = parser.parse_args()
    print(describe("dask", "zarr"))
    spec = atlas(
        arguments.gamma, arguments.omega, arguments.xi, arguments.model,
        ramp=arguments.ramp, settle_early=not arguments.every_cycle,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder)
        settings = embedded.settings(data=data, workers=arguments.workers, host="127.0.0.1", port=0)
        with (
            closing(Counting(workers=arguments.workers)) as executor,
            embedded.running(settings, executor) as url,
            Client(url) as client,
        ):
            warm(client, arguments.model)
            executor.kernel_seconds = executor.task_seconds = 0.0
            start = time.perf_counter()
            job = client.submit(spec).wait(progress=True)
            wall = time.perf_counter() - start
            busy, tasks = executor.kernel_seconds, executor.task_seconds
            cells = math.prod(SweepSpec.parse(spec).shape)
            print(f"{cells} cells x 300 plate periods: {wall:.1f} s, {wall / cells / 300 * 1e6:.3f} us each")
            print(f"kernel time: {busy:.1f} s, {busy / tasks:.1%} of the tasks' time,")
            print(f"             {busy / wall / arguments.workers:.1%} of the workers'")
            stored = sum(f.stat().st_size for f in data.rglob("*") if f.is_file())
            print(f"store: {stored / 2**20:.0f} MiB in {sum(1 for _ in data.rglob('*'))} files")
            for name, peak in peaks():
                print(f"peak memory of {name}: {peak:.2f} GiB")
            if not arguments.ramp:
                queries(url, job, spec, arguments.queries)


if __name__ == "__main__":
    main()
