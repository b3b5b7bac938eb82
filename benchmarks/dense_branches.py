"""Every fold, flip and Neimark-Sacker point below Gamma = 8, against an independent dense grid.

    python -m benchmarks.dense_branches [--cells 40] [--seed 1]

Of (1,1) and (1,2) at random springs, Omega from 0.25 to 2.5 and xi from 0.01 to 3, and of (1,3) at some, the
events of `kernel.branches` beside those that `tests/support/dense_branches.py` finds by sign changes on
20,000 points, from matrix exponentials alone. Missed, invented, and admissibility that differs; the largest
difference in T is the grid's own.
"""

import argparse

import numpy as np

from benchmarks.tables import table
from kernel.branches.events import branch_and_events
from tests.support import dense_branches

KINDS = ("fold", "flip", "neimark-sacker")


def main() -> None:
    """Print the table, and each difference."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    rows = {kind: np.zeros(5, int) for kind in KINDS}
    largest = 0.0
    for n in range(options.cells):
        omega, xi = float(rng.uniform(0.25, 2.5)), float(np.exp(rng.uniform(np.log(0.01), np.log(3.0))))
        for periods in (1, 2, 3) if n % 5 == 0 else (1, 2):
            _, events = branch_and_events(omega, xi, periods)
            whole = dense_branches.events(omega, xi, periods, 8.0)
            for kind in KINDS:
                keep = (events.kind == kind) & (events.gamma < 8.0)
                ours, lives = events.flight_time[keep], events.admissible[keep] == 0
                theirs = np.array([event.flight_time for event in whole if event.kind == kind])
                margin = np.array([event.margin for event in whole if event.kind == kind])
                apart = np.abs(ours[:, None] - theirs[None, :]) / (1.0 + theirs[None, :])
                missed = int((apart.min(axis=0, initial=np.inf) > 1e-5).sum())
                invented = int((apart.min(axis=1, initial=np.inf) > 1e-5).sum())
                other = 0
                if not missed and not invented and len(ours):
                    largest = max(largest, float(apart.min(axis=0).max()))
                    other = int((lives != (margin > -1e-12)).sum())
                if missed or invented or other:
                    print(f"({omega!r}, {xi!r}) (1,{periods}) {kind}: {ours} {theirs} {lives} {margin}")
                rows[kind] += len(theirs), int((margin > -1e-12).sum()), missed, invented, other
    print(f"{options.cells} springs; events agree within {largest:.1e} of T")
    print(
        table(
            ["kind", "events", "admissible", "missed", "invented", "admissibility differs"],
            [[kind, *map(str, row)] for kind, row in rows.items()],
        )
    )


if __name__ == "__main__":
    main()
