"""CPU time per cell per plate period of each contact model and of heyoka, and their errors.

    python -m benchmarks.kernel [--repeat 7] [--own]

Time: cells of the paper's figures (Fig. 2, and Omega = 0.67, 1, 1.24 at xi = 0.05), 300 plate periods each
from rest. "neighbours" computes 64 cells within 1% of Gamma in one line, as in a sweep; "alone" computes one
cell with the scalar functions; "ramp" computes 16 lines within 1% of Omega, each of 10 cells within 5% of
Gamma. Every cycle is computed. Every number is the median over the cells of the median
over repetitions; the ratios come from one run. heyoka, a general integrator, solves the rigid
spring, compiled beforehand; `--own` leaves it out.

Errors: the worst flight time of tests/golden's rigid cells after 200 periods, whose uncertainty is 6e-10; and
the deviation of the first three flights from those of `rigid`.
"""

import json
import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from benchmarks.measuring import alternating, describe, options, short, table
from kernel.params import Line
from tests.support.plates import Model, run_line

PERIODS = 300
NEIGHBOURS = 64
LINES, ALONG = 16, 10
GOLDEN = json.loads((Path(__file__).parents[1] / "tests" / "golden" / "rigid.json").read_text())
GOLDEN_PERIODS = 200
FIRST = 3

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

#: (Gamma, Omega, xi, periods) -> flight times from rest, rad.
Solver = Callable[[float, float, float, int], Sequence[float]]


class Row(NamedTuple):
    """One row of the table: microseconds, and the two errors in rad, NaN if they do not apply."""

    name: str
    cost: float
    golden: float = math.nan
    first: float = math.nan


def line(
    gamma: Any, omega: float, xi: float, model: Model = Model.RIGID, *, e: float = 0.0, d: float = 1e-3,
    adhesive: bool = True, alone: bool = False, settle: int = 200, observe: int = PERIODS - 200,
) -> Line:  # fmt: skip
    """A line of cells from rest; `alone`: by the scalar functions."""
    gamma = np.atleast_1d(np.asarray(gamma, float))
    full = np.full_like
    return run_line(
        gamma, full(gamma, omega), full(gamma, xi), model=model, restitution=full(gamma, e),
        penetration=full(gamma, d), adhesive=adhesive, carry=False, in_lanes=not alone, settle=settle,
        observe=observe, keep=64,
    )  # fmt: skip


def flights_alone(gamma: float, omega: float, xi: float, periods: int) -> list[float]:
    """The last flights of one cell by the scalar kernel."""
    settle = max(0, periods - 20)
    done = line(gamma, omega, xi, alone=True, settle=settle, observe=periods - settle)
    return _recorded(done, 0)


def flights_neighbours(gamma: float, omega: float, xi: float, periods: int) -> list[float]:
    """The last flights of the middle cell of nine that are computed in parallel lanes."""
    settle = max(0, periods - 20)
    spread = gamma * (1.0 + 1e-3 * np.arange(-4, 5))
    return _recorded(line(spread, omega, xi, settle=settle, observe=periods - settle), 4)


def _recorded(done: Line, cell: int) -> list[float]:
    return done.flight_time[cell, : done.flights[cell]].tolist()


def ramp(
    gamma: float, omega: float, xi: float, model: Model, *, e: float = 0.0, adhesive: bool = True
) -> Line:
    """Lines of a ramp of Gamma, side by side."""
    along = np.tile(gamma * np.linspace(0.95, 1.05, ALONG), LINES)
    full = np.full_like
    return run_line(
        along, np.repeat(omega * np.linspace(0.99, 1.01, LINES), ALONG), full(along, xi), model=model,
        restitution=full(along, e), penetration=full(along, 1e-3), adhesive=adhesive, carry=True,
        start=[None] * LINES, settle=200, observe=PERIODS - 200, keep=64,
    )  # fmt: skip


def ramp_cost(model: Model, repeat: int, **options: Any) -> float:
    """Median over CELLS."""
    units = LINES * ALONG * PERIODS
    return median(cost_of(lambda c=cell: ramp(*c, model, **options), units, repeat) for cell in CELLS)


def cost_of(run: Callable[[], object], units: float, repeat: int) -> float:
    """Median CPU microseconds per unit; the first run, which may compile, is not timed."""
    return float(np.median(alternating([run], repeat))) / units * 1e6


def kernel_cost(model: Model, repeat: int, **options: Any) -> float:
    """Median over CELLS."""
    costs = []
    for gamma, omega, xi in CELLS:
        spread = np.array([gamma]) if options.get("alone") else gamma * np.linspace(0.99, 1.01, NEIGHBOURS)

        def run(g: np.ndarray = spread, o: float = omega, x: float = xi) -> Line:
            return line(g, o, x, model, **options)

        costs.append(cost_of(run, len(spread) * PERIODS, repeat))
    return median(costs)


