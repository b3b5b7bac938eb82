"""Lanes against the scalar functions they stand in for, over random cells of `rigid`.

    python -m benchmarks.lanes [--phases 50000] [--cells 100000] [--seed 1]

Phases: a flight of lanes and of the scalar functions, from the same random state on the plate, at extremes of
the parameters too (Gamma 0.5 to 30, Omega 0.01 to 20, xi 1e-3 to 10). The largest difference of flight times
and take-off phases, and the flights that differ by more than 1e-6 rad: a first root missed. Cells: outcomes,
counts and modes of both, from rest and on ramps (Gamma 0.3 to 6, Omega 0.2 to 2, xi 0.01 to 1, 200 + 100
plate periods). Rounding decides chaotic cells, so their flight times are compared as samples
(Kolmogorov-Smirnov).
"""

import argparse
import math
from typing import Any

import numpy as np

from benchmarks.machine import describe
from benchmarks.tables import table
from kernel.line import run_line
from kernel.models.rigid import plate
from kernel.params import Line, Outcome

#: Cells of a line of a ramp.
LENGTH = 50


def both(cells: tuple[np.ndarray, ...], e: float, **options: Any) -> tuple[Line, Line]:
    """The same cells in lanes and by the scalar functions."""
    of = plate(restitution=np.full(len(cells[0]), e))
    lanes, scalar = (run_line(*cells, plate=of, in_lanes=in_lanes, **options) for in_lanes in (True, False))
    return lanes, scalar


def phases(n: int, e: float, random: np.random.Generator) -> list[object]:
    """A row: the first flights of two plate periods from random states on the plate."""
    gamma, omega = 10 ** random.uniform(-0.3, 1.5, n), 10 ** random.uniform(-2, 1.3, n)
    xi = 10 ** random.uniform(-3, 1, n)
    states = np.zeros((n, 6))
    states[:, 0] = random.uniform(0, 2 * math.pi, n)
    states[:, 4] = -(omega**2) / gamma + random.normal(0, 1, n) * np.minimum(omega, 1.0)
    states[:, 5] = random.normal(0, 1, n)
    lanes, scalar = both((gamma, omega, xi), e, carry=False, states=states, settle=0, observe=2, keep=1024)
    first = np.isfinite(lanes.flight_time[:, 0]) & np.isfinite(scalar.flight_time[:, 0])
    time = np.abs(lanes.flight_time - scalar.flight_time)[first, 0]
    phase = np.abs(lanes.takeoff_phase - scalar.takeoff_phase)[first, 0]
    difference = np.maximum(time, np.minimum(phase, 2 * math.pi - phase))
    other = (np.isfinite(lanes.flight_time[:, 0]) != np.isfinite(scalar.flight_time[:, 0])).sum()
    worst = f"{difference.max():.1e}", f"{np.quantile(difference, 0.999):.0e}"
    return [f"e = {e:g}", f"{first.sum():,}", *worst, int((difference > 1e-6).sum()), int(other)]


def cells_of(n: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random cells (n,)."""
    return random.uniform(0.3, 6, n), random.uniform(0.2, 2, n), 10 ** random.uniform(-2, 0, n)


def outcomes(name: str, n: int, e: float, ramp: bool, random: np.random.Generator) -> list[object]:
    """A row: how many cells have another outcome, mode or number of flights in lanes."""
    if ramp:
        lines = n // LENGTH
        _, omega, xi = (np.repeat(axis, LENGTH) for axis in cells_of(lines, random))
        cells, options = (np.tile(np.linspace(0.3, 6, LENGTH), lines), omega, xi), {"start": [None] * lines}
    else:
        cells, options = cells_of(n, random), {}
    lanes, scalar = both(cells, e, carry=ramp, settle=200, observe=100, keep=32, **options)
    regular = (lanes.outcome == Outcome.PERIODIC) & (scalar.outcome == Outcome.PERIODIC)
    regular |= (lanes.outcome == Outcome.AT_REST) & (scalar.outcome == Outcome.AT_REST)
    moved = regular & ((lanes.bounces != scalar.bounces) | (lanes.periods != scalar.periods))
    counts = regular & ~moved & (lanes.flights != scalar.flights)
    failed = [int((line.outcome == Outcome.UNRESOLVED).sum()) for line in (lanes, scalar)]
    chaotic = (lanes.outcome == Outcome.APERIODIC) & (scalar.outcome == Outcome.APERIODIC)
    distance, allowed = _ks(lanes.flight_time[chaotic], scalar.flight_time[chaotic])
    return [
        name, f"{len(lanes.outcome):,}", f"{regular.sum():,}", int(moved.sum()), int(counts.sum()),
        int((lanes.outcome != scalar.outcome).sum()), "/".join(map(str, failed)),
        f"{distance:.1e} ({allowed:.1e})",
    ]  # fmt: skip


def _ks(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Kolmogorov-Smirnov distance of one flight of each cell, and what chance exceeds in 1 of 100."""
    a, b = (np.sort(x[np.isfinite(x[:, 0]), 0]) for x in (a, b))
    both = np.concatenate([a, b])
    distance = np.searchsorted(a, both, side="right") / len(a) - np.searchsorted(b, both, side="right") / len(
        b
    )
    return float(np.abs(distance).max()), 1.63 * math.sqrt((len(a) + len(b)) / (len(a) * len(b)))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--phases", type=int, default=50_000)
    parser.add_argument("--cells", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    print(describe(), flush=True)
    random = np.random.default_rng(arguments.seed)
    rows = [phases(arguments.phases, e, random) for e in (0.0, 0.3)]
    head = ["phases", "flights", "largest difference, rad", "1 in 1,000 above", "above 1e-6", "in one only"]
    print("\n" + table(head, rows) + "\n", flush=True)
    n = arguments.cells
    rows = [
        outcomes("from rest", n, 0.0, False, random),
        outcomes("ramp", n, 0.0, True, random),
        outcomes("from rest, e = 0.3", n // 4, 0.3, False, random),
    ]
    head = [
        "cells", "", "periodic or at rest in both", "another mode", "another count", "another outcome",
        "unresolved", "chaotic: KS distance (1 %)",
    ]  # fmt: skip
    print(table(head, rows))


if __name__ == "__main__":
    main()
