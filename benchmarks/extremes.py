"""Outcomes and costs of random cells over the whole range of parameters, for each model.

    python -m benchmarks.extremes [lines] [whole] [hard] [default] [--cells N] [--periods N] [--seed 1]
                                  [--worst 3]

Three log-uniform ranges. Whole: Omega and xi from 1e-3 to 1e3, Gamma from 1e-3 to 1e2, penetration from 1e-8
to 1e-1, restitution below 1 or as the row says; a fifth of the cells at Gamma = 2, Omega = 1 or sqrt(2),
xi = 0, 1/sqrt(2) or 1, or within 1e-12 of them. Hard: the same with restitution from 1e-8 to 0.99 and
penetration from 1e-8 to 1, 10,000 cells for 200 plate periods. Default: Gamma and xi up to 10, Omega from 0.1
to 10, the default contact. Hops at restitutions 0.999 and 1 end late or never and spend the budget of
evaluations; they are counted in the rows of their own. Half of the periods are settling. Lists the worst
cells: unresolved, then slow ones.

Lines: 501 cells with Gamma from 1 to 6 on hard contacts without adhesion, 200 periods of settling and 100 of
observation, median of five runs.
"""

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.measuring import alternating, describe, options
from kernel.params import Line, Outcome
from tests.support.plates import HARD_CONTACTS, Model, run_line

#: Special values of xi and omega, and values within rounding of them.
EDGES_XI = (0.0, 1.0, math.sqrt(0.5), 1.0 + 1e-12, math.sqrt(0.5) * (1.0 - 1e-12))
EDGES_OMEGA = (1.0, 1.0 + 1e-12, math.sqrt(2.0))


class Kind(NamedTuple):
    """One row of the table; a restitution of None is random below 1."""

    name: str
    model: Model
    adhesive: bool
    restitution: float | None


WHOLE = (
    Kind("rigid, e = 0", Model.RIGID, True, 0.0),
    Kind("rigid, e < 1", Model.RIGID, True, None),
    Kind("rigid, e = 0.999", Model.RIGID, True, 0.999),
    Kind("rigid, e = 1", Model.RIGID, True, 1.0),
    Kind("soft adhesive, e = 0", Model.SOFT, True, 0.0),
    Kind("soft adhesive, e < 1", Model.SOFT, True, None),
    Kind("soft adhesive, e = 0.999", Model.SOFT, True, 0.999),
    Kind("soft adhesive, e = 1", Model.SOFT, True, 1.0),
    Kind("soft nonadhesive, e < 1", Model.SOFT, False, None),
    Kind("soft nonadhesive, e = 0.999", Model.SOFT, False, 0.999),
    Kind("soft nonadhesive, e = 1", Model.SOFT, False, 1.0),
    Kind("ball, e < 1", Model.BALL, True, None),
)
HARD = (
    Kind("soft adhesive, e < 0.99", Model.SOFT, True, None),
    Kind("soft nonadhesive, e < 0.99", Model.SOFT, False, None),
)
DEFAULT = (
    Kind("rigid, e = 0", Model.RIGID, True, 0.0),
    Kind("soft adhesive, e = 0.01", Model.SOFT, True, 0.01),
    Kind("soft nonadhesive, e = 0.01", Model.SOFT, False, 0.01),
    Kind("stepped, e = 0.01", Model.STEPPED, True, 0.01),
    Kind("ball, e = 0", Model.BALL, True, 0.0),
)


class Sample(NamedTuple):
    """Cells, each array (n,)."""

    gamma: NDArray[np.float64]
    omega: NDArray[np.float64]
    xi: NDArray[np.float64]
    restitution: NDArray[np.float64]
    penetration: NDArray[np.float64]


class Range(NamedTuple):
    """One table; cells and periods unless the command line says otherwise."""

    draw: Callable[[Kind, int, np.random.Generator], Sample]
    kinds: tuple[Kind, ...]
    cells: int
    periods: int


def whole_range(kind: Kind, cells: int, rng: np.random.Generator) -> Sample:
    gamma, omega, xi, penetration = (
        10.0 ** rng.uniform(low, high, cells) for low, high in ((-3, 2), (-3, 3), (-3, 3), (-8, -1))
    )
    gamma[::15] = 2.0
    xi[1::10] = rng.choice(EDGES_XI, len(xi[1::10]))
    omega[2::20] = rng.choice(EDGES_OMEGA, len(omega[2::20]))
    # Some close to 0; a nonadhesive contact cannot have e = 0.
    e = rng.uniform(0.0, 1.0, cells)
    e[::4] = 10.0 ** rng.uniform(-6, 0, len(e[::4]))
    if kind.adhesive:
        e[2::10] = 0.0
    restitution = e if kind.restitution is None else np.full(cells, kind.restitution)
    return Sample(gamma, omega, xi, restitution, penetration)


