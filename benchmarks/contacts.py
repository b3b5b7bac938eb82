"""How far the end of bouncing moves from its fold on other contacts than the ideal plate without restitution.

    python -m benchmarks.contacts [--step 1e-4]

At five frequencies of Fig. 9 (xi = 0.05) a ramp starts on the closed-form cycle above its fold, on each
contact, and descends until the spring stays on the plate. Prints the lowest Gamma that bounces less the fold.
"""

import argparse

import numpy as np

from benchmarks.machine import describe
from benchmarks.tables import table
from kernel.branches.starts import start_on_stable_cycle
from kernel.branches.thresholds import thresholds
from kernel.line import run_line
from kernel.models import rigid, soft
from kernel.params import Cell, Outcome

XI = 0.05
OMEGA = (0.56, 0.60, 0.62, 0.66, 0.70)

#: Contact: the module of its kernel and the arguments of its plate.
CONTACTS = {
    "soft, d = 1e-3": (soft, {"restitution": 0.0, "penetration": 1e-3, "adhesive": True}),
    "e = 0.1": (rigid, {"restitution": 0.1}),
    "e = 0.5": (rigid, {"restitution": 0.5}),
}

#: The ramp begins so far above the fold, and ends at this part of it.
ABOVE, LOWEST = 0.01, 0.6
SETTLE, OBSERVE, SETTLE_UNTIL = 400, 100, 4000

#: Cells computed at a time: a ramp ends soon after bouncing has.
PIECE = 50


def end_of_bouncing(omega: float, contact: str, step: float) -> float:
    """The lowest Gamma that bounces on the way down; NaN if none does."""
    fold = thresholds(omega, XI).down
    kernel, arguments = CONTACTS[contact]
    gamma = np.arange(fold + ABOVE, LOWEST * fold, -step)
    found = start_on_stable_cycle(Cell(float(gamma[0]), omega, XI), 1)
    start, lowest = found.start if found else None, np.nan
    for low in range(0, len(gamma), PIECE):
        part = np.ascontiguousarray(gamma[low : low + PIECE])
        same = np.ones(len(part))
        plate = kernel.plate(
            **{name: value * same if name != "adhesive" else value for name, value in arguments.items()}
        )
        line = run_line(
            part, omega * same, XI * same, plate=plate, carry=True, settle=SETTLE, observe=OBSERVE, keep=1,
            settle_until=SETTLE_UNTIL, start=start,
        )  # fmt: skip
        bounces = line.outcome != Outcome.AT_REST
        if bounces.any():
            lowest = float(part[bounces].min())
        if not bounces.all():
            break
        start = start._replace(state=line.end_state[-1], cell=Cell(float(part[-1]), omega, XI))
    return lowest


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
        rows.append([f"{omega:.2f}", f"{fold:.6f}", *(f"{value:+.4f}" for value in moved)])
        print(rows[-1])
    print(describe())
    print(table(["Omega", "fold", *CONTACTS], rows))


if __name__ == "__main__":
    main()
