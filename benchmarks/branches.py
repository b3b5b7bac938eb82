"""CPU time of branches with their events, and of thresholds, beside the simulation of one sweep line.

    python -m benchmarks.branches [--repeat 9]

"branches" is (1,1) and (1,2) on 400 points with every event, "threshold" is Gamma_down with its cause; each
at 20 springs spread over Omega and xi. "line" simulates 400 cells of one such spring for 100 plate periods
each, as a sweep does. Medians over the springs of the least of the repetitions, in milliseconds of CPU time,
and as ratios to "line".
"""

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np

from benchmarks.machine import describe
from benchmarks.tables import short, table
from kernel.branches.events import branch_and_events
from kernel.branches.thresholds import thresholds
from tests.support.plates import Model, run_line

OMEGA = np.linspace(0.3, 1.6, 20)
XI = np.geomspace(0.02, 1.0, 20)[np.argsort(np.arange(20) * 7 % 20)]
PERIODS = 100


def both(omega: float, xi: float) -> None:
    """The branches (1,1) and (1,2)."""
    for periods in (1, 2):
        branch_and_events(omega, xi, periods)


def simulated(omega: float, xi: float) -> None:
    """A line of 400 cells over Gamma, from rest."""
    gamma = np.linspace(0.5, 8.0, 400)
    same = np.ones(400)
    run_line(
        gamma, omega * same, xi * same, model=Model.RIGID, restitution=0.0 * same, penetration=same,
        carry=False, settle=PERIODS // 2, observe=PERIODS - PERIODS // 2, keep=16,
    )  # fmt: skip


def milliseconds(call: Callable[[float, float], object], repeat: int) -> float:
    """The median over the springs."""
    times = []
    for omega, xi in zip(OMEGA, XI, strict=True):
        once = []
        for _ in range(repeat):
            start = time.process_time()
            call(float(omega), float(xi))
            once.append(time.process_time() - start)
        times.append(1e3 * min(once))
    return statistics.median(times)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeat", type=int, default=9)
    repeat = parser.parse_args().repeat
    simulated(0.6, 0.05)  # compiles
    rows = {"branches": both, "threshold": thresholds, "line": simulated}
    times = {name: milliseconds(call, repeat) for name, call in rows.items()}
    print(describe())
    print(
        table(
            ["", "ms", "over a line"],
            [[name, short(value), short(value / times["line"])] for name, value in times.items()],
        )
    )


if __name__ == "__main__":
    main()
