"""What `"settle": "auto"` says of cells, against the same cells after long settling.

    python -m benchmarks.settling [--cells 6000] [--samples 3] [--seed 1] [--long 20000]

`rigid`, e = 0, from rest, by default. Random cells: Gamma uniform in 0.5 to 6, Omega in 0.3 to
2, xi log-uniform in 0.02 to 1.2, in samples of their own seeds. The grid: Gamma 0.6 to 1.5 by 0.02, Omega 0.9
to 1.15 by 0.01, xi = 0.05. The same cells with a fixed window after `--long` periods are "the end". A mode is
false where it differs from that in the end. The second table says how many cells still settle with `until`,
and what the default costs relative to windows of 200 + 100 periods: medians of runs that alternate.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.measuring import alternating, describe, options, ratio, short, table
from kernel.params import Line, Outcome
from tests.support.plates import Model, run_line
from worker.sweep import SweepSpec

DEFAULT = SweepSpec(gamma=1.0, omega=1.0, xi=0.1)
UNTIL = (500, 1_000, 2_000, 5_000, 10_000)
REPEAT = 5

#: Columns of the first table.
COLUMNS = (
    "certified: false modes", "periodic, not certified", "aperiodic: periodic in the end",
    "settling: periodic in the end", "aperiodic in the end: certified", "still settling",
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


def run(cells: Cells, settle: int | None = None, until: int | None = DEFAULT.settles_until) -> Line:
    """By default; with a number of periods by a fixed window after them."""
    auto = settle is None
    return run_line(
        *cells, model=Model.RIGID, restitution=np.zeros(len(cells.gamma)),
        penetration=np.ones(len(cells.gamma)), carry=False, settle=DEFAULT.window[0] if auto else settle,
        observe=DEFAULT.observe, keep=DEFAULT.keep, micro_flight=DEFAULT.micro_flight, certify=auto,
        settle_until=until if auto else None,
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
    certified, ends_periodic = np.isfinite(line.flight_error), end.outcome == Outcome.PERIODIC
    false = ~ends_periodic | (line.bounces != end.bounces) | (line.periods != end.periods)
    return [
        name, part(false, certified), part(~certified, periodic), part(ends_periodic, aperiodic),
        part(ends_periodic, settling), part(certified, end.outcome == Outcome.APERIODIC),
        int(np.count_nonzero(settling)),
    ]  # fmt: skip


def going_on(name: str, cells: Cells) -> list[object]:
    """One row of the second table."""
    shares = [np.mean(run(cells, until=until).outcome == Outcome.SETTLING) for until in UNTIL]
    times = alternating([lambda: run(cells, settle=DEFAULT.window[0]), lambda: run(cells)], REPEAT)
    return [name, *(f"{100.0 * share:.2f}%" for share in shares), short(ratio(times, 1))]


def main() -> None:
    args = options(__doc__, cells=6_000, samples=3, seed=1, long=20_000)
    sets = {f"random, seed {seed}": random_cells(args.cells, seed)
            for seed in range(args.seed, args.seed + args.samples)}  # fmt: skip
    sets["grid"] = grid()
    print(f"{describe()}\n{args.cells} random cells a sample, long settling {args.long}\n")
    head = ["cells", *COLUMNS]
    print(table(head, [against_the_end(name, cells, args.long) for name, cells in sets.items()]))
    head = ["still settling after", *map(str, UNTIL), "cost ratio"]
    print(f"\n{table(head, [going_on(name, cells) for name, cells in sets.items()])}")


if __name__ == "__main__":
    main()
