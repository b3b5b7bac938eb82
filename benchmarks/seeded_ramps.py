"""Thresholds from the branches against ramps of the simulating kernel, crept down from known orbits.

    python -m benchmarks.seeded_ramps [--cells 60] [--random 60] [--xi 0.05] [--seed 1] [-o FILE.csv]

For each of `cells` springs: ramps down from orbits of the closed form (a stable one of every (1,k) branch
near the answer and near Gamma_th, placed on the orbit exactly) and from `random` other states. Steps shrink
and windows grow, until at the last step, 1e-6 of Gamma, each cell is followed for 20,000 plate periods: long
against the ghost of a fold 1e-5 below it. What is compared is the lowest Gamma at which any of them bounces.
Verdicts: "agrees" within 2e-5; "lower", "higher": the simulation contradicts; "unresolved" makes no claim.
"""

import argparse
import csv
import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.tables import table
from kernel.branches.closed_form import TWO_PI, orbit
from kernel.branches.events import branch, flight_times
from kernel.branches.spring import spring
from kernel.branches.thresholds import UNRESOLVED, Thresholds, conjecture
from kernel.params import Cell, Outcome, Start
from kernel.threshold import threshold
from tests.support.plates import Model, run_line

#: Agreement, in Gamma.
WITHIN = 2e-5

#: Steps relative to Gamma, and plate periods at each step; the last ones last.
STEPS = ((1e-2, 300), (2e-3, 500), (4e-4, 1500), (8e-5, 3000), (1.6e-5, 6000), (4e-6, 12_000), (1e-6, 20_000))
OBSERVED = 60
CELLS = 10


class Ramp(NamedTuple):
    """The lowest bouncing cell of a ramp, and its state."""

    gamma: float
    state: np.ndarray


def run(gamma: np.ndarray, omega: float, xi: float, start: Start, settle: int):  # noqa: ANN201
    """A ramp of `rigid` that goes on from a start."""
    one = np.ones(len(gamma))
    return run_line(
        gamma, omega * one, xi * one, model=Model.RIGID, restitution=0.0 * one, penetration=one, carry=True,
        start=start, settle=settle, observe=OBSERVED, keep=16,
    )  # fmt: skip


def creep(omega: float, xi: float, gamma: float, state: np.ndarray, finest: float = 1e-6) -> Ramp | None:
    """The lowest bouncing cell on the way down from a state; None if the state itself comes to rest."""
    line = run(np.array([gamma]), omega, xi, Start(state, Cell(gamma, omega, xi)), 300)
    if line.outcome[0] == Outcome.AT_REST:
        return None
    at = Ramp(gamma, line.end_state[0])
    for step, periods in STEPS:
        if step < finest:
            break
        for _ in range(200):
            gammas = at.gamma * (1.0 - step) ** np.arange(1, CELLS + 1)
            line = run(gammas, omega, xi, Start(at.state, Cell(at.gamma, omega, xi)), periods)
            rests = np.flatnonzero(line.outcome == Outcome.AT_REST)
            last = int(rests[0]) - 1 if len(rests) else CELLS - 1
            if last >= 0:
                at = Ramp(float(gammas[last]), line.end_state[last])
            if len(rests):
                break
    return at


def on_branch(omega: float, xi: float, periods: int, flight_time: float) -> tuple[float, np.ndarray]:
    """Gamma, and the state at the landing of an orbit of (1, periods)."""
    t = np.array([flight_time])
    x = orbit(spring(omega, xi), periods, t)
    gamma = float(np.hypot(x.c, x.s)[0])
    phase = (math.atan2(x.s[0], x.c[0]) + flight_time) % TWO_PI
    return gamma, np.array([phase, 0.0, 0.0, 0.0, x.q_land[0] / gamma, x.v_land[0] / gamma])


