"""A small job: time from the submission of Fig. 2 with 1,000 values of Gamma to its diagram, on warm workers.

    python -m benchmarks.small [--repeat 9] [--workers 2] [--alone]

300 plate periods a cell, over HTTP on the embedded cluster: when it is idle, and (unless --alone) while a
sweep of ten million cells occupies every worker. Every repetition is a new job, with a slightly different
grid. Done is the job when its client knows, complete the diagram when it has been read.
"""

import itertools
import time
from typing import Any

import numpy as np

from benchmarks.atlas import atlas
from benchmarks.measuring import describe, options, service, short, table
from service.client import Client

MODELS: dict[str, dict[str, Any]] = {
    "rigid": {"kind": "rigid"},
    "soft, e = 0": {"kind": "soft", "restitution": 0.0, "penetration": 1e-3},
    "soft, e = 0.01": {"kind": "soft", "restitution": 0.01, "penetration": 1e-3},
    "soft, e = 0.01, nonadhesive": {
        "kind": "soft", "restitution": 0.01, "penetration": 1e-3, "adhesive": False,
    },
}  # fmt: skip
SHIFTS = itertools.count()


def small(model: dict[str, Any]) -> dict[str, Any]:
    """A specification that nobody has submitted yet."""
    shift = next(SHIFTS)
    return {
        "name": f"small {shift}",
        "gamma": {"start": 1.0 + shift * 1e-6, "stop": 6.0, "num": 1000},
        "omega": 0.5,
        "xi": 0.26,
        "model": model,
        "settle": 200,
        "observe": 100,
    }


def times(client: Client, model: dict[str, Any]) -> tuple[float, float]:
    """Wall time from submission until a job is done, and until its diagram is complete, s."""
    start = time.perf_counter()
    job = client.submit(small(model)).wait(progress=False)
    done = time.perf_counter() - start
    assert job.diagram(along="gamma").attrs["complete"]
    return done, time.perf_counter() - start


def rows(client: Client, repeat: int, where: str) -> list[list[str]]:
    """A row for each model."""
    shown = []
    for name, model in MODELS.items():
        done, drawn = np.array([times(client, model) for _ in range(repeat)]).T
        numbers = np.median(done), done.max(), np.median(drawn), drawn.max()
        shown.append([f"{name}, {where}", *map(short, numbers)])
    return shown


def main() -> None:
    """Print the table."""
    given = options(__doc__, repeat=9, workers=2, alone=False)
    print(describe("dask", "zarr"), flush=True)
    with service(workers=given.workers) as (client, _, _):
        for _ in range(2 * given.workers):
            times(client, MODELS["rigid"])
        shown = rows(client, given.repeat, "idle")
        if not given.alone:
            large = client.submit(atlas(1000, 1000, 10))
            while not large.refresh().progress.chunks_done:
                time.sleep(0.1)
            shown += rows(client, given.repeat, "beside ten million cells")
            large.cancel()
    head = ["1,000 cells", "done, s", "at most, s", "diagram, s", "at most, s"]
    print("\n" + table(head, shown))


if __name__ == "__main__":
    main()
