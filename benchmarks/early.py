"""`settle_early` against every cycle computed: outcomes, modes, numbers of flights, deviations, time.

    python -m benchmarks.early [--cells 100000] [--seed 1] [--only "rigid;soft"]

Random cells from rest: Gamma 0.3 to 6, Omega 0.2 to 2, xi 0.01 to 1, 200 + 100 plate periods. Deviations are
of stored flights (times and take-off phases, rad) and of the elongation at the window's end, of cells with
the same outcome, mode and number of flights. Time is of the processor, both in turn, cell by cell the same.
"""

import math
import time
from typing import Any

import numpy as np

from benchmarks.lanes import Contact, cells_of
from benchmarks.measuring import describe, options, table
from kernel.line import run_line
from kernel.models import ball
from kernel.params import Line, Outcome

#: Cells of a part.
PART = 2_000


class Ball(Contact):
    """The ball."""

    def plate(self, n: int, random: np.random.Generator) -> Any:
        """The plate of n cells."""
        return ball.plate(restitution=np.full(n, self.e))


CONTACTS = (
    Contact("rigid, e = 0", 0.0),
    Contact("rigid, e = 0.3", 0.3),
    Contact("soft, adhesive, d = 1e-3", 0.01, 1e-3, True),
    Contact("soft, adhesive, d = 1e-6", 0.01, 1e-6, True),
    Contact("soft, nonadhesive, d = 1e-3", 0.01, 1e-3, False),
    Contact("soft, nonadhesive, d = 1e-6", 0.01, 1e-6, False),
    Ball("ball, e = 0", 0.0),
    Ball("ball, e = 0.3", 0.3),
)


def part(contact: Contact, seed: int, number: int) -> dict[str, Any]:
    """The figures of one part of a contact's cells."""
    random = np.random.default_rng([seed, CONTACTS.index(contact), number])
    cells = cells_of(PART, random)
    plate = contact.plate(PART, random)
    lines: list[Line] = []
    seconds = []
    for early in (False, True):
        began = time.process_time()
        lines.append(
            run_line(
                *cells, plate=plate, carry=False, settle=200, observe=100, keep=64, micro_flight=0.05,
                settle_early=early,
            )
        )  # fmt: skip
        seconds.append(time.process_time() - began)
    full, early_line = lines
    outcome = full.outcome != early_line.outcome
    modes = (full.bounces != early_line.bounces) | (full.periods != early_line.periods)
    mode = ~outcome & modes
    count = ~outcome & ~mode & (full.flights != early_line.flights)
    same = ~outcome & ~mode & ~count
    flights = np.abs(full.flight_time - early_line.flight_time)[same]
    phases = np.abs(full.takeoff_phase - early_line.takeoff_phase)[same]
    phases = np.minimum(phases, 2 * math.pi - phases)
    flight = np.nan_to_num(np.fmax(flights, phases)).max(axis=1, initial=0.0)
    end = np.nan_to_num(np.abs(full.end_state - early_line.end_state)[same][:, 4])
    ended = np.any(full.end_state != early_line.end_state, axis=1)
    return {
        "cells": PART,
        "periodic": int((full.outcome == Outcome.PERIODIC).sum()),
        "early": int(ended.sum()),
        "outcome": int(outcome.sum()), "mode": int(mode.sum()), "count": int(count.sum()),
        "flights": float(flight.max()), "above": int((flight > 1e-9).sum()), "end": float(end.max()),
        "seconds": seconds,
    }  # fmt: skip


def row(name: str, parts: list[dict[str, Any]]) -> list[object]:
    """The table's row of a contact."""

    def total(field: str) -> int:
        return sum(each[field] for each in parts)

    full, early = (sum(each["seconds"][i] for each in parts) for i in (0, 1))
    return [
        name, f"{total('cells'):,}", f"{total('periodic'):,}", f"{total('early'):,}",
        total("outcome"), total("mode"), total("count"),
        f"{max(each['flights'] for each in parts):.1e}", total("above"),
        f"{max(each['end'] for each in parts):.1e}", f"{early / full:.2f}",
    ]  # fmt: skip


def main() -> None:
    """Print the table."""
    arguments = options(__doc__, cells=100_000, seed=1, only="")
    print(describe(), flush=True)
    rows = []
    for contact in CONTACTS:
        if contact.name.startswith(tuple(arguments.only.split(";"))):
            part(contact, arguments.seed, 0)  # compiles
            parts = [
                part(contact, arguments.seed, number) for number in range(math.ceil(arguments.cells / PART))
            ]
            rows.append(row(contact.name, parts))
            print(*rows[-1], sep=" | ", flush=True)
    head = [
        "", "cells", "periodic", "other last digits", "another outcome", "another mode",
        "another number of flights", "largest deviation of flights, rad", "above 1e-9 rad",
        "of the elongation at the end", "time, ratio",
    ]  # fmt: skip
    print("\n" + table(head, rows))


if __name__ == "__main__":
    main()
