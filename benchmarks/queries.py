"""Latency of diagrams over HTTP from stores of ten thousand to ten million cells.

    python -m benchmarks.queries [--queries 30] [--largest 7]

The stores are filled over HTTP by an executor that computes one chunk in forty and writes its record for the
next ones too: numbers are realistic, but not those of their cells. Queries are for random values of the grid,
on one connection; files are in the page cache.
"""

import argparse
import math
import statistics
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
from numpy.typing import NDArray

from benchmarks.atlas import atlas
from benchmarks.machine import describe
from benchmarks.tables import short, table
from kernel.params import Outcome
from service.client import Client
from service.server import embedded
from worker import schema, store
from worker.executors.base import ClusterState
from worker.plan import Chunk
from worker.spec import AXES, SweepSpec
from worker.tasks import ChunkReport, run_chunk

#: Values of (gamma, omega, xi); those of gamma are always the same.
GRIDS = {4: (1000, 10, 1), 5: (1000, 100, 1), 6: (1000, 100, 10), 7: (1000, 1000, 10)}
ONE_IN = 40


class Tiling:
    """An executor that computes one chunk in `ONE_IN` and writes its record for the others."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(max_workers=2, thread_name_prefix="tiles")
        self._records: dict[tuple[int, ...], dict[str, NDArray[Any]]] = {}  # by shape
        self._lock = threading.Lock()

    def submit(self, spec: SweepSpec, chunk: Chunk, store_url: str, **limits: float) -> "Future[ChunkReport]":
        """Compute or copy a chunk."""
        return self._thread.submit(self._write, spec, chunk, store_url)

    def _write(self, spec: SweepSpec, chunk: Chunk, store_url: str) -> ChunkReport:
        shape = (*chunk.shape, spec.keep)
        if chunk.index % ONE_IN == 0 or shape not in self._records:
            report = run_chunk(spec, chunk, store_url)
            names = [array.name for array in schema.arrays(spec)]
            with self._lock:
                self._records[shape] = store.read_chunk(store_url, chunk, names)
            return report
        began, record = time.perf_counter(), self._records[shape]
        stored = store.write_chunk(store_url, chunk, record)
        outcomes = np.bincount(record["outcome"].ravel(), minlength=len(Outcome))
        took = time.perf_counter() - began
        return ChunkReport(
            chunk.index, chunk.cells, took, 0.0, stored.checksum, tuple(outcomes.tolist()), bytes=stored.bytes
        )

    def call(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """Call a function in a thread."""
        return self._thread.submit(function, *arguments)

    def ready(self) -> bool:
        """Always true."""
        return True

    def workers(self) -> int:
        """Two threads."""
        return 2

    def state(self) -> ClusterState:
        """Always connected."""
        return ClusterState(connected=True, workers=2)

    def ask_for(self, seconds: float, tasks: int) -> None:
        """The number of workers does not change."""

    def close(self) -> None:
        """End the threads."""
        self._thread.shutdown(cancel_futures=True)


def timed(
    http: httpx2.Client, path: str, parameters: Callable[[], dict[str, Any]], count: int
) -> list[float]:
    """Latencies of `count` requests, ms; a first one is not counted."""
    times = []
    for _ in range(count + 1):
        params = parameters()
        start = time.perf_counter()
        http.get(path, params=params).raise_for_status()
        times.append((time.perf_counter() - start) * 1e3)
    return times[1:]


def rows_of(url: str, client: Client, power: int, queries: int) -> list[tuple[str, ...]]:
    """Fill a store of 10^power cells and time its queries; returns rows of the table."""
    data = atlas(*GRIDS[power])
    if GRIDS[power][2] == 1:
        data["xi"] = 0.1
    spec = SweepSpec.model_validate(data)
    start = time.perf_counter()
    job = client.submit(data).wait(progress=False)
    took = time.perf_counter() - start
    rng = np.random.default_rng(power)
    values = {axis: spec.axis_values(axis) for axis in AXES}

    def diagram(along: str) -> dict[str, Any]:
        fixed = {axis: float(rng.choice(values[axis])) for axis in AXES if axis != along}
        return {"along": along, **fixed}

    rows = []
    with httpx2.Client(base_url=url, timeout=120) as http:
        requests = {
            axis: (f"/v1/jobs/{job.id}/diagram", lambda a=axis: diagram(a), len(values[axis]))
            for axis in AXES
        }
        requests["modes"] = (
            f"/v1/jobs/{job.id}/modes", lambda: {"xi": float(rng.choice(values["xi"]))},
            len(values["gamma"]) * len(values["omega"]),
        )  # fmt: skip
        for name, (path, parameters, points) in requests.items():
            if points == 1 or points > 200_000:
                continue
            times = timed(http, path, parameters, queries if points < 10_000 else max(5, queries // 4))
            p95 = float(np.quantile(times, 0.95))
            what = "mode map" if name == "modes" else f"along {name}"
            rows.append((f"1e{power}, {what}", f"{points:,}", short(statistics.median(times)), short(p95)))
    print(f"1e{power} cells: filled in {took:.0f} s", flush=True)
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--queries", type=int, default=30)
    parser.add_argument(
        "--largest", type=int, default=7, choices=GRIDS, help="power of ten of the largest store"
    )
    arguments = parser.parse_args()
    print(describe("zarr"), flush=True)
    rows: list[tuple[str, ...]] = []
    with tempfile.TemporaryDirectory() as folder, closing(Tiling()) as executor:
        settings = embedded.settings(
            data=Path(folder), host="127.0.0.1", port=0, max_cells=math.prod(GRIDS[7])
        )
        with embedded.running(settings, executor) as url, Client(url) as client:
            for power in range(min(GRIDS), arguments.largest + 1):
                rows += rows_of(url, client, power, arguments.queries)
    print("\n" + table(["cells of the store", "values in the response", "p50, ms", "p95, ms"], rows))


if __name__ == "__main__":
    main()
