"""Scaling from one worker to two: the same sweep (strong), and twice the sweep (weak).

    python -m benchmarks.scaling [--omega 25] [--repeat 3]

The atlas, 1000 x --omega x 10 cells of `rigid`, 300 plate periods per cell, over HTTP on the embedded cluster
with warm workers, from submission to completion. For comparison, the kernel alone in one process and in two
at once. Medians over the repetitions.
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


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--omega", type=int, default=25)
    parser.add_argument("--repeat", type=int, default=3)
    arguments = parser.parse_args()
    print(describe("dask", "zarr"), flush=True)
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
