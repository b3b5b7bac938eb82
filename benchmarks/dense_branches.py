"""Every fold, flip, Neimark-Sacker point and graze below Gamma = 8, against an independent dense grid.

    python -m benchmarks.dense_branches [--cells 40] [--seed 1] [--no-grazes]

Of (1,1) and (1,2) at random springs, Omega from 0.25 to 2.5 and xi from 0.01 to 3, and of (1,3) at some, the
events of `kernel.cycles` beside those that `tests/support/dense_branches.py` finds by sign changes on
20,000 points, from matrix exponentials alone. Missed, invented, and admissibility that differs; the largest
difference in T is the grid's own.

Grazes and immediate take-offs, of orbits that are not admissible too: on 20,000 flight times (20 to 50 times
as many as the branch has points), where a condition breaks that is none of ours within two of them is missed.
Around each of ours the same samples tell 1e-6 rad on both sides whether its condition changes; not decided
are those of minima less deep than 1e-8. They take some ten seconds a branch.
"""

import numpy as np

from benchmarks.measuring import options, table
from kernel.cycles.events import Events, branch_and_events
from tests.support import dense_branches

KINDS = ("fold", "flip", "neimark-sacker")
GRAZES = {
    "graze-flight": ("gap", "impact"),
    "graze-contact": ("force", "takeoff"),
    "immediate-takeoff": ("landing",),
}

#: The largest Gamma that is looked at.
BELOW = 8.0

#: rad from one of the dense grid's flight times to the next, for each plate period.
SPACING = 2.0 * np.pi / 20_000

#: rad beside an event.
ASIDE = 1e-6


def grazes(events: Events, omega: float, xi: float, periods: int) -> np.ndarray:
    """Changes on the dense grid, missed ones, our grazes, invented and not decided ones (5,)."""
    changes = dense_branches.breaks(omega, xi, periods, BELOW)
    ours = np.isin(events.kind, list(GRAZES))
    times = events.flight_time[ours]
    within = SPACING * periods
    missed = [
        (low, high) for low, high in changes
        if not ((times > low - within) & (times < high + within)).any()
    ]  # fmt: skip
    invented = undecided = 0
    ours &= events.gamma < BELOW
    for kind, t in zip(events.kind[ours], events.flight_time[ours], strict=True):
        low, high = (dense_branches.held(omega, xi, periods, t + aside) for aside in (-ASIDE, ASIDE))
        sides = [(getattr(low, name)[0], getattr(high, name)[0]) for name in GRAZES[str(kind)]]
        if any((a > 0.0) != (b > 0.0) for a, b in sides):
            continue
        small = any(abs(a) < dense_branches.DEEP for a, _ in sides)
        undecided, invented = undecided + small, invented + (not small)
        print(f"({omega!r}, {xi!r}) (1,{periods}) {kind} at {t!r}: {'not decided' if small else 'invented'}")
    small = [_is_small(omega, xi, periods, low, high) for low, high in missed]
    for (low, high), shallow in zip(missed, small, strict=True):
        what = "not decided" if shallow else "missed"
        print(f"({omega!r}, {xi!r}) (1,{periods}) {what} between {low!r} and {high!r}")
    return np.array(
        [len(changes), len(missed) - sum(small), int(ours.sum()), invented, undecided + sum(small)]
    )


def _is_small(omega: float, xi: float, periods: int, low: float, high: float) -> bool:
    """Whether between two flight times a minimum crosses not zero but the depth that is not decided."""
    sides = [dense_branches.held(omega, xi, periods, t) for t in (low, high)]
    if any((getattr(sides[0], name)[0] > 0.0) != (getattr(sides[1], name)[0] > 0.0)
           for name in ("gap", "impact", "force", "landing", "takeoff")):  # fmt: skip
        return False
    depths = [getattr(side, name)[0] for side in sides for name in ("gap", "force")]
    return any(abs(depth + dense_branches.DEEP) < dense_branches.DEEP for depth in depths)


def main() -> None:
    """Print the table, and each difference."""
    given = options(__doc__, cells=40, seed=1, no_grazes=False)
    rng = np.random.default_rng(given.seed)
    rows = {kind: np.zeros(5, int) for kind in KINDS}
    largest = 0.0
    touching = np.zeros(5, int)
    for n in range(given.cells):
        omega, xi = float(rng.uniform(0.25, 2.5)), float(np.exp(rng.uniform(np.log(0.01), np.log(3.0))))
        for periods in (1, 2, 3) if n % 5 == 0 else (1, 2):
            _, events = branch_and_events(omega, xi, periods)
            if not given.no_grazes:
                touching += grazes(events, omega, xi, periods)
            whole = dense_branches.events(omega, xi, periods, BELOW)
            for kind in KINDS:
                keep = (events.kind == kind) & (events.gamma < BELOW)
                ours, lives = events.flight_time[keep], events.violations[keep] == 0
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
    print(f"{given.cells} springs; events agree within {largest:.1e} of T")
    print(
        table(
            ["kind", "events", "violations", "missed", "invented", "admissibility differs"],
            [[kind, *map(str, row)] for kind, row in rows.items()],
        )
    )
    if not given.no_grazes:
        headings = ["changes on the dense grid", "missed", "grazes", "invented", "not decided"]
        print(table(headings, [list(map(str, touching))]))


if __name__ == "__main__":
    main()
