"""CPU time per cell and plate period of each contact model, beside heyoka's Taylor integrator.

    python -m benchmarks.kernel [--repeat 7] [--no-rival]

Cells are those of the paper's figures (Fig. 2, and Omega = 0.67, 1, 1.24 at xi = 0.05), 300 plate
periods each from rest. "neighbours" runs 64 cells within 1% of Gamma in one line, which is how a
sweep runs them; "alone" runs one cell through the scalar functions. Every figure is the median
over the cells of the median over repetitions, and the ratios come from the same run.
"""

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np

from benchmarks.machine import describe
from kernel.params import Line, Model
from kernel.ramp import run_line

PERIODS = 300
NEIGHBOURS = 64

#: (Gamma, Omega, xi)
CELLS = [
    (1.5, 0.5, 0.26),
    (2.3, 0.5, 0.26),
    (3.6, 0.5, 0.26),
    (5.0, 0.5, 0.26),
    (1.5, 0.67, 0.05),
    (3.0, 0.67, 0.05),
    (0.5, 1.0, 0.05),
    (2.0, 1.0, 0.05),
    (3.0, 1.0, 0.05),
    (2.0, 1.24, 0.05),
    (3.0, 1.24, 0.05),
]


def line(
    gamma: np.ndarray,
    omega: float,
    xi: float,
    model: Model,
    *,
    e: float,
    d: float,
    adhesive: bool,
    alone: bool,
) -> Line:
    """A line of cells from rest; a single cell `alone` runs as a ramp of one."""
    full = np.full_like
    return run_line(
        gamma, full(gamma, omega), full(gamma, xi), model=model, restitution=full(gamma, e),
        penetration=full(gamma, d), adhesive=adhesive, carry=alone,
        settle=200, observe=PERIODS - 200, keep=64,
    )  # fmt: skip


def microseconds(run: Callable[[], object], cells: int, repeat: int) -> float:
    """Median CPU microseconds per cell and plate period."""
    run()
    times = []
    for _ in range(repeat):
        start = time.process_time()
        run()
        times.append(time.process_time() - start)
    return statistics.median(times) / cells / PERIODS * 1e6


def once(run: Callable[[], object], periods: int) -> float:
    """CPU microseconds per plate period of a run too slow to repeat."""
    start = time.process_time()
    run()
    return (time.process_time() - start) / periods * 1e6


def kernel_cost(model: Model, repeat: int, *, e: float, d: float, adhesive: bool, alone: bool) -> float:
    """Median over CELLS."""
    costs = []
    for gamma, omega, xi in CELLS:
        spread = np.array([gamma]) if alone else gamma * np.linspace(0.99, 1.01, NEIGHBOURS)

        def run(g: np.ndarray = spread, o: float = omega, x: float = xi) -> Line:
            return line(g, o, x, model, e=e, d=d, adhesive=adhesive, alone=alone)

        costs.append(microseconds(run, len(spread), repeat))
    return statistics.median(costs)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=7)
    parser.add_argument("--no-rival", action="store_true", help="leave heyoka out")
    arguments = parser.parse_args()
    print(describe())
    rows = [
        (
            "rigid, neighbours",
            kernel_cost(Model.RIGID, arguments.repeat, e=0, d=1e-3, adhesive=True, alone=False),
        )
    ]
    rows.append(
        ("rigid, alone", kernel_cost(Model.RIGID, arguments.repeat, e=0, d=1e-3, adhesive=True, alone=True))
    )
    for adhesive in (True, False):
        for d in (1e-3, 1e-6):
            cost = kernel_cost(Model.SOFT, arguments.repeat, e=0.01, d=d, adhesive=adhesive, alone=False)
            rows.append((f"soft, {'adhesive' if adhesive else 'nonadhesive'}, e = 0.01, d = {d:g}", cost))
    stepped = [
        microseconds(
            lambda c=c: line(
                np.array([c[0]]), c[1], c[2], Model.STEPPED, e=0.01, d=1e-3, adhesive=True, alone=False
            ),
            1,
            1,
        )
        for c in CELLS
    ]
    rows.append(("stepped, the paper's method, d = 0.001", statistics.median(stepped)))
    if not arguments.no_rival:
        from benchmarks import scipy_rival
        from benchmarks.heyoka_rival import Spring

        spring = Spring()
        costs = [microseconds(lambda c=c: spring.run(*c, PERIODS), 1, arguments.repeat) for c in CELLS]
        rows.append(("heyoka, rigid, tolerance 2.2e-16", statistics.median(costs)))
        for method in ("DOP853", "LSODA"):
            costs = [once(lambda c=c, m=method: scipy_rival.run(*c, 20, m), 20) for c in CELLS]
            rows.append((f"scipy solve_ivp {method}, rigid, rtol 1e-9", statistics.median(costs)))
    print(f"\n{'':44}{'us per plate period':>20}{'of rigid, neighbours':>22}")
    for name, cost in rows:
        print(f"{name:44}{cost:20.3f}{cost / rows[0][1]:22.1f}")


if __name__ == "__main__":
    main()
