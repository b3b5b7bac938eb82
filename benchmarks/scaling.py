"""Scaling from one worker to two: the same sweep (strong), and twice the sweep (weak); and with the grid.

    python -m benchmarks.scaling [--omega 25] [--repeat 3]
    python -m benchmarks.scaling --grid [--workers 1,2,4] [--largest 1e7] [-o docs/scaling.png]

The atlas, 1000 x --omega x 10 cells of `rigid`, 300 plate periods per cell, over HTTP on the embedded cluster
with warm workers, from submission to completion. For comparison, the kernel alone in one process and in two
at once. Medians over the repetitions.

`--grid`: the wall time of sweeps of 10^3 to `--largest` cells on so many workers, once each but for small
ones, as a plot and a table. More than `--largest-alone` cells, which take minutes, are computed
by two workers only.
"""

import argparse
import itertools
import multiprocessing
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.atlas import atlas, warm
from benchmarks.machine import describe
from benchmarks.tables import short, table
from service.client import Client
from service.server import embedded

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
    start = time.perf_counter()
    for omega in np.geomspace(0.1, 5.0, lines):
        line(gamma, float(omega), 0.1)
    answers.put(time.perf_counter() - start)


def bare(processes: int, lines: int) -> float:
    """Wall time, s, of so many processes at once, each with all lines."""
    context = multiprocessing.get_context("spawn")
    barrier, answers = context.Barrier(processes), context.Queue()
    started = [
        context.Process(target=kernel_seconds, args=(barrier, lines, answers)) for _ in range(processes)
    ]
    for process in started:
        process.start()
    times = [answers.get(timeout=600) for _ in started]
    for process in started:
        process.join()
    return max(times)


def sweep_seconds(client: Client, omega: int) -> float:
    """Wall time of one sweep from submission to completion, s."""
    spec = atlas(1000, omega, 10)
    gamma = spec["gamma"] | {"start": spec["gamma"]["start"] + 1e-9 * next(_SHIFTS)}
    start = time.perf_counter()
    client.submit(spec | {"gamma": gamma}).wait(progress=False)
    return time.perf_counter() - start


def service_seconds(workers: int, sizes: list[int], repeat: int) -> list[list[float]]:
    """Times of sweeps of these sizes on so many workers, s; the sizes alternate."""
    with tempfile.TemporaryDirectory() as folder:
        settings = embedded.settings(data=Path(folder), workers=workers, host="127.0.0.1", port=0)
        with embedded.running(settings) as url, Client(url) as client:
            warm(client)
            sweep_seconds(client, 2)
            rounds = [[sweep_seconds(client, size) for size in sizes] for _ in range(repeat)]
    return [list(times) for times in zip(*rounds, strict=True)]


def grid_seconds(workers: int, sizes: list[int]) -> list[float]:
    """Wall times of sweeps of so many thousand cells each on so many workers, s."""
    with tempfile.TemporaryDirectory() as folder:
        settings = embedded.settings(data=Path(folder), workers=workers, host="127.0.0.1", port=0)
        with embedded.running(settings) as url, Client(url) as client:
            warm(client)
            sweep_seconds(client, 2)
            return [
                statistics.median(grid_sweep(client, size) for _ in range(3 if size < SEVERAL else 1))
                for size in sizes
            ]


def grid_sweep(client: Client, thousands: int) -> float:
    """Wall time of one sweep of so many thousand cells, from submission to completion, s; it is deleted."""
    xi = 10 if thousands >= 100 else 1
    spec = atlas(1000, max(2, thousands // xi), max(2, xi))
    spec |= {"omega": 1.0} if thousands < 2 else {}
    spec |= {"xi": 0.1} if xi == 1 else {}
    spec["gamma"] |= {"start": spec["gamma"]["start"] + 1e-9 * next(_SHIFTS)}
    start = time.perf_counter()
    job = client.submit(spec).wait(progress=False)
    took = time.perf_counter() - start
    job.delete()
    return took


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
    for workers in map(int, arguments.workers.split(",")):
        mine = [size for size in sizes if workers == 2 or size * 1000 <= arguments.largest_alone]
        curves[workers] = list(zip(mine, grid_seconds(workers, mine), strict=True))
        for size, seconds in curves[workers]:
            rows.append((f"{workers}", f"{1000 * size:,}", short(seconds), short(seconds / size / 0.3)))
            print(*rows[-1], flush=True)
    print("\n" + table(["workers", "cells", "wall time, s", "µs per cell and plate period"], rows))
    draw(curves, arguments.output)
    print(f"\n{arguments.output}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--omega", type=int, default=25)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--grid", action="store_true")
    parser.add_argument("--workers", default="1,2,4")
    parser.add_argument("--largest", type=float, default=1e7)
    parser.add_argument("--largest-alone", type=float, default=1e6)
    parser.add_argument("-o", "--output", default="docs/scaling.png")
    arguments = parser.parse_args()
    print(describe("dask", "zarr"), flush=True)
    if arguments.grid:
        grid(arguments)
        return
    median = statistics.median
    kernel = [median(bare(n, arguments.omega) for _ in range(arguments.repeat)) for n in (1, 2)]
    (one,) = service_seconds(1, [arguments.omega], arguments.repeat)
    two, double = service_seconds(2, [arguments.omega, 2 * arguments.omega], arguments.repeat)
    cells = f"{arguments.omega * 10_000:,} cells"
    rows = [
        ("strong: " + cells, median(one), median(two), median(one) / median(two)),
        ("weak: the same for each worker", median(one), median(double), 2 * median(one) / median(double)),
        ("the kernel alone, the same for each process", *kernel, 2 * kernel[0] / kernel[1]),
    ]
    head = ["", "one, s", "two, s", "speed-up"]
    print("\n" + table(head, [(name, *(short(value) for value in values)) for name, *values in rows]))


if __name__ == "__main__":
    main()