def orbits(omega: float, xi: float, found: Thresholds) -> Iterator[tuple[float, np.ndarray]]:
    """Stable orbits of the branches: the lowest of each stable stretch that reaches below 1.3 Gamma_th."""
    for periods in range(1, 7):
        t = flight_times(omega, xi, periods)
        line = branch(omega, xi, periods, t)
        lives = line.stable & (line.admissible == 0) & (line.gamma < 1.3 * found.gamma_th) & (t > 0.02)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], lives, [False]])))
        for first, last in edges.reshape(-1, 2):
            i = first + int(np.argmin(line.gamma[first:last]))
            yield on_branch(omega, xi, periods, float(t[i]))
            yield on_branch(omega, xi, periods, float(t[(first + last - 1) // 2]))
    if found.fold is not None:
        # the orbit of the fold a little above it: between the stable cycle and the unstable one
        u = found.fold.cycle.unknowns
        gamma = float(np.hypot(u[2], u[3]))
        phase = math.atan2(u[3], u[2]) % TWO_PI
        for above in (1e-5, 1e-3):
            yield gamma * (1.0 + above), np.array([phase, 0.0, 0.0, 0.0, u[0] / gamma, u[1] / gamma])


def anywhere(rng: np.random.Generator, count: int, gamma_th: float) -> Iterator[tuple[float, np.ndarray]]:
    """Random states in flight, at Gamma up to 1.6 Gamma_th."""
    for _ in range(count):
        phase = rng.uniform(0.0, TWO_PI)
        gap, q, v = rng.exponential(3.0), rng.normal(0.0, 2.0), rng.normal(0.0, 3.0)
        gap1 = math.sin(phase) + rng.normal(0.0, 2.0)
        yield gamma_th * rng.uniform(0.8, 1.6), np.array([phase, 1.0, gap, gap1, q, v])


def lowest(
    omega: float, xi: float, starts: Iterator[tuple[float, np.ndarray]], best: Ramp | None
) -> Ramp | None:
    """The lowest bouncing cell over many starts, each followed coarsely and the best three finely."""
    coarse = [ramp for gamma, state in starts if (ramp := creep(omega, xi, gamma, state, 2e-3)) is not None]
    for ramp in sorted(coarse, key=lambda ramp: ramp.gamma)[:3]:
        if best is not None and ramp.gamma > best.gamma * 1.01:
            break
        fine = creep(omega, xi, ramp.gamma, ramp.state)
        if fine is not None and (best is None or fine.gamma < best.gamma):
            best = fine
    return best


def springs(rng: np.random.Generator, count: int, xi: float | None) -> Iterator[tuple[float, float]]:
    """Omega from 0.26 to 1.4, xi from 0.02 to 0.8."""
    for _ in range(count):
        omega, other = rng.uniform(0.26, 1.4), float(np.exp(rng.uniform(np.log(0.02), np.log(0.8))))
        yield omega, other if xi is None else xi


def verdict(found: Thresholds, simulated: float) -> str:
    """Of the answer against the lowest simulated Gamma that bounces."""
    if found.cause == UNRESOLVED:
        return UNRESOLVED
    if simulated < found.down - WITHIN:
        return "lower"
    return "higher" if simulated > found.down + WITHIN else "agrees"


def main() -> None:
    """Print what disagrees, and a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=60)
    parser.add_argument("--random", type=int, default=60, help="other starts of each spring")
    parser.add_argument("--xi", type=float, help="of all springs")
    parser.add_argument("--omega", type=float, nargs=2, help="evenly spaced from the first to the second")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    chosen = list(springs(rng, options.cells, options.xi))
    if options.omega:
        chosen = [
            (float(o), xi)
            for o, (_, xi) in zip(np.linspace(*options.omega, options.cells), chosen, strict=True)
        ]
    rows, count = [], Counter()
    for omega, xi in chosen:
        found = conjecture(omega, xi)
        gamma_th = float(threshold(omega, xi))
        seeded = lowest(omega, xi, orbits(omega, xi, found), None)
        best = lowest(omega, xi, anywhere(rng, options.random, gamma_th), seeded)
        simulated = best.gamma if best else gamma_th
        says = verdict(found, min(simulated, seeded.gamma if seeded else math.inf))
        count[found.cause.split(" of ")[0], says] += 1
        ramps = (seeded.gamma if seeded else math.nan, simulated)
        rows.append((omega, xi, gamma_th, found.down, found.cause, *ramps, says, found.reason))
        if says != "agrees":
            print(" ".join(f"{x:.6f}" if isinstance(x, float) else x for x in rows[-1]), flush=True)
    print(table(["cause", "verdict", "springs"], [[*key, str(n)] for key, n in sorted(count.items())]))
    if options.output:
        with options.output.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(
                ["omega", "xi", "gamma_th", "down", "cause", "seeded", "simulated", "verdict", "reason"]
            )
            writer.writerows(rows)


if __name__ == "__main__":
    main()
