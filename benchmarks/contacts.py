"""How far the end of bouncing moves from its fold on other contacts than the ideal plate without restitution.

    python -m benchmarks.contacts [--step 1e-4]

At five frequencies of Fig. 9 (xi = 0.05) a ramp starts on a stable cycle of the closed form well above its
fold, on each contact, and descends until the spring stays on the plate. Prints the lowest Gamma that bounces
less the fold; –: the first cell of the ramp does not bounce.
"""

import argparse
import math

import numpy as np

from benchmarks.machine import describe
from benchmarks.tables import table
from kernel.branches.starts import stable_ranges, start_on_stable_cycle
from kernel.branches.thresholds import thresholds
from kernel.params import Cell, Outcome, Start
from tests.support.plates import Model, run_line

XI = 0.05
OMEGA = (0.56, 0.60, 0.62, 0.66, 0.70)

#: Contact: its model and restitution. The penetration of a soft one is 1e-3 plate amplitudes.
CONTACTS = {
    "soft": (Model.SOFT, 0.0),
    "e = 0.1": (Model.RIGID, 0.1),
    "e = 0.5": (Model.RIGID, 0.5),
}

#: The ramp begins at this part of the range of Gamma in which the cycle is stable, and ends at this part of
#: the fold.
BEGIN, END = 0.5, 0.6
SETTLE, OBSERVE, SETTLE_UNTIL = 400, 100, 4000

#: Cells computed at a time: a ramp ends soon after bouncing has.
PIECE = 50


def end_of_bouncing(omega: float, contact: str, step: float) -> float:
    """The lowest Gamma that bounces on the way down; NaN if none does."""
    fold = thresholds(omega, XI).down
    model, restitution = CONTACTS[contact]
    stable = min(stable_ranges(omega, XI, 1), key=lambda r: abs(r.low - fold))
    gamma = np.arange(fold + BEGIN * (stable.high - fold), END * fold, -step)
    found = start_on_stable_cycle(Cell(float(gamma[0]), omega, XI), 1)
    start, lowest = found.start if found else None, np.nan
    for low in range(0, len(gamma), PIECE):
        part = gamma[low : low + PIECE].copy()
        same = np.ones(len(part))
        line = run_line(
            part, omega * same, XI * same, model=model, restitution=restitution * same,
            penetration=1e-3 * same, carry=True, settle=SETTLE, observe=OBSERVE, keep=1,
            settle_until=SETTLE_UNTIL, start=start,
        )  # fmt: skip
        bounces = line.outcome != Outcome.AT_REST
        if bounces.any():
            lowest = float(part[bounces].min())
        if not bounces.all():
            break
        start = Start(line.end_state[-1], Cell(float(part[-1]), omega, XI))
    return lowest


def shift_text(shift: float, decimals: int) -> str:
    """A shift as tables print it: – for none, and no sign where it rounds to zero."""
    return "–" if math.isnan(shift) else f"{round(shift, decimals) + 0.0:.{decimals}f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--step", type=float, default=1e-4)
    step = parser.parse_args().step
    rows = []
    for omega in OMEGA:
        fold = thresholds(omega, XI).down
        moved = [end_of_bouncing(omega, contact, step) - fold for contact in CONTACTS]
        rows.append([f"{omega:.2f}", f"{fold:.6f}", *(shift_text(value, 4) for value in moved)])
    print(describe())
    print(table(["Omega", "fold", *CONTACTS], rows))


if __name__ == "__main__":
    main()
