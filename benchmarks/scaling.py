"""Scaling from one worker to two: the same sweep (strong), and twice the sweep (weak); and with the grid.

    python -m benchmarks.scaling [--omega 25] [--repeat 3]
    python -m benchmarks.scaling --grid [--workers 1,2,4] [--largest 1e7] [-o docs/scaling.png]

The atlas, 1000 x --omega x 10 cells of `rigid`, 300 plate periods per cell, over HTTP on the embedded cluster
with warm workers, from submission to completion. For comparison, the kernel alone in one process and in two
at once. Medians over the repetitions.

`--grid`: the wall time of sweeps of 10^3 to `--largest` cells on `--workers`, once each but for small
ones, as a plot and a table. More than `--largest-alone` cells, which take minutes, are computed
by two workers, and by the most, only.
"""

import argparse
import itertools
import multiprocessing
import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from benchmarks.atlas import atlas, warm
from benchmarks.measuring import alternating, describe, options, seconds, service, short, table
from service.client import Client

#: Every sweep is shifted slightly; otherwise it would be the same job.
_SHIFTS = itertools.count()

#: Thousands of cells of the sweeps of `--grid`; from SEVERAL on each is run once.
SIZES = (1, 3, 10, 30, 100, 300, 1_000, 3_000, 10_000)
SEVERAL = 100


def kernel_seconds(barrier: Any, lines: int, answers: Any) -> None:
    """The kernel alone in a process; all processes start together."""
    from benchmarks.kernel import line

    gamma = np.linspace(0.5, 6.0, 1000)
    line(gamma, 1.0, 0.1, settle=1, observe=1)
    barrier.wait()
    omegas = np.geomspace(0.1, 5.0, lines)
    answers.put(seconds(lambda: [line(gamma, float(omega), 0.1) for omega in omegas]))


def bare(processes: int, lines: int) -> float:
    """Wall time, s, of this many processes at once, each with all lines."""
    context = multiprocessing.get_context("spawn")
    barrier, answers = context.Barrier(processes), context.Queue()
    arguments = barrier, lines, answers
    started = [context.Process(target=kernel_seconds, args=arguments) for _ in range(processes)]
    for process in started:
        process.start()
    times = [answers.get(timeout=600) for _ in started]
    for process in started:
        process.join()
    return max(times)


def sweep_seconds(client: Client, omega: int, xi: int = 10) -> float:
    """Wall time of one sweep of 1000 x omega x xi cells, from submission to completion, s; it is deleted."""
    spec = atlas(1000, max(2, omega), max(2, xi))
    spec |= {"omega": 1.0} if omega == 1 else {}
    spec |= {"xi": 0.1} if xi == 1 else {}
    spec["gamma"] |= {"start": spec["gamma"]["start"] + 1e-9 * next(_SHIFTS)}
    start = time.perf_counter()
    job = client.submit(spec).wait(progress=False)
    took = time.perf_counter() - start
    job.delete()
    return took


@contextmanager
def warmed(workers: int) -> Iterator[Client]:
    """The client of a service whose workers, this many, have computed something."""
    with service(workers=workers) as (client, _, _):
        warm(client)
        sweep_seconds(client, 2)
        yield client


def grid_seconds(workers: int, sizes: list[int]) -> list[float]:
    """Wall times, s, of sweeps of these thousands of cells on this many workers."""
    with warmed(workers) as client:
        grids = [(size // 10, 10) if size >= SEVERAL else (size, 1) for size in sizes]
        return [
            statistics.median(sweep_seconds(client, *grid) for _ in range(3 if grid[1] == 1 else 1))
            for grid in grids
        ]


def draw(curves: dict[int, list[tuple[int, float]]], file: str) -> None:
    """Draw wall time per cell and plate period, and throughput over that of one worker, against the cells."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.6), layout="constrained")
    cost, gain = figure.subplots(1, 2)
    alone = dict(curves.get(1, []))
    for workers, curve in curves.items():
        label = "1 worker" if workers == 1 else f"{workers} workers"
        cells = [1000 * size for size, _ in curve]
        cost.loglog(
            cells, [t / n / 300 * 1e6 for n, (_, t) in zip(cells, curve, strict=True)], "o-", label=label
        )
        shared = [(1000 * size, alone[size] / t) for size, t in curve if size in alone]
        if workers > 1 and shared:
            gain.semilogx(*zip(*shared, strict=True), "o-", label=label)
    cost.set_ylabel("wall time, µs per cell and plate period")
    cost.set_yticks([0.05, 0.1, 0.2, 0.5, 1.0], ["0.05", "0.1", "0.2", "0.5", "1"])
    cost.minorticks_off()
    cost.set_ylim(0.05, 1.0)
    gain.set_ylabel("times as fast as one worker")
    gain.set_ylim(bottom=0.0)
    for panel in (cost, gain):
        panel.set_xlabel("cells")
        panel.grid(alpha=0.3)
        panel.legend(frameon=False)
    figure.savefig(file, dpi=110)


def grid(arguments: argparse.Namespace) -> None:
    """The table and the plot of `--grid`."""
    sizes = [size for size in SIZES if size * 1000 <= arguments.largest]
    curves: dict[int, list[tuple[int, float]]] = {}
    rows = []
    counts = [int(text) for text in arguments.workers.split(",")]
    for workers in counts:
        largest = arguments.largest if workers in (2, max(counts)) else arguments.largest_alone
        mine = [size for size in sizes if size * 1000 <= largest]
        curves[workers] = list(zip(mine, grid_seconds(workers, mine), strict=True))
        for size, took in curves[workers]:
            rows.append((f"{workers}", f"{1000 * size:,}", short(took), short(took / size / 0.3)))
            print(*rows[-1], flush=True)
    print("\n" + table(["workers", "cells", "wall time, s", "µs per cell and plate period"], rows))
    draw(curves, arguments.output)
    print(f"\n{arguments.output}")


def main() -> None:
    """Print the table."""
    given = options(
        __doc__, omega=25, repeat=3, grid=False, workers="1,2,4", largest=1e7, largest_alone=1e6,
        output="docs/scaling.png",
    )  # fmt: skip
    print(describe("dask", "zarr"), flush=True)
    if given.grid:
        grid(given)
        return
    median, size = statistics.median, given.omega
    kernel = [median(bare(n, size) for _ in range(given.repeat)) for n in (1, 2)]
    with warmed(1) as client:
        one = median(sweep_seconds(client, size) for _ in range(given.repeat))
    with warmed(2) as client:
        runs = [lambda n=n: sweep_seconds(client, n) for n in (size, 2 * size)]
        two, double = np.median(alternating(runs, given.repeat, time.perf_counter), axis=0)
    rows = [
        (f"strong: {size * 10_000:,} cells", one, two, one / two),
        ("weak: the same for each worker", one, double, 2 * one / double),
        ("the kernel alone, the same for each process", *kernel, 2 * kernel[0] / kernel[1]),
    ]
    shown = [(name, *map(short, values)) for name, *values in rows]
    print("\n" + table(["", "one, s", "two, s", "speed-up"], shown))


if __name__ == "__main__":
    main()
