"""Sweeps over HTTP on two workers, in multiples of heyoka's kernel, next to another checkout if given.

    python -m benchmarks.rest [--against ../before] [--repeat 3] [--only soft] [--scale 1]

Each version is a `bounce serve` process of its own with two workers, and computes the same sweeps in turn:
the ranges of `benchmarks.atlas`, 200 + 100 plate periods, every cycle. In between, heyoka solves rigid
springs on one core in batch mode (`benchmarks.kernel`). Prints the microseconds per cell and plate period,
from submission until the job is done, and how many times as long heyoka takes: medians of the rounds.
"""

import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.heyoka_rival import BatchSpring
from benchmarks.kernel import CELLS, PERIODS
from benchmarks.measuring import HERE, alternating, describe, options, short, table
from benchmarks.serving import Serving
from worker.sweep import SweepSpec

RIGID = {"kind": "rigid", "restitution": 0.0}
SOFT = {"kind": "soft", "restitution": 0.01, "penetration": 1e-3, "adhesive": True}
RAMP = {"kind": "ramp", "axis": "gamma", "direction": "both"}

#: Model, protocol, and values of Gamma, Omega and xi.
SWEEPS: dict[str, tuple[dict[str, Any], dict[str, Any], tuple[int, int, int]]] = {
    "rigid": (RIGID, {"kind": "rest"}, (200, 40, 20)),
    "rigid ramp": (RIGID, RAMP, (200, 16, 8)),
    "soft": (SOFT, {"kind": "rest"}, (100, 32, 16)),
    "soft ramp": (SOFT, RAMP, (100, 16, 8)),
    "rigid, e = 0.3": (RIGID | {"restitution": 0.3}, {"kind": "rest"}, (100, 32, 16)),
}


def sweep(name: str, scale: float, number: int = 0) -> dict[str, Any]:
    """A specification of one of SWEEPS, with `scale` times as many Gamma; another for each number."""
    model, protocol, (gamma, omega, xi) = SWEEPS[name]
    return {
        "name": name, "model": model, "protocol": protocol,
        "settle": 200, "observe": PERIODS - 200, "keep": 16,
        "gamma": {"start": 0.5, "stop": 6.0 + 1e-9 * number, "num": max(2, round(scale * gamma))},
        "omega": {"start": 0.1, "stop": 5.0, "num": omega, "spacing": "log"},
        "xi": {"start": 0.02, "stop": 5.0, "num": xi, "spacing": "log"},
    }  # fmt: skip


def compute(service: Serving, name: str, scale: float, numbers: Iterator[int]) -> None:
    """Submit a job and wait until it is done."""
    service.wait(service.submit(sweep(name, scale, next(numbers))))


def main() -> None:
    """Print the table."""
    given = options(__doc__, against="", repeat=3, only="", scale=1.0)
    print(describe("heyoka", "dask", "zarr"), flush=True)
    trees = [Path(given.against).resolve(), HERE] if given.against else [HERE]
    batch = BatchSpring()

    def heyoka() -> None:
        for gamma, omega, xi in CELLS:
            batch.run(gamma * np.linspace(0.99, 1.01, batch.cells), omega, xi, PERIODS)

    rows = []
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        services = []
        for number, tree in enumerate(trees):
            (own := Path(folder) / str(number)).mkdir()
            services.append(stack.enter_context(Serving(own, "--workers", "2", tree=tree)))
        for name in SWEEPS:
            if not any(word in name for word in given.only.split(",")):
                continue
            for service in services:
                compute(service, name, 0.02, count())  # compiles
            runs = [heyoka, *(partial(compute, each, name, given.scale, count()) for each in services)]
            times = alternating(runs, given.repeat, time.perf_counter)
            units = np.prod(SweepSpec.parse(sweep(name, given.scale)).shape) * PERIODS
            times /= [len(CELLS) * batch.cells * PERIODS, *[units] * len(services)]
            costs, multiples = np.median(times, axis=0) * 1e6, np.median(times[:, :1] / times, axis=0)
            rows.append([name, *map(short, (*costs, *multiples[1:]))])
            print(*rows[-1], sep=" | ", flush=True)
    names = ["before", "now"][-len(trees) :]
    head = ["", "heyoka, µs", *(f"{name}, µs" for name in names), *(f"{name}, multiple" for name in names)]
    print("\n" + table(head, rows))


if __name__ == "__main__":
    main()
