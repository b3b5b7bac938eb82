"""Whether anything bounces on below the Gamma at which thresholds of the branches say that it ends.

    python -m benchmarks.threshold_search [--springs 40] [--xi 0.04 0.3] [--omega 0.05 10] [--seed 1]
        [--starts 80] [--gammas 34]

For each of `springs` springs, Omega and xi log-uniform: many starts at each of many Gammas below what the
rule of `kernel.cycles.thresholds` says, from 1e-3 of it on, of the rigid contact without restitution. What
bounces after SETTLE plate periods is followed for FOLLOWED more, long against the ghost of a fold. Prints
what bounces even then, with its Gamma over the rule's and its mode, (0,0) if aperiodic, and a table by what
the rule says and whether `thresholds` answers it.
"""

import math
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from benchmarks.measuring import options, table
from kernel.cycles.thresholds import NOT_SEARCHED, Thresholds, conjecture, thresholds
from kernel.params import Line, Outcome
from kernel.search import random_starts
from tests.support.plates import Model, run_line

#: Plate periods before a start is looked at, and those for which what bounces then is followed.
SETTLE = 3_000
FOLLOWED = 40_000

#: The Gammas lie so far below the rule's, relative: from the first to the second.
BELOW = (1e-3, 0.8)

#: Starts of one Gamma that are followed: those that bounce are on few attractors.
MOST = 6


class Found(NamedTuple):
    """The lowest Gamma at which something bounces on."""

    gamma: float
    bounces: int  # of its mode; 0: aperiodic
    periods: int
    state: np.ndarray  # (6,) as STATE_FIELDS, settled


def run(gamma: np.ndarray, omega: float, xi: float, states: np.ndarray, settle: int) -> Line:
    """Cells of `rigid` from states of their own."""
    one = np.ones(len(gamma))
    return run_line(
        gamma, omega * one, xi * one, model=Model.RIGID, restitution=0.0 * one, penetration=one, carry=False,
        states=states, settle=settle, observe=100, keep=64,
    )  # fmt: skip


def search(
    rng: np.random.Generator, omega: float, xi: float, below: float, count: int = 80, gammas: int = 34
) -> Found | None:
    """The lowest of the Gammas below one at which a start bounces on."""
    each = below * (1.0 - np.geomspace(*BELOW, gammas))
    gamma = np.repeat(each, count)
    line = run(gamma, omega, xi, np.concatenate([random_starts(rng, g, omega, count) for g in each]), SETTLE)
    bouncing = np.flatnonzero(line.outcome != Outcome.AT_REST)
    kept = np.concatenate([np.empty(0, np.intp), *(bouncing[gamma[bouncing] == g][:MOST] for g in each)])
    if not len(kept):
        return None
    line = run(gamma[kept], omega, xi, line.end_state[kept], FOLLOWED)
    left = np.flatnonzero(line.outcome != Outcome.AT_REST)
    if not len(left):
        return None
    i = int(left[np.argmin(gamma[kept][left])])
    return Found(float(gamma[kept][i]), int(line.bounces[i]), int(line.periods[i]), line.end_state[i])


def springs(
    rng: np.random.Generator, count: int, omega: tuple[float, float], xi: tuple[float, float]
) -> Iterator[tuple[float, float]]:
    """Omega and xi, log-uniform."""
    for _ in range(count):
        yield math.exp(rng.uniform(*np.log(omega))), math.exp(rng.uniform(*np.log(xi)))


class Searched(NamedTuple):
    """One spring."""

    rule: Thresholds  # by the rule at any damping
    answer: Thresholds
    found: Found | None  # below the rule's Gamma, if it has one


def searched(
    seed: int, count: int, omega: tuple[float, float], xi: tuple[float, float], starts: int = 80,
    gammas: int = 34,
) -> Iterator[Searched]:  # fmt: skip
    """Search below what the rule says of random springs."""
    rng = np.random.default_rng(seed)
    for spring in springs(rng, count, omega, xi):
        rule = conjecture(*spring)
        found = search(rng, *spring, rule.down, starts, gammas) if math.isfinite(rule.down) else None
        yield Searched(rule, thresholds(*spring), found)


def main() -> None:
    """Print what bounces below the rule, and a table."""
    o = options(__doc__, springs=40, omega=(0.05, 10.0), xi=(0.04, 0.3), starts=80, gammas=34, seed=1)
    count: Counter[tuple[str, str, str]] = Counter()
    for rule, answer, found in searched(o.seed, o.springs, o.omega, o.xi, o.starts, o.gammas):
        says = rule.cause.split(" (")[0]
        below = "not searched" if math.isnan(rule.down) else "nothing" if found is None else "bounces"
        count[says, "no" if answer.cause == NOT_SEARCHED else "yes", below] += 1
        if found is not None:
            mode = f"({found.bounces},{found.periods})"
            where = f"Omega {rule.omega:.6f}, xi {rule.xi:.6f}, {rule.cause} {rule.down:.6f}"
            print(f"{where}: {found.gamma / rule.down:.4f} of it {mode}", flush=True)
    rows = [[*key, str(n)] for key, n in sorted(count.items())]
    print(table(["the rule says", "answered", "below it", "springs"], rows))


if __name__ == "__main__":
    main()
