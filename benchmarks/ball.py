"""CPU time of `ball` and `rigid` per cell per plate period, over the sweeps of Figs. 3 and 4.

    python -m benchmarks.ball [--repeat 9] [--settle 200]

1,000 values of Gamma from 1 to 6, 300 plate periods each from rest; `rigid` is the spring of rigidity 650
that the ball approximates. Medians over the repetitions, which alternate between the rows.
"""

import argparse
import statistics
import time

import numpy as np

from benchmarks.machine import describe
from kernel.params import Line
from kernel.restitution import restitution_of
from tests.support.plates import Model, run_line

PERIODS = 300
GAMMAS = np.linspace(1.0, 6.0, 1000)

#: Name, model, xi, restitution.
ROWS = [
    ("ball, e = 0 (Fig. 3)", Model.BALL, 10.0, 0.0),
    ("ball, e = 0.15 (Fig. 4)", Model.BALL, 0.5, 0.15),
    ("ball, e = f(0.26)", Model.BALL, 0.26, float(restitution_of(0.26))),
    ("ball, e = 0.5", Model.BALL, 0.0, 0.5),
    ("rigid, xi = 10 (Fig. 3)", Model.RIGID, 10.0, 0.0),
    ("rigid, xi = 0.5 (Fig. 4)", Model.RIGID, 0.5, 0.0),
]


def run(settle: int, model: Model, xi: float, restitution: float) -> Line:
    """Compute the sweep at rigidity 650, which does not affect the ball."""
    full = np.full_like
    return run_line(
        GAMMAS, full(GAMMAS, max(xi, 1e-3) / 650.0), full(GAMMAS, xi), model=model,
        restitution=full(GAMMAS, restitution), penetration=full(GAMMAS, 1e-3), adhesive=True, carry=False,
        settle=settle, observe=PERIODS - settle, keep=64,
    )  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=9)
    parser.add_argument("--settle", type=int, default=200, help="plate periods of the 300")
    arguments = parser.parse_args()
    settle = arguments.settle
    print(describe())
    print(f"\n{'':28}{'us per plate period':>20}{'flights per period':>20}")
    flights = [run(settle, *row[1:]).flights.mean() / (PERIODS - settle) for row in ROWS]
    times: list[list[float]] = [[] for _ in ROWS]
    for _ in range(arguments.repeat):
        for row, each in zip(ROWS, times, strict=True):
            start = time.process_time()
            run(settle, *row[1:])
            each.append((time.process_time() - start) / (len(GAMMAS) * PERIODS) * 1e6)
    for row, each, count in zip(ROWS, times, flights, strict=True):
        print(f"{row[0]:28}{statistics.median(each):20.3f}{count:20.2f}")


if __name__ == "__main__":
    main()