def golden_error(solve: Solver) -> float:
    """The largest error of a flight in tests/golden's periodic cells; flights are sorted by length."""
    worst = 0.0
    for cell in GOLDEN:
        flights = solve(cell["gamma"], cell["omega"], cell["xi"], GOLDEN_PERIODS)
        last = sorted(flights[len(flights) - cell["bounces"] :])
        worst = max(worst, *(abs(a - b) for a, b in zip(last, sorted(cell["flights"]), strict=True)))
    return worst


def first_error(solve: Solver) -> float:
    """The largest deviation of a solver's first flights in the same cells from those of `rigid`, alone."""
    worst = 0.0
    for cell in GOLDEN:
        where = (cell["gamma"], cell["omega"], cell["xi"], 20)
        theirs, ours = solve(*where), flights_alone(*where)
        # The kernel does not count a flight that begins before the plate starts.
        pairs = zip(theirs[len(theirs) - len(ours) :], ours, strict=True)
        worst = max(worst, *(abs(a - b) for a, b in islice(pairs, FIRST)))
    return worst


def own_rows(repeat: int) -> list[Row]:
    """This project's models."""
    rows = [
        Row("rigid, neighbours", kernel_cost(Model.RIGID, repeat),
            golden_error(flights_neighbours), first_error(flights_neighbours)),
        Row("rigid, alone", kernel_cost(Model.RIGID, repeat, alone=True), golden_error(flights_alone)),
        Row("rigid, ramp", ramp_cost(Model.RIGID, repeat)),
        Row("rigid, e = 0.3", kernel_cost(Model.RIGID, repeat, e=0.3)),
        *(Row(f"ball, e = {e:g}", kernel_cost(Model.BALL, repeat, e=e)) for e in (0.0, 0.3)),
    ]  # fmt: skip
    for adhesive in (True, False):
        for d in (1e-3, 1e-6):
            name = f"soft, {'adhesive' if adhesive else 'nonadhesive'}, e = 0.01, d = {d:g}"
            rows.append(Row(name, kernel_cost(Model.SOFT, repeat, e=0.01, d=d, adhesive=adhesive)))
    for adhesive in (True, False):
        law = "adhesive" if adhesive else "nonadhesive"
        cost = ramp_cost(Model.SOFT, repeat, e=0.01, adhesive=adhesive)
        rows.append(Row(f"soft, ramp, {law}, e = 0.01, d = 0.001", cost))
    stepped = kernel_cost(Model.STEPPED, 1, e=0.01, alone=True)
    rows.append(Row("stepped, the paper's method, d = 0.001", stepped))
    return rows


def heyoka(repeat: int) -> list[Row]:
    """Taylor's method to machine precision, compiled."""
    from benchmarks.heyoka_rival import BatchSpring, Spring

    spring, batch = Spring(), BatchSpring()
    alone, together = [], []
    for gamma, omega, xi in CELLS:
        spread = gamma * np.linspace(0.99, 1.01, batch.cells)
        alone.append(cost_of(partial(spring.run, gamma, omega, xi, PERIODS), PERIODS, repeat))
        run = partial(batch.run, spread, omega, xi, PERIODS)
        together.append(cost_of(run, batch.cells * PERIODS, repeat))

    def one(gamma: float, omega: float, xi: float, periods: int) -> list[float]:
        return batch.run([gamma] * batch.cells, omega, xi, periods)[0]

    name = f"the same in batch mode, {batch.cells} neighbours"
    return [
        Row("heyoka, tolerance 2.2e-16", median(alone), golden_error(spring.run), first_error(spring.run)),
        Row(name, median(together), golden_error(one), first_error(one)),
    ]


def main() -> None:
    """Print the table."""
    given = options(__doc__, repeat=7, own=False)
    print(describe(*([] if given.own else ["heyoka"])))
    rows = own_rows(given.repeat) + ([] if given.own else heyoka(given.repeat))
    first = rows[0].cost
    shown = [
        [row.name, short(row.cost), short(row.cost / first), *map(error_text, (row.golden, row.first))]
        for row in rows
    ]
    head = [
        "",
        "µs per plate period",
        "relative to rigid, neighbours",
        "worst error, rad",
        "first flights, rad",
    ]
    print("\n" + table(head, shown))


def error_text(error: float) -> str:
    """An error in a table; nothing where none applies."""
    return "" if math.isnan(error) else f"{error:.0e}"


if __name__ == "__main__":
    main()
