"""Reads over HTTP: how long they take, against another version of the service if its folder is given.

    git worktree add ../before COMMIT
    python -m benchmarks.queries [--against ../before] [--repeat 9] [--only json,csv] [--scale 1]

Each version is a `bounce serve` process of its own with two workers, and computes the same three sweeps: a
line of 1,000 cells with 32 flights each, one of a million flights, and an atlas of a million cells (each
`scale` times as long). Then every read is asked of the versions in turn on one connection, after a first one
that is not timed: medians, the median ratio of the two answers of a round, which holds on a busy machine too,
and the size of the answer. At last the memory of each service, with the processes that compute its answers.
"""

import random
import tempfile
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import httpx2
import numpy as np

from benchmarks.measuring import HERE, alternating, describe, options, ratio, short, table
from benchmarks.serving import TIMEOUT, Serving, used

#: Values of the atlas.
OMEGA = [round(0.05 * n, 2) for n in range(1, 101)]
XI = [0.02, 0.05, 0.1, 0.2, 0.26, 0.3, 0.5, 1.0, 2.0, 5.0]

#: What is read: of which sweep, or of none; the path below its job; {xi} is one of the atlas.
READS = {
    "json: 1,000 × 32 flights": ("line", "diagram"),
    "csv: a million flights": ("flights", "diagram?format=csv"),
    "png: a million flights": ("flights", "diagram?format=png"),
    "diagram of the atlas along gamma": ("atlas", "diagram?along=gamma&omega=1&xi={xi}"),
    "diagram of the atlas along omega": ("atlas", "diagram?along=omega&gamma=2&xi={xi}"),
    "modes: 10⁵ cells": ("atlas", "modes?xi={xi}"),
    "threshold of the atlas": ("atlas", "threshold?xi={xi}"),
    "nc: the atlas": ("atlas", "export?format=nc"),
    "parquet: the atlas": ("atlas", "export?format=parquet"),
    "orbits: a spring": (None, "/v1/orbits?omega=0.6&xi={xi}"),
}


def sweeps(scale: float) -> dict[str, dict[str, Any]]:
    """The specifications by their names in READS."""
    base = {"model": {"kind": "rigid"}, "omega": 0.5, "xi": 0.26, "settle": 20, "observe": 80, "keep": 32}

    def gamma(num: float) -> dict[str, Any]:
        return {"start": 1.0, "stop": 8.0, "num": max(2, round(scale * num))}

    return {
        "line": base | {"name": "line", "gamma": gamma(1_000)},
        "flights": base | {"name": "flights", "gamma": gamma(50_000), "keep": 20},
        "atlas": base | {"name": "atlas", "gamma": gamma(1_000), "omega": OMEGA, "xi": XI, "keep": 16},
    }


class Version:
    """The service of one checkout, with the sweeps computed."""

    def __init__(self, tree: Path, folder: Path, scale: float) -> None:
        folder.mkdir()
        self.service = Serving(folder, tree=tree)
        self.http = httpx2.Client(base_url=self.service.url, timeout=20 * TIMEOUT)
        self.jobs = {name: self.service.submit(spec) for name, spec in sweeps(scale).items()}
        for job in self.jobs.values():
            self.service.wait(job)

    def read(self, sweep: str | None, path: str, chance: random.Random) -> int:
        """The bytes of an answer."""
        place = path.format(xi=chance.choice(XI))
        answer = self.http.get(place if sweep is None else f"{self.jobs[sweep]}/{place}")
        answer.raise_for_status()
        return len(answer.content)

    def end(self) -> None:
        """Stop the service."""
        self.http.close()
        self.service.end()


def row(name: str, versions: list[Version], repeat: int) -> list[str]:
    """A row of the table; – for a read that a version does not have."""
    sizes = []
    for version in versions:
        try:
            sizes.append(version.read(*READS[name], random.Random(1)))
        except httpx2.HTTPStatusError as error:
            return [name, f"{error.response.status_code}", *["–"] * (2 * len(versions) - 1)]
    chances = [random.Random(7) for _ in versions]  # the same values for all
    runs = [
        partial(version.read, *READS[name], chance) for version, chance in zip(versions, chances, strict=True)
    ]
    times = alternating(runs, repeat, time.perf_counter)
    medians = [short(1e3 * value) for value in np.median(times, axis=0)]
    ratios = [f"{ratio(times, 1):.2f}"] if len(versions) == 2 else []
    return [name, f"{sizes[-1] / 1e3:,.0f}", *medians, *ratios]


def main() -> None:
    """Print the table."""
    given = options(__doc__, against="", repeat=9, only="", scale=1.0)
    print(describe("zarr", "fastapi"), flush=True)
    trees = [Path(given.against).resolve(), HERE] if given.against else [HERE]
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        versions = []
        for number, tree in enumerate(trees):
            versions.append(Version(tree, Path(folder) / str(number), given.scale))
            stack.callback(versions[-1].end)
        rows = []
        for name in READS:
            if any(word in name for word in given.only.split(",")):
                rows.append(row(name, versions, given.repeat))
                print(*rows[-1], sep=" | ", flush=True)
        memory = [f"{used(version.service):.0f}" for version in versions]
    names = ["before", "now"][-len(trees) :]
    head = ["", "kB", *(f"{name}, ms" for name in names), *(["ratio"] if len(trees) == 2 else [])]
    print("\n" + table(head, rows))
    print("service with the processes of its answers, MB:", " → ".join(memory))


if __name__ == "__main__":
    main()
