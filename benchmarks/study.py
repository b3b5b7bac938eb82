"""Extrapolated cost of a study of a thousand million cells on a cluster.

    python -m benchmarks.study [--cells 1000000000] [--omega 20]

Measures a part of the atlas (1000 x --omega x 10 cells of `rigid`, 300 plate periods per cell) over HTTP on
two workers, ten thousand chunks in the ledger with a thousand simulated workers (benchmarks.chunks), and two
thousand empty tasks in Dask. The extrapolation assumes that the cluster has cores like these and a file
system that is not the bottleneck.
"""

import math
import tempfile
import time
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from benchmarks import chunks
from benchmarks.atlas import Counting, atlas, warm
from benchmarks.measuring import describe, options, service, short, table
from worker.sweep import SweepSpec, schema
from worker.sweep.plan import make_plan

#: Numbers of workers.
WORKERS = (100, 1000)


class Piece(NamedTuple):
    """Costs per cell."""

    kernel: float  # kernel time, s
    task: float  # time of tasks, s
    worker: float  # time of workers, idle time included, s
    stored: float  # bytes
    raw: int  # bytes before compression


def piece(omega: int) -> Piece:
    """Compute a part of the atlas and measure its cost."""
    spec = atlas(1000, omega, 10)
    cells = 10_000 * omega
    with closing(Counting(workers=2)) as executor, service(executor) as (client, _, data):
        warm(client)
        executor.kernel_seconds = executor.task_seconds = 0.0
        start = time.perf_counter()
        job = client.submit(spec).wait(progress=False)
        wall = time.perf_counter() - start
        stored = sum(f.stat().st_size for f in next((data / "stores").glob(f"*{job.id}.zarr")).rglob("*"))
    return Piece(
        executor.kernel_seconds / cells, executor.task_seconds / cells, 2 * wall / cells, stored / cells,
        schema.bytes_per_cell(SweepSpec.model_validate(spec)),
    )  # fmt: skip


def main() -> None:
    """Measure and print the table."""
    arguments = options(__doc__, cells=1_000_000_000, omega=20)
    print(describe("dask", "zarr"), flush=True)
    cells = arguments.cells
    cell = piece(arguments.omega)
    plan = make_plan(SweepSpec.model_validate(atlas(1000, 1000, math.ceil(cells / 1e6))))
    chunk_seconds = cell.task * math.prod(plan.chunk_shape)
    with tempfile.TemporaryDirectory() as folder:
        driven = chunks.drive(chunks.huge(10_000), WORKERS[-1], Path(folder))
    dask = chunks.through_dask(2_000)
    hours = {n: max(cells * cell.worker / n, len(plan) / min(dask, driven.rate)) / 3600 for n in WORKERS}
    arrays = len(list(schema.arrays(SweepSpec.model_validate(atlas(10, 10, 10)))))
    rows = [
        ("kernel, core-hours", short(cells * cell.kernel / 3600)),
        ("worker-hours, everything", short(cells * cell.worker / 3600)),
        *((f"hours on {n:,} workers", short(hour)) for n, hour in hours.items()),
        ("chunks", f"{len(plan):,} of {short(chunk_seconds)} s"),
        (
            "stored",
            f"{cells * cell.stored / 1e9:,.0f} GB, of {cells * cell.raw / 1e9:,.0f} GB before compression",
        ),
        ("files", f"{len(plan) * arrays:,}"),
        ("ledger", f"{len(plan) * driven.ledger_bytes / 1e6:,.0f} MB"),
        ("chunks per second: supervisor and ledger", short(driven.rate)),
        ("chunks per second: Dask's scheduler and client", short(dask)),
        ("workers that these keep busy", f"{min(dask, driven.rate) * chunk_seconds:,.0f}"),
    ]
    print("\n" + table([f"{cells:,} cells, 300 plate periods each", ""], rows))


if __name__ == "__main__":
    main()
