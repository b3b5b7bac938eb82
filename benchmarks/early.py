"""`settle_early` against every cycle computed: outcomes, modes, numbers of flights, deviations, time.

    python -m benchmarks.early [--cells 100000] [--seed 1] [--only "rigid;soft"] [--file early.jsonl]

Random cells from rest: Gamma 0.3 to 6, Omega 0.2 to 2, xi 0.01 to 1, 200 + 100 plate periods. Each contact's
cells are computed in parts. With `--file` every part is written there when it is done, and parts that are in
it are not computed again, so that an interrupted run goes on. Deviations are of stored flights (times and
take-off phases, rad) and of the elongation at the window's end, of cells with the same outcome, mode and
number of flights. Time is of the processor, both in turn, cell by cell the same.
"""

import argparse
import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.lanes import Contact, cells_of
from benchmarks.machine import describe
from benchmarks.tables import table
from kernel.line import run_line
from kernel.models import ball
from kernel.params import Line, Outcome

#: What must be the same.
MODE = ("outcome", "bounces", "periods", "flights")

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
    different = np.flatnonzero(outcome | mode | count)
    return {
        "contact": contact.name, "part": number, "seed": seed, "cells": PART,
        "flying": int((full.outcome != Outcome.AT_REST).sum()),
        "periodic": int((full.outcome == Outcome.PERIODIC).sum()),
        "chaotic": int((full.outcome == Outcome.APERIODIC).sum()),
        "early": int(ended.sum()),
        "outcome": int(outcome.sum()), "mode": int(mode.sum()), "count": int(count.sum()),
        "flights": float(flight.max()), "above": int((flight > 1e-9).sum()), "end": float(end.max()),
        "seconds": seconds,
        "cells_that_differ": [
            [*(float(axis[i]) for axis in cells),
             *(int(getattr(line, name)[i]) for line in lines for name in MODE)]
            for i in different
        ],
    }  # fmt: skip


def read(file: Path | None) -> list[dict[str, Any]]:
    """The parts in a file."""
    return [] if file is None or not file.exists() else [json.loads(x) for x in file.read_text().splitlines()]


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
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="how the contacts' names begin, separated by semicolons")
    parser.add_argument("--file", type=Path, help="of the parts that are done")
    arguments = parser.parse_args()
    print(describe(), flush=True)
    done = [each for each in read(arguments.file) if each["seed"] == arguments.seed]
    rows = []
    for contact in CONTACTS:
        if not contact.name.startswith(tuple(arguments.only.split(";"))):
            continue
        parts = {each["part"]: each for each in done if each["contact"] == contact.name}
        for number in range(math.ceil(arguments.cells / PART)):
            if number not in parts:
                if not parts:
                    part(contact, arguments.seed, number)  # compiles
                parts[number] = part(contact, arguments.seed, number)
                if arguments.file is not None:
                    with arguments.file.open("a") as file:
                        file.write(json.dumps(parts[number]) + "\n")
        rows.append(row(contact.name, list(parts.values())))
        print(*rows[-1], sep=" | ", flush=True)
    head = [
        "", "cells", "periodic", "other last digits", "another outcome", "another mode",
        "another number of flights", "largest deviation of flights, rad", "above 1e-9 rad",
        "of the elongation at the end", "time, ratio",
    ]  # fmt: skip
    print("\n" + table(head, rows))


if __name__ == "__main__":
    main()
