"""Fig. 2 with 1,000 values of Gamma, 300 plate periods each: time from submission to completion.

    python -m benchmarks.figure [--repeat 5] [--workers 2]

On the warm embedded cluster. Every repetition is a new job, with a slightly different grid.
"""

import argparse
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.machine import describe
from benchmarks.small import small
from service.client import Client
from service.server import embedded

MODELS: list[dict[str, Any]] = [
    {"kind": "rigid"},
    {"kind": "soft", "restitution": 0.0, "penetration": 1e-3},
    {"kind": "soft", "restitution": 0.01, "penetration": 1e-3, "adhesive": False},
]


def seconds(client: Client, model: dict[str, Any], shift: int) -> float:
    """Wall time of one job."""
    start = time.perf_counter()
    client.submit(small(model, shift)).wait(progress=False)
    return time.perf_counter() - start


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    print(describe("dask", "zarr"))
    with tempfile.TemporaryDirectory() as folder:
        settings = embedded.settings(data=Path(folder), workers=arguments.workers, host="127.0.0.1", port=0)
        with embedded.running(settings) as url, Client(url) as client:
            seconds(client, MODELS[0], -1)
            for model in MODELS:
                times = [seconds(client, model, shift) for shift in range(arguments.repeat)]
                print(f"{model}: median {statistics.median(times):.2f} s of {arguments.repeat}")


if __name__ == "__main__":
    main()
