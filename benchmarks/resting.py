"""Cost of cells at rest on the plate, which have a closed form, and of bouncing cells.

    python -m benchmarks.resting [--cells 200] [--repeat 5]

Omega = 0.6, xi = 0.05; Gamma from 0.1 to 0.99 and from 1.1 to 2 times the threshold of Eq. 25 (1 for the
ball); on an up ramp and from rest; windows of 300 and of 3,000 plate periods. Core-microseconds per cell, the
fastest of several runs. The cost at rest does not depend on the window.
"""

import argparse
import time

import numpy as np

from benchmarks.machine import describe
from kernel.params import Line, Outcome
from kernel.threshold import threshold
from tests.support.plates import Model, run_line

OMEGA, XI = 0.6, 0.05
PERIODS = (300, 3000)


def run(model: Model, gamma: np.ndarray, carry: bool, periods: int) -> Line:
    full = np.full_like
    return run_line(
        gamma, full(gamma, OMEGA), full(gamma, XI), model=model, restitution=full(gamma, 0.01),
        penetration=full(gamma, 1e-3), adhesive=True, carry=carry, settle=periods * 2 // 3,
        observe=periods - periods * 2 // 3, keep=64,
    )  # fmt: skip


def cost(model: Model, gamma: np.ndarray, carry: bool, periods: int, repeat: int) -> tuple[float, float]:
    """Core-microseconds per cell, and the share of cells at rest."""
    run(model, gamma[:1], carry, 3)  # compiles
    fastest = np.inf
    for _ in range(repeat):
        began = time.thread_time()
        line = run(model, gamma, carry, periods)
        fastest = min(fastest, time.thread_time() - began)
    return fastest / len(gamma) * 1e6, float(np.mean(line.outcome == Outcome.AT_REST))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--cells", type=int, default=200)
    parser.add_argument("--repeat", type=int, default=5)
    arguments = parser.parse_args()
    print(describe())
    heads = [f"{state}, {periods} periods" for state in ("resting", "bouncing") for periods in PERIODS]
    print("\ncore-us per cell" + " " * 8 + "".join(f"{head:>24}" for head in heads))
    for model in (Model.BALL, Model.RIGID, Model.SOFT):
        onset = 1.0 if model == Model.BALL else float(threshold(OMEGA, XI))
        for carry in (True, False):
            columns = []
            for low, high in ((0.1, 0.99), (1.1, 2.0)):
                gamma = onset * np.linspace(low, high, arguments.cells)
                for periods in PERIODS:
                    spent, resting = cost(model, gamma, carry, periods, arguments.repeat)
                    columns.append(f"{spent:10.2f} ({resting:4.0%} at rest)")
            name = f"{model.name.lower()}, {'up ramp' if carry else 'from rest'}"
            print(f"{name:24}" + "".join(f"{text:>24}" for text in columns))


if __name__ == "__main__":
    main()
