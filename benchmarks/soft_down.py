"""How far Gamma_down moves for a soft contact and with restitution, by ramps seeded on the orbit.

    python -m benchmarks.soft_down [--xi 0.05] [--penetration 1e-3]

At five Omega the fold of the rigid plate with e = 0 is the start: its orbit a little above, crept down with
steps that end at 4e-6 of Gamma and windows of 12,000 plate periods (`benchmarks.seeded_ramps`). `rigid` with
e = 0 shows the method's error. Where a ramp dies at once the start is repeated further above the fold.
"""

import argparse
import math

import numpy as np

from benchmarks.seeded_ramps import STEPS, Ramp
from benchmarks.tables import table
from kernel.branches.closed_form import TWO_PI
from kernel.branches.descent import Fold
from kernel.branches.thresholds import thresholds
from kernel.params import Cell, Line, Outcome, Start
from tests.support.plates import Model, run_line

OMEGA = (0.56, 0.60, 0.62, 0.66, 0.70)
FINEST = 4e-6
CELLS = 10


def run(
    gamma: np.ndarray, omega: float, xi: float, start: Start, settle: int,
    model: Model, restitution: float, penetration: float,
) -> Line:  # fmt: skip
    """A ramp that goes on from a start."""
    one = np.ones(len(gamma))
    return run_line(
        gamma, omega * one, xi * one, model=model, restitution=restitution * one,
        penetration=penetration * one, carry=True, start=start, settle=settle, observe=60, keep=16,
    )  # fmt: skip


def lowest(
    fold: Fold, omega: float, xi: float, model: Model, restitution: float, penetration: float
) -> float:
    """The lowest Gamma that bounces, crept down from the fold's orbit; NaN if none does."""
    contact = (model, restitution, penetration)
    u = fold.cycle.unknowns
    size = float(np.hypot(u[2], u[3]))
    phase = math.atan2(u[3], u[2]) % TWO_PI
    state = np.array([phase, 0.0, 0.0, 0.0, u[0] / size, u[1] / size])
    at = None
    for above in (1e-5, 1e-3, 1e-2, 0.03, 0.06, 0.1, 0.15, 0.2, 0.22, 0.25):
        gamma = fold.gamma * (1.0 + above)
        line = run(np.array([gamma]), omega, xi, Start(state, Cell(gamma, omega, xi)), 2000, *contact)
        if line.outcome[0] != Outcome.AT_REST:
            at = Ramp(gamma, line.end_state[0])
            break
    if at is None:
        return math.nan
    for step, periods in STEPS:
        if step < FINEST:
            break
        for _ in range(100):
            gammas = at.gamma * (1.0 - step) ** np.arange(1, CELLS + 1)
            line = run(gammas, omega, xi, Start(at.state, Cell(at.gamma, omega, xi)), periods, *contact)
            rests = np.flatnonzero(line.outcome == Outcome.AT_REST)
            last = int(rests[0]) - 1 if len(rests) else CELLS - 1
            if last >= 0:
                at = Ramp(float(gammas[last]), line.end_state[last])
            if len(rests):
                break
    return at.gamma


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--xi", type=float, default=0.05)
    parser.add_argument("--penetration", type=float, default=1e-3)
    options = parser.parse_args()
    d = options.penetration
    contacts = [("rigid, e = 0", Model.RIGID, 0.0), ("rigid, e = 0.1", Model.RIGID, 0.1)]
    contacts += [("rigid, e = 0.5", Model.RIGID, 0.5)]
    contacts += [(f"soft, e = {e:g}", Model.SOFT, e) for e in (0.01, 0.1, 0.5)]
    rows = []
    for omega in OMEGA:
        found = thresholds(omega, options.xi)
        if found.fold is None:
            continue
        row = [f"{omega:g}", f"{found.gamma_th:.6f}", f"{found.down:.6f}"]
        for _, model, e in contacts:
            gamma = lowest(found.fold, omega, options.xi, model, e, d)
            row.append(f"{gamma - found.down:+.6f}")
        rows.append(row)
        print(row, flush=True)
    print(table(["Omega", "Gamma_th", "fold", *(name for name, *_ in contacts)], rows))


if __name__ == "__main__":
    main()
