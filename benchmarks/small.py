"""A small job: time from the submission of 1,000 cells to their complete diagram, on warm workers.

    python -m benchmarks.small [--repeat 9] [--workers 2] [--alone]

Over HTTP on the embedded cluster: when it is idle, and (unless --alone) while a sweep of ten million cells
occupies every worker. Every repetition is a new job, with a slightly different grid.
"""

import argparse
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.atlas import atlas
from benchmarks.machine import describe
from service.client import Client
from service.server import embedded

MODELS: dict[str, dict[str, Any]] = {
    "rigid": {"kind": "rigid"},
    "soft, e = 0.01, d = 1e-3": {"kind": "soft", "restitution": 0.01, "penetration": 1e-3},
}


def small(model: dict[str, Any], shift: int) -> dict[str, Any]:
    """The specification; 300 plate periods per cell."""
    return {
        "name": f"small {shift}",
        "gamma": {"start": 1.0 + shift * 1e-6, "stop": 6.0, "num": 1000},
        "omega": 0.5,
        "xi": 0.26,
        "model": model,
        "settle": 200,
        "observe": 100,
    }


def seconds(client: Client, spec: dict[str, Any]) -> float:
    """Wall time from submission to a complete diagram, s."""
    start = time.perf_counter()
    diagram = client.submit(spec).wait(progress=False).diagram(along="gamma")
    assert diagram.attrs["complete"]
    return time.perf_counter() - start


def table(client: Client, repeat: int, first: int) -> None:
    """Time every model `repeat` times and print the rows; shifts of the grids start at `first`."""
    for name, model in MODELS.items():
        times = sorted(seconds(client, small(model, first + shift)) for shift in range(repeat))
        low, high = statistics.median(times), times[-1]
        print(f"{name:28}{low:10.2f}{high:10.2f}{repeat:10d}")


def main() -> None:
    """Run the benchmark and print the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=9)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--alone", action="store_true", help="only on the idle cluster")
    arguments = parser.parse_args()
    print(describe("dask", "zarr"))
    with tempfile.TemporaryDirectory() as folder:
        settings = embedded.settings(data=Path(folder), workers=arguments.workers, host="127.0.0.1", port=0)
        with embedded.running(settings) as url, Client(url) as client:
            for shift in range(1, 1 + 2 * arguments.workers):
                seconds(client, small(MODELS["rigid"], -shift))
            print(f"{'1,000 cells':28}{'median, s':>10}{'max, s':>10}{'jobs':>10}")
            table(client, arguments.repeat, 0)
            if arguments.alone:
                return
            large = client.submit(atlas(1000, 1000, 10))
            while not large.refresh().progress.chunks_done:
                time.sleep(0.1)
            print("beside ten million cells")
            table(client, arguments.repeat, arguments.repeat)
            large.cancel()


if __name__ == "__main__":
    main()
