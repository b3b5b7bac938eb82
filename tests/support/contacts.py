"""Contacts of one cell, by their numbers, and the cycles that springs on them settle to."""

from typing import Any

import numpy as np
from plates import Model, plate_of

from kernel.cycles.cycles import Point, cycle_from
from kernel.line import run_line
from kernel.params import Cell


def soft(restitution: float = 0.01, penetration: float = 1e-3, adhesive: bool = True) -> Any:
    return plate_of(Model.SOFT, np.array([restitution]), np.array([penetration]), adhesive)


def rigid(restitution: float) -> Any:
    return plate_of(Model.RIGID, np.array([restitution]), np.empty(0))


def attracting(plate: Any, cell: Cell) -> Point | None:
    """The cycle that a spring settles to from rest."""
    window = {"settle": 200, "observe": 100, "keep": 16, "certify": True, "carry": False}
    line = run_line(*np.array(cell)[:, None], plate=plate, **window)
    return cycle_from(plate, cell, int(line.periods[0]), line.end_state[0])
