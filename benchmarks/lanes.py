"""Lanes against the scalar functions they stand in for, over random cells of `rigid` and `soft`.

    python -m benchmarks.lanes [--phases 50000] [--cells 100000] [--seed 1] [--only rigid,soft]

Phases: the first flight of lanes and of the scalar functions, from the same random state on the plate or, of
half the soft ones, above it, at extremes of the parameters too (Gamma 0.5 to 30, Omega 0.01 to 20, xi 1e-3 to
10; soft d 1e-8 to 0.1, e 1e-4 to 0.9). The largest difference of flight times and take-off phases, and the
flights that differ by more than 1e-6 rad: a first root missed, unless the motion is so sensitive (`--show`
prints them). Cells: outcomes, counts and modes of both, from rest and on ramps (Gamma 0.3 to 6, Omega 0.2 to
2, xi 0.01 to 1, 200 + 100 plate periods; soft d 1e-3, e = 0.01; a quarter as many on ramps). Rounding decides
chaotic cells, so their flight times are compared as samples (Kolmogorov-Smirnov).
"""

import math
from typing import Any, NamedTuple

import numpy as np

from benchmarks.measuring import describe, options, table
from kernel.line import run_line
from kernel.models import rigid, soft
from kernel.params import Line, Outcome

#: Cells of a line of a ramp.
LENGTH = 50


class Contact(NamedTuple):
    """A contact model with its fields, which are numbers or None: drawn at random for each cell."""

    name: str
    e: float | None
    d: float | None = None
    adhesive: bool | None = None  # None: rigid

    @property
    def model(self) -> str:
        """Its kind."""
        return "rigid" if self.adhesive is None else "soft"

    def plate(self, n: int, random: np.random.Generator) -> Any:
        """The plate of n cells."""
        e = np.full(n, self.e) if self.e is not None else 10 ** random.uniform(-4, -0.05, n)
        if self.adhesive is None:
            return rigid.plate(restitution=e)
        d = np.full(n, self.d) if self.d is not None else 10 ** random.uniform(-8, -1, n)
        return soft.plate(restitution=e, penetration=d, adhesive=self.adhesive)


#: For single phases, and for whole cells.
PHASES = (
    Contact("rigid, e = 0", 0.0),
    Contact("rigid, e = 0.3", 0.3),
    Contact("soft, adhesive", None, None, True),
    Contact("soft, nonadhesive", None, None, False),
)
CELLS = (
    Contact("rigid", 0.0),
    Contact("rigid, e = 0.3", 0.3),
    Contact("soft, adhesive", 0.01, 1e-3, True),
    Contact("soft, nonadhesive", 0.01, 1e-3, False),
)


def both(cells: tuple[np.ndarray, ...], plate: Any, **options: Any) -> tuple[Line, Line]:
    """The same cells in lanes and by the scalar functions."""
    lanes, scalar = (
        run_line(*cells, plate=plate, in_lanes=in_lanes, **options) for in_lanes in (True, False)
    )
    return lanes, scalar


def states_of(plate: Any, cells: tuple[np.ndarray, ...], random: np.random.Generator) -> np.ndarray:
    """Random states (n, 6) on the plate, of which half of those of a soft one are above it."""
    gamma, omega, _ = cells
    n = len(gamma)
    states = np.zeros((n, 6))
    states[:, 0] = random.uniform(0, 2 * math.pi, n)
    states[:, 4] = -(omega**2) / gamma + random.normal(0, 1, n) * np.minimum(omega, 1.0)
    states[:, 5] = random.normal(0, 1, n)
    if isinstance(plate, soft.SoftPlate):
        d = plate.penetration
        states[:, 2] = -2.0 * d**2 / gamma * 10 ** random.uniform(-2, 2, n)
        states[:, 3] = random.normal(0, 1, n) * d * 10 ** random.uniform(-2, 1, n)
        above = random.random(n) < 0.5
        states[above, 2] = 10 ** random.uniform(-6, 1, above.sum())
        states[above, 3] = random.normal(0, 1, above.sum())
    return states