def hard_range(kind: Kind, cells: int, rng: np.random.Generator) -> Sample:
    sample = whole_range(kind, cells, rng)
    restitution = 10.0 ** rng.uniform(-8.0, math.log10(0.99), cells)
    penetration = 10.0 ** rng.uniform(-8.0, 0.0, cells)
    return sample._replace(restitution=restitution, penetration=penetration)


def default_range(kind: Kind, cells: int, rng: np.random.Generator) -> Sample:
    gamma, omega, xi = (10.0 ** rng.uniform(low, 1, cells) for low in (-1, -1, -3))
    xi[::20] = 0.0
    return Sample(gamma, omega, xi, np.full(cells, kind.restitution or 0.0), np.full(cells, 1e-3))


RANGES = {
    "whole": Range(whole_range, WHOLE, 2000, 20),
    "hard": Range(hard_range, HARD, 10_000, 200),
    "default": Range(default_range, DEFAULT, 2000, 20),
}


def measure(kind: Kind, sample: Sample, periods: int) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Outcome and CPU microseconds per plate period of every cell, each computed alone."""
    outcome, cost = np.zeros(len(sample.gamma), np.uint8), np.zeros(len(sample.gamma))
    for i in range(len(outcome)):
        gamma, omega, xi, restitution, penetration = (array[i : i + 1] for array in sample)
        began = time.process_time()
        line = run_line(
            gamma, omega, xi, model=kind.model, restitution=restitution, penetration=penetration,
            adhesive=kind.adhesive, carry=False, settle=periods // 2, observe=periods - periods // 2, keep=16,
        )  # fmt: skip
        cost[i] = (time.process_time() - began) / periods * 1e6
        outcome[i] = line.outcome[0]
    return outcome, cost


def report(kind: Kind, sample: Sample, periods: int, worst: int) -> None:
    measure(kind, Sample(*(array[:1] for array in sample)), periods)  # compiles
    outcome, cost = measure(kind, sample, periods)
    counts = [f"{np.sum(outcome == kind_of):11d}" for kind_of in list(Outcome)[1:]]
    spread = (np.median(cost), np.percentile(cost, 99), cost.max())
    print(f"{kind.name:28s}" + "".join(counts) + "".join(f"{value:11.1f}" for value in spread))
    failed = np.flatnonzero((outcome == Outcome.UNRESOLVED) | (outcome == Outcome.DIVERGED))
    listed = [*failed[np.argsort(-cost[failed])], *(i for i in np.argsort(-cost) if i not in set(failed))]
    for i in listed[:worst]:
        numbers = ", ".join(
            f"{name} {array[i]:.17g}" for name, array in zip(Sample._fields, sample, strict=True)
        )
        print(f"    {Outcome(outcome[i]).name.lower()}, {cost[i]:.0f} us: {numbers}")


def lines() -> None:
    """Print unresolved cells and cost of each of HARD_CONTACTS."""
    gamma = np.linspace(1.0, 6.0, 501)
    print("\nlines without adhesion: unresolved cells, and CPU us per plate period")
    for e, d, omega, xi in HARD_CONTACTS:
        omegas, xis, restitution, penetration = (np.full_like(gamma, value) for value in (omega, xi, e, d))

        def run(*cells: NDArray[np.float64], e: Any = restitution, d: Any = penetration) -> Line:
            return run_line(
                *cells, model=Model.SOFT, restitution=e, penetration=d, adhesive=False, carry=False,
                settle=200, observe=100, keep=64,
            )  # fmt: skip

        unresolved = np.sum(run(gamma, omegas, xis).outcome == Outcome.UNRESOLVED)
        cost = np.median(alternating([partial(run, gamma, omegas, xis)], 5)) / (300 * len(gamma)) * 1e6
        print(f"e {e:g}, d {d:g}, Omega {omega}, xi {xi}: {unresolved:8d}{cost:10.2f}")


def main() -> None:
    arguments = options(__doc__, ranges=["lines", *RANGES], cells=0, periods=0, seed=1, worst=3)
    print(describe())
    names = [kind.name.lower().replace("_", " ") for kind in list(Outcome)[1:]]
    for title in arguments.ranges:
        if title == "lines":
            lines()
            continue
        draw, kinds, cells, periods = RANGES[title]
        cells, periods = arguments.cells or cells, arguments.periods or periods
        print(f"\n{title} range, {cells} cells, {periods} periods: cells, and CPU us per plate period")
        print(f"{'':28s}" + "".join(f"{name:>11s}" for name in names) + "     median   99th pc.    largest")
        for number, kind in enumerate(kinds):
            rng = np.random.default_rng([arguments.seed, number])
            report(kind, draw(kind, cells, rng), periods, arguments.worst)


if __name__ == "__main__":
    main()
