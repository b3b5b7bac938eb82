"""A line computed in parts, saved and restored between them, has the same bytes as in one go."""

import io
import random
from typing import Any

import numpy as np
import pytest
from kernel_runs import assert_same_bytes

from kernel.cell import RUN_FIELDS
from kernel.line import LineRun
from kernel.models.ball import BallPlate
from kernel.models.rigid import RigidPlate
from kernel.models.soft import SoftPlate
from kernel.models.stepped import SteppedPlate
from kernel.params import Line

#: At rest, periodic, settling and chaotic cells: more than there are lanes.
GAMMA = np.concatenate([[0.4], np.linspace(1.05, 7.0, 17)])
OMEGA, XI = np.full_like(GAMMA, 0.6), np.full_like(GAMMA, 0.05)
E, D = np.full_like(GAMMA, 0.3), np.full_like(GAMMA, 1e-2)

PLATES: dict[str, Any] = {
    "rigid": RigidPlate(0.0 * E),
    "rigid, restitution": RigidPlate(E),
    "soft": SoftPlate(E, D, True),
    "stepped": SteppedPlate(0.69 + 0.0 * E, D, np.full(len(GAMMA), 400), True, 0.5),
    "ball": BallPlate(0.0 * E),
    "ball, restitution": BallPlate(E),
}
CASES = [
    *((plate, carry, {}) for plate in PLATES for carry in (False, True)),
    *((plate, carry, {"settle_until": 330}) for plate in PLATES for carry in (False, True)),
    *(
        (plate, carry, {"certify": True, "settle_until": 330})
        for plate in PLATES
        if plate != "stepped"
        for carry in (False, True)
    ),
    *(
        (plate, True, {"exponents": 2, "settle_until": 330})
        for plate in ("rigid", "rigid, restitution", "soft")
    ),
    ("rigid", False, {"exponents": 2}),
]


def line_run(plate: str, carry: bool, options: dict[str, Any]) -> LineRun:
    fields = {"settle": 50, "observe": 30, "keep": 12, "micro_flight": 1e-3} | options
    return LineRun(GAMMA, OMEGA, XI, plate=PLATES[plate], carry=carry, **fields)


def in_parts(case: tuple[str, bool, dict[str, Any]], parts: random.Random) -> tuple[Line, int]:
    """The line, restored in a new run after every part from the bytes of what was saved; and the parts."""
    run, count = line_run(*case), 1
    longest = 400 if case[0].startswith("ball") else 4000  # a ball needs few steps
    while not run.advance(parts.choice([1, 17, longest // 10, longest])):
        file = io.BytesIO()
        np.savez(file, **run.save())
        file.seek(0)
        run, count = line_run(*case), count + 1
        with np.load(file) as saved:
            run.restore(saved)
    return run.line, count


@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_bytes_do_not_depend_on_the_parts(case: tuple[str, bool, dict[str, Any]]):
    whole = line_run(*case)
    assert whole.advance()
    line, parts = in_parts(case, random.Random(7))
    assert parts > 2
    assert len(set(whole.line.outcome)) > 1
    assert_same_bytes(line, whole.line)


def test_only_what_was_saved_of_the_same_line_is_restored():
    run = line_run("stepped", True, {})
    saved = run.save()
    run.advance(100)
    assert run.save()["Lanes.counts"][1] < len(GAMMA)
    other = line_run("rigid", False, {})
    damaged = [saved | {"Lanes.runs": array} for array in (np.zeros(3), np.zeros(RUN_FIELDS, int))]
    for wrong in ({}, other.save(), *damaged):
        with pytest.raises(ValueError, match="must be as saved by a run of the same line"):
            run.restore(wrong)
