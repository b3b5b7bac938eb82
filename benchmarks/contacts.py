"""How far the end of bouncing moves from its fold on other contacts than the ideal plate without restitution.

    python -m benchmarks.contacts [--step 1e-4]

At five frequencies of Fig. 9 (xi = 0.05) a spring starts on a stable cycle of the closed form well above its
fold. Restitution rises from zero to that of each contact, a little at a time, and Gamma with it: at once, the
spring may come to rest. From there a ramp descends until the spring stays on the plate. Prints the lowest
Gamma that bounces less the fold; –: bouncing ends before the descent.
"""

import math

import numpy as np

from benchmarks.measuring import describe, options, table
from kernel.branches.starts import stable_ranges, start_on_stable_cycle
from kernel.branches.thresholds import thresholds
from kernel.params import Cell, Line, Outcome, Start
from tests.support.plates import Model, run_line

XI = 0.05
OMEGA = (0.56, 0.60, 0.62, 0.66, 0.70)

#: Contact: its model and restitution. The penetration of a soft one is 1e-3 plate amplitudes.
CONTACTS = {
    "soft": (Model.SOFT, 0.0),
    "e = 0.1": (Model.RIGID, 0.1),
    "e = 0.5": (Model.RIGID, 0.5),
}

#: The start is at this part of the range of Gamma in which the cycle is stable. From there Gamma rises to
#: RAISED times, in RISES cells, to begin the descent, which ends at this part of the fold.
BEGIN, RAISED, RISES, END = 0.9, 1.05, 26, 0.6
SETTLE, OBSERVE, SETTLE_UNTIL = 200, 100, 5000

#: Cells computed at a time: a ramp ends soon after bouncing has.
PIECE = 50


def end_of_bouncing(omega: float, contact: str, step: float) -> float:
    """The lowest Gamma that bounces on the way down; NaN if none does."""
    fold = thresholds(omega, XI).down
    stable = min(stable_ranges(omega, XI, 1), key=lambda r: abs(r.low - fold))
    first = fold + BEGIN * (stable.high - fold)
    found = start_on_stable_cycle(Cell(first, omega, XI), 1)
    rise = np.linspace(first, RAISED * first, RISES)
    line = _ramp(rise, omega, contact, np.linspace(0.0, 1.0, RISES), found.start if found else None)
    gamma = np.arange(rise[-1], END * fold, -step)
    start, lowest = Start(line.end_state[-1], Cell(float(rise[-1]), omega, XI)), np.nan
    for low in range(0, len(gamma), PIECE):
        part = gamma[low : low + PIECE].copy()
        line = _ramp(part, omega, contact, np.ones(len(part)), start)
        bounces = line.outcome != Outcome.AT_REST
        if bounces.any():
            lowest = float(part[bounces].min())
        if not bounces.all():
            break
        start = Start(line.end_state[-1], Cell(float(part[-1]), omega, XI))
    return lowest


def _ramp(gamma: np.ndarray, omega: float, contact: str, share: np.ndarray, start: Start | None) -> Line:
    """A ramp on a contact, of which each cell has this share of the restitution."""
    model, restitution = CONTACTS[contact]
    same = np.ones(len(gamma))
    return run_line(
        gamma, omega * same, XI * same, model=model, restitution=restitution * share, penetration=1e-3 * same,
        carry=True, settle=SETTLE, observe=OBSERVE, keep=1, certify=True, settle_until=SETTLE_UNTIL,
        start=start,
    )  # fmt: skip


def shift_text(shift: float, decimals: int) -> str:
    """A shift as tables print it: – for none, and no sign where it rounds to zero."""
    return "–" if math.isnan(shift) else f"{round(shift, decimals) + 0.0:.{decimals}f}"


def main() -> None:
    """Print the table."""
    step = options(__doc__, step=1e-4).step
    rows = []
    for omega in OMEGA:
        fold = thresholds(omega, XI).down
        moved = [end_of_bouncing(omega, contact, step) - fold for contact in CONTACTS]
        rows.append([f"{omega:.2f}", f"{fold:.6f}", *(shift_text(value, 4) for value in moved)])
    print(describe())
    print(table(["Omega", "fold", *CONTACTS], rows))


if __name__ == "__main__":
    main()
