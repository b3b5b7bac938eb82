"""What polling costs a running job, and how long those who poll wait: 8 and 64 connections, and none.

    python -m benchmarks.polling [--repeat 5] [--pause 1.0] [--seconds 10]

A real `bounce serve` with two workers; the same sweep again and again, alone and polled in turn. Every
connection asks again `pause` seconds after its answer; the Python client, and whoever heeds Retry-After,
does so after 1 to 10 s. Exits with 1 if a promise is missed: an answer 5xx, the 99th
percentile above 250 ms (8 connections) or 750 ms (64), a job more than 15 % slower (medians).
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

#: Connections, and seconds that 99 of 100 answers may take.
P99 = {8: 0.250, 64: 0.750}
SLOWER = 1.15


class Figures:
    """What was measured with so many connections."""

    def __init__(self) -> None:
        self.took: list[float] = []
        self.answers: list[float] = []
        self.wrong: list[str] = []


def run(service: Serving, settle: int, connections: int, pause: float, figures: Figures) -> None:
    """One job from submission to done, polled by so many."""
    began = time.perf_counter()
    path = service.submit(sweep(0, settle=settle))
    with Polls(service.port, path, connections, pause) as polls:
        service.wait(path)
        figures.took.append(time.perf_counter() - began)
    figures.answers += polls.seconds
    figures.wrong += polls.wrong
    service.delete(path)


def calibrated(service: Serving, seconds: float) -> int:
    """Plate periods with which the sweep takes about so long."""
    run(service, 1_000, 0, 1.0, Figures())
    run(service, 20_000, 0, 1.0, figures := Figures())
    return int(20_000 * seconds / figures.took[0])


def told(figures: dict[int, Figures]) -> int:
    """Print the table; 1 if something is missed."""
    alone, missed = statistics.median(figures[0].took), 0
    print(f"alone: {alone:.2f} s ({min(figures[0].took):.2f} to {max(figures[0].took):.2f})")
    for connections, limit in P99.items():
        found = figures[connections]
        p99, slower = float(np.percentile(found.answers, 99)), statistics.median(found.took) / alone
        print(
            f"{connections} connections: {statistics.median(found.took):.2f} s, {slower - 1:+.1%}; "
            f"{len(found.answers) / sum(found.took):.0f} answers/s, p99 {1e3 * p99:.0f} ms, "
            f"wrong {len(found.wrong)} {found.wrong[:3]}"
        )
        missed |= bool(found.wrong) or p99 > limit or slower > SLOWER
    return int(missed)


def main() -> int:
    """Print the figures."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--repeat", type=int, default=5)
    options.add_argument("--pause", type=float, default=1.0, help="seconds")
    options.add_argument("--seconds", type=float, default=10.0, help="that the job takes alone, about")
    given = options.parse_args()
    print(describe("fastapi", "uvicorn"))
    figures = {connections: Figures() for connections in (0, *P99)}
    with tempfile.TemporaryDirectory() as folder:
        service = Serving(Path(folder))
        try:
            settle = calibrated(service, given.seconds)
            for _ in range(given.repeat):
                for connections, found in figures.items():
                    run(service, settle, connections, given.pause, found)
        finally:
            service.end()
    return told(figures)


if __name__ == "__main__":
    sys.exit(main())
