"""Cost of polling for a running job, and latency of the polls, with 8 and 64 connections.

    python -m benchmarks.polling [--repeat 5] [--pause 1.0] [--seconds 10]

Runs `bounce serve` with two workers and repeats one sweep, without and with polls in alternation. Every
connection repeats its request `pause` seconds after the response; the Python client, and any client that
follows Retry-After, waits 1 to 10 s. Exits with 1 if a promise is broken: a response 5xx, the 99th percentile
above 250 ms (8 connections) or 750 ms (64), or a job more than 15% slower (medians).
"""

import argparse
import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.machine import describe
from benchmarks.serving import Polls, Serving, sweep

#: Limit on the 99th percentile of the latency, s, by the number of connections.
P99 = {8: 0.250, 64: 0.750}
SLOWER = 1.15


class Figures:
    """Measurements with one number of connections."""

    def __init__(self) -> None:
        self.took: list[float] = []
        self.answers: list[float] = []
        self.wrong: list[str] = []


def run(service: Serving, settle: int, connections: int, pause: float, figures: Figures) -> None:
    """Time one job from submission to completion, polled by so many connections."""
    began = time.perf_counter()
    path = service.submit(sweep(0, settle=settle))
    with Polls(service.port, path, connections, pause) as polls:
        service.wait(path)
        figures.took.append(time.perf_counter() - began)
    figures.answers += polls.seconds
    figures.wrong += polls.wrong
    service.delete(path)


def calibrated(service: Serving, seconds: float) -> int:
    """Settling periods with which the sweep takes about `seconds`."""
    run(service, 1_000, 0, 1.0, Figures())
    run(service, 20_000, 0, 1.0, figures := Figures())
    return int(20_000 * seconds / figures.took[0])


def report(figures: dict[int, Figures]) -> int:
    """Print the figures; return 1 if a promise is broken."""
    alone, broken = statistics.median(figures[0].took), 0
    print(f"alone: {alone:.2f} s ({min(figures[0].took):.2f} to {max(figures[0].took):.2f})")
    for connections, limit in P99.items():
        polled = figures[connections]
        p99, slower = float(np.percentile(polled.answers, 99)), statistics.median(polled.took) / alone
        print(
            f"{connections} connections: {statistics.median(polled.took):.2f} s, {slower - 1:+.1%}; "
            f"{len(polled.answers) / sum(polled.took):.0f} responses/s, p99 {1e3 * p99:.0f} ms, "
            f"{len(polled.wrong)} errors {polled.wrong[:3]}"
        )
        broken |= bool(polled.wrong) or p99 > limit or slower > SLOWER
    return int(broken)


def main() -> int:
    """Print the figures."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--repeat", type=int, default=5)
    options.add_argument("--pause", type=float, default=1.0, help="seconds")
    options.add_argument("--seconds", type=float, default=10.0, help="approximate time of the job alone")
    arguments = options.parse_args()
    print(describe("fastapi", "uvicorn"))
    figures = {connections: Figures() for connections in (0, *P99)}
    with tempfile.TemporaryDirectory() as folder:
        service = Serving(Path(folder))
        try:
            settle = calibrated(service, arguments.seconds)
            for _ in range(arguments.repeat):
                for connections, measured in figures.items():
                    run(service, settle, connections, arguments.pause, measured)
        finally:
            service.end()
    return report(figures)


if __name__ == "__main__":
    sys.exit(main())
