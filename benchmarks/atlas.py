"""The atlas: a sweep over Gamma x Omega x xi cells of `rigid` or `soft`, over HTTP on the embedded cluster.

    python -m benchmarks.atlas [--gamma 1000 --omega 100 --xi 10] [--workers 2] [--model soft] [--ramp]
        [--every-cycle]

From rest, with `--ramp` along Gamma up and down: twice as many cells; with `--every-cycle` in fixed
windows. Prints the wall time from submission to completion on warm workers, the share of kernel time, the
peak memory of every process and the size of the store.
"""

import math
import time
from concurrent.futures import Future
from contextlib import closing
from pathlib import Path
from typing import Any

import psutil

from benchmarks.measuring import describe, options, service
from service.client import Client
from worker.executors.dask import Dask
from worker.study import Chunk, ChunkReport
from worker.sweep import SweepSpec


def atlas(
    gamma: int, omega: int, xi: int, model: str = "rigid", *, ramp: bool = False, every_cycle: bool = False
) -> dict[str, Any]:
    """The specification; 300 plate periods per cell that is not certified, or of every cell."""
    protocol = {"kind": "ramp", "axis": "gamma", "direction": "both"} if ramp else {"kind": "rest"}
    return {
        "name": f"atlas {gamma} x {omega} x {xi}",
        "gamma": {"start": 0.5, "stop": 6.0, "num": gamma},
        "omega": {"start": 0.1, "stop": 5.0, "num": omega, "spacing": "log"},
        "xi": {"start": 0.02, "stop": 5.0, "num": xi, "spacing": "log"},
        "model": {"kind": model},
        "protocol": protocol,
        "settle": 200 if every_cycle else "auto",
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

    def submit(self, spec: SweepSpec, chunk: Chunk, store_url: str, *options: Any) -> "Future[ChunkReport]":
        future = super().submit(spec, chunk, store_url, *options)
        future.add_done_callback(self._add_times)
        return future

    def _add_times(self, future: "Future[ChunkReport]") -> None:
        if future.cancelled() or future.exception() is not None:  # it paused
            return
        report = future.result()
        self.kernel_seconds += report.kernel_seconds
        self.task_seconds += report.seconds


def main() -> None:
    """Run the benchmark and print the results."""
    given = options(
        __doc__, gamma=1000, omega=100, xi=10, workers=2, model="rigid", ramp=False, every_cycle=False
    )
    print(describe("dask", "zarr"))
    axes = given.gamma, given.omega, given.xi
    spec = atlas(*axes, given.model, ramp=given.ramp, every_cycle=given.every_cycle)
    with closing(Counting(workers=given.workers)) as executor, service(executor) as (client, _, data):
        warm(client, given.model)
        executor.kernel_seconds = executor.task_seconds = 0.0
        start = time.perf_counter()
        client.submit(spec).wait(progress=True)
        wall = time.perf_counter() - start
        busy, tasks = executor.kernel_seconds, executor.task_seconds
        cells = math.prod(SweepSpec.parse(spec).shape)
        print(f"{cells} cells x 300 plate periods: {wall:.1f} s, {wall / cells / 300 * 1e6:.3f} us each")
        print(f"kernel time: {busy:.1f} s, {busy / tasks:.1%} of the tasks' time,")
        print(f"             {busy / wall / given.workers:.1%} of the workers'")
        files = [file.stat().st_size for file in data.rglob("*") if file.is_file()]
        print(f"store: {sum(files) / 2**20:.0f} MiB in {len(files)} files")
        for name, peak in peaks():
            print(f"peak memory of {name}: {peak:.2f} GiB")


if __name__ == "__main__":
    main()
