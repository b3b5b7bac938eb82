"""How many descending thresholds at small damping resolve with words continued from a sweep's cells.

    python -m benchmarks.words_from_cells [--xi 0.02] [--cells 40] [--ramps FILE.csv]

At evenly spaced Omega from 0.26 to 0.82 a ramp goes down from 1.3 Gamma_th, 160 cells of 600 plate periods
each. The cycles of its lowest settled cells are followed as words, and `conjecture` is asked with them and
with the lowest Gamma that bounced. FILE, as `benchmarks.seeded_ramps -o` writes it for the same springs, has
the lowest Gamma that any of its ramps reached: "agrees" is that within 2e-5. Where another start reaches
lower, the ramp was on another attractor.
"""

import argparse
import csv
import math
from collections import Counter
from pathlib import Path

import numpy as np

from benchmarks.tables import table
from kernel.branches.thresholds import UNRESOLVED, conjecture
from kernel.branches.words import Word, from_flights
from kernel.params import KernelInputError, Line, Outcome
from kernel.threshold import threshold
from tests.support.plates import Model, run_line

POINTS = 160
WITHIN = 2e-5

#: Settled cells whose words are followed, the lowest ones.
WORDS = 3


def ramp(omega: float, xi: float) -> tuple[np.ndarray, Line]:
    """Gamma and the record of a ramp down."""
    gamma = np.linspace(1.3, 0.2, POINTS) * float(threshold(omega, xi))
    one = np.ones(POINTS)
    line = run_line(
        gamma, omega * one, xi * one, model=Model.RIGID, restitution=0.0 * one, penetration=one, carry=True,
        settle=500, observe=100, keep=64,
    )  # fmt: skip
    return gamma, line


def words(omega: float, xi: float, gamma: np.ndarray, line: Line) -> tuple[list[Word], float]:
    """The words of the lowest settled cells, and the lowest Gamma that bounces."""
    found: list[Word] = []
    bouncing = np.flatnonzero(line.outcome != Outcome.AT_REST)
    for i in np.flatnonzero(line.outcome == Outcome.PERIODIC)[::-1][:WORDS]:
        m, n = min(int(line.flights[i]), line.flight_time.shape[1]), int(line.bounces[i])
        times, phases = line.flight_time[i, m - n : m], line.takeoff_phase[i, m - n : m]
        try:
            found.append(from_flights(omega, xi, float(gamma[i]), phases, times, int(line.periods[i])))
        except KernelInputError as error:
            print(f"Omega = {omega:.4f}, Gamma = {gamma[i]:.4f}: {error}")
    return found, float(gamma[bouncing].min()) if len(bouncing) else math.inf


def main() -> None:
    """Print each answer, and how many resolve."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--xi", type=float, default=0.02)
    parser.add_argument("--cells", type=int, default=40)
    parser.add_argument("--ramps", type=Path)
    options = parser.parse_args()
    lowest: dict[str, float] = {}
    if options.ramps:
        with options.ramps.open(newline="") as file:
            lowest = {f"{float(row['omega']):.6f}": float(row["simulated"]) for row in csv.DictReader(file)}
    count: Counter[tuple[str, str]] = Counter()
    for omega in map(float, np.linspace(0.26, 0.82, options.cells)):
        alone = conjecture(omega, options.xi)
        found, bouncing = words(omega, options.xi, *ramp(omega, options.xi))
        answer = conjecture(omega, options.xi, words=found, bouncing=bouncing)
        simulated = lowest.get(f"{omega:.6f}", math.nan)
        verdict = UNRESOLVED
        if answer.cause != UNRESOLVED:
            verdict = "agrees" if abs(answer.down - simulated) < WITHIN else f"{simulated:.6f} simulated"
            count["with words", "agrees" if verdict == "agrees" else "not compared or differs"] += 1
        else:
            count["with words", UNRESOLVED] += 1
        letters = [word.letters for word in found]
        count["alone", UNRESOLVED if alone.cause == UNRESOLVED else "answered"] += 1
        says = f"{answer.cause} {answer.down:.6f} {verdict}"
        print(f"{omega:.4f} {alone.cause} | {says} {letters} {answer.reason}", flush=True)
    print(table(["words", "verdict", "springs"], [[*key, str(n)] for key, n in sorted(count.items())]))


if __name__ == "__main__":
    main()