def phases(contact: Contact, n: int, random: np.random.Generator, show: bool) -> list[object]:
    """A row: the first flights of two plate periods from random states."""
    cells = (
        10 ** random.uniform(-0.3, 1.5, n),
        10 ** random.uniform(-2, 1.3, n),
        10 ** random.uniform(-3, 1, n),
    )
    plate = contact.plate(n, random)
    states = states_of(plate, cells, random)
    lanes, scalar = both(cells, plate, carry=False, states=states, settle=0, observe=2, keep=1024)
    first = np.isfinite(lanes.flight_time[:, 0]) & np.isfinite(scalar.flight_time[:, 0])
    time = np.abs(lanes.flight_time - scalar.flight_time)[:, 0]
    phase = np.abs(lanes.takeoff_phase - scalar.takeoff_phase)[:, 0]
    difference = np.where(first, np.fmax(time, np.fmin(phase, 2 * math.pi - phase)), 0.0)
    other = np.isfinite(lanes.flight_time[:, 0]) != np.isfinite(scalar.flight_time[:, 0])
    if show:
        for i in np.flatnonzero((difference > 2e-9) | other)[:20]:
            fields = [float(field[i]) for field in plate if isinstance(field, np.ndarray)]
            ends = [(float(x.takeoff_phase[i, 0]), float(x.flight_time[i, 0])) for x in (lanes, scalar)]
            print([float(axis[i]) for axis in cells], fields, states[i].tolist(), *ends)
    found = difference[first]
    worst = f"{found.max():.1e}", f"{np.quantile(found, 0.999):.0e}"
    return [contact.name, f"{first.sum():,}", *worst, int((found > 1e-6).sum()), int(other.sum())]


def cells_of(n: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random cells (n,)."""
    return random.uniform(0.3, 6, n), random.uniform(0.2, 2, n), 10 ** random.uniform(-2, 0, n)


def outcomes(contact: Contact, n: int, ramp: bool, random: np.random.Generator) -> list[object]:
    """A row: how many cells have another outcome, mode or number of flights in lanes."""
    if ramp:
        lines = n // LENGTH
        _, omega, xi = (np.repeat(axis, LENGTH) for axis in cells_of(lines, random))
        cells, options = (np.tile(np.linspace(0.3, 6, LENGTH), lines), omega, xi), {"start": [None] * lines}
    else:
        cells, options = cells_of(n, random), {}
    plate = contact.plate(len(cells[0]), random)
    lanes, scalar = both(cells, plate, carry=ramp, settle=200, observe=100, keep=32, **options)
    regular = (lanes.outcome == Outcome.PERIODIC) & (scalar.outcome == Outcome.PERIODIC)
    regular |= (lanes.outcome == Outcome.AT_REST) & (scalar.outcome == Outcome.AT_REST)
    moved = regular & ((lanes.bounces != scalar.bounces) | (lanes.periods != scalar.periods))
    counts = regular & ~moved & (lanes.flights != scalar.flights)
    failed = [int((line.outcome == Outcome.UNRESOLVED).sum()) for line in (lanes, scalar)]
    chaotic = (lanes.outcome == Outcome.APERIODIC) & (scalar.outcome == Outcome.APERIODIC)
    distance, allowed = _ks(lanes.flight_time[chaotic], scalar.flight_time[chaotic])
    return [
        f"{contact.name}, {'ramp' if ramp else 'from rest'}", f"{len(lanes.outcome):,}",
        f"{regular.sum():,}", int(moved.sum()), int(counts.sum()),
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
    arguments = options(__doc__, phases=50_000, cells=100_000, seed=1, only="rigid,soft", show=False)
    print(describe(), flush=True)
    selected = arguments.only.split(",")
    random = np.random.default_rng(arguments.seed)
    rows = [
        phases(contact, arguments.phases, random, arguments.show)
        for contact in PHASES
        if arguments.phases and contact.model in selected
    ]
    head = ["phases", "flights", "largest difference, rad", "1 in 1,000 above", "above 1e-6", "in one only"]
    print("\n" + table(head, rows) + "\n", flush=True)
    rows = [
        outcomes(contact, arguments.cells // (4 if ramp else 1), ramp, random)
        for contact in CELLS
        for ramp in (False, True)
        if contact.model in selected
    ]
    head = [
        "cells", "", "periodic or at rest in both", "another mode", "another count", "another outcome",
        "unresolved", "chaotic: KS distance (1 %)",
    ]  # fmt: skip
    print(table(head, rows))


if __name__ == "__main__":
    main()
