"""How long a process takes to have every kernel compiled: with a fresh cache, and with a warm one.

    python -m benchmarks.compiling [--repeat 3] [--fresh 1]

Each start is a process of its own with `worker.kernel_cache.warm`, as in a worker: wall and processor time
from its first instruction, imports included, until every contact model's kernels are ready.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile

from benchmarks.machine import describe
from benchmarks.tables import short, table

_START = """
import json, resource, sys, time
began = time.perf_counter()
from worker.kernel_cache import use_cache
use_cache(sys.argv[1])
used = resource.getrusage(resource.RUSAGE_SELF)
print(json.dumps([time.perf_counter() - began, used.ru_utime + used.ru_stime]))
"""


def start(root: str) -> tuple[float, float]:
    """Wall and processor seconds of a process that starts with the caches in `root`."""
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-c", _START, root], env=environment, capture_output=True, text=True, check=True
    )
    wall, processor = json.loads(done.stdout)
    return wall, processor


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=3, help="starts with a warm cache")
    parser.add_argument("--fresh", type=int, default=1, help="starts with a fresh cache")
    arguments = parser.parse_args()
    print(describe(), flush=True)
    times: dict[str, list[tuple[float, float]]] = {"fresh cache": [], "warm cache": []}
    for _ in range(arguments.fresh):
        with tempfile.TemporaryDirectory() as root:
            times["fresh cache"].append(start(root))
            times["warm cache"] += [start(root) for _ in range(arguments.repeat)]
    rows = [
        (name, *(short(statistics.median(each)) for each in zip(*starts, strict=True)))
        for name, starts in times.items()
    ]
    print("\n" + table(["", "wall time, s", "processor time, s"], rows))


if __name__ == "__main__":
    main()
