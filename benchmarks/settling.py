"""What the default windows say of cells, against the same cells after long settling.

    python -m benchmarks.settling [--cells 6000] [--samples 3] [--seed 1] [--long 20000]

`rigid`, e = 0, from rest, settle 200, observe 100. Random cells: Gamma uniform in 0.5 to 6, Omega in 0.3 to
2, xi log-uniform in 0.02 to 1.2, in samples of their own seeds. The grid: Gamma 0.6 to 1.5 by 0.02, Omega 0.9
to 1.15 by 0.01, xi = 0.05. The same cells with `--long` periods of settling are "the end". A mode is false
where it differs from that in the end. With settle_until = `--long`, cells that still settle go on: the second
table says how many after how many periods, and what it costs, a ratio of medians of runs that alternate.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.measuring import alternating, describe, options, ratio, short, table
from kernel.params import Line, Outcome
from tests.support.plates import Model, run_line
from worker.sweep import SweepSpec

SETTLE, OBSERVE = (int(SweepSpec.model_fields[name].default) for name in ("settle", "observe"))
MICRO_FLIGHT = float(SweepSpec.model_fields["micro_flight"].default)
DOUBLINGS = 4
REPEAT = 5

#: Columns of the first table.
COLUMNS = (
    "periodic: false modes", "aperiodic: periodic in the end", "settling: periodic in the end",
    "aperiodic in the end: called settling", "with settle_until: false modes", "still settling",
)  # fmt: skip


class Cells(NamedTuple):
    """Parameters of n cells, each array (n,)."""

    gamma: NDArray[np.float64]
    omega: NDArray[np.float64]
    xi: NDArray[np.float64]


def random_cells(n: int, seed: int) -> Cells:
    rng = np.random.default_rng(seed)
    gamma, omega = rng.uniform(0.5, 6.0, n), rng.uniform(0.3, 2.0, n)
    return Cells(gamma, omega, np.exp(rng.uniform(np.log(0.02), np.log(1.2), n)))


def grid() -> Cells:
    gamma, omega = np.meshgrid(np.linspace(0.6, 1.5, 46), np.linspace(0.9, 1.15, 26))
    return Cells(gamma.ravel(), omega.ravel(), np.full(gamma.size, 0.05))


def run(cells: Cells, settle: int = SETTLE, settle_until: int | None = None) -> Line:
    return run_line(
        *cells, model=Model.RIGID, restitution=np.zeros(len(cells.gamma)),
        penetration=np.ones(len(cells.gamma)), carry=False, settle=settle, observe=OBSERVE, keep=64,
        micro_flight=MICRO_FLIGHT, settle_until=settle_until,
    )  # fmt: skip


def part(some: NDArray[np.bool_], of: NDArray[np.bool_]) -> str:
    """How many cells of those in `of` are in `some` too."""
    total = int(np.count_nonzero(of))
    count = int(np.count_nonzero(some & of))
    return f"{count} of {total}" + (f" ({100.0 * count / total:.2f}%)" if total else "")


def against_the_end(name: str, cells: Cells, long: int) -> list[object]:
    """One row of the first table."""
    line, end = run(cells), run(cells, settle=long)
    periodic, aperiodic, settling = (
        line.outcome == outcome for outcome in (Outcome.PERIODIC, Outcome.APERIODIC, Outcome.SETTLING)
    )
    ends_periodic = end.outcome == Outcome.PERIODIC
    false = ~ends_periodic | (line.bounces != end.bounces) | (line.periods != end.periods)
    went_on = run(cells, settle_until=long)
    false_later = ~ends_periodic | (went_on.bounces != end.bounces) | (went_on.periods != end.periods)
    return [
        name, part(false, periodic), part(ends_periodic, aperiodic), part(ends_periodic, settling),
        part(settling, end.outcome == Outcome.APERIODIC),
        part(false_later, went_on.outcome == Outcome.PERIODIC),
        int(np.count_nonzero(went_on.outcome == Outcome.SETTLING)),
    ]  # fmt: skip


def going_on(name: str, cells: Cells, long: int) -> list[object]:
    """One row of the second table."""
    periods = [(SETTLE + OBSERVE) * 2**k for k in range(DOUBLINGS + 1)]
    shares = [np.mean(run(cells, settle_until=p).outcome == Outcome.SETTLING) for p in periods]
    times = alternating([lambda: run(cells), lambda: run(cells, settle_until=long)], REPEAT)
    return [name, *(f"{100.0 * share:.2f}%" for share in shares), short(ratio(times, 1))]


def main() -> None:
    args = options(__doc__, cells=6_000, samples=3, seed=1, long=20_000)
    sets = {f"random, seed {seed}": random_cells(args.cells, seed)
            for seed in range(args.seed, args.seed + args.samples)}  # fmt: skip
    sets["grid"] = grid()
    print(f"{describe()}\n{args.cells} random cells a sample, long settling {args.long}\n")
    head = ["cells", *COLUMNS]
    print(table(head, [against_the_end(name, cells, args.long) for name, cells in sets.items()]))
    periods = [str((SETTLE + OBSERVE) * 2**k) for k in range(DOUBLINGS + 1)]
    head = ["still settling after", *periods, "cost ratio"]
    print(f"\n{table(head, [going_on(name, cells, args.long) for name, cells in sets.items()])}")


if __name__ == "__main__":
    main()
