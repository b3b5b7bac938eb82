"""Contacts of one cell, by their numbers."""

from typing import Any

import numpy as np
from plates import Model, plate_of


def soft(restitution: float = 0.01, penetration: float = 1e-3, adhesive: bool = True) -> Any:
    return plate_of(Model.SOFT, np.array([restitution]), np.array([penetration]), adhesive)


def rigid(restitution: float) -> Any:
    return plate_of(Model.RIGID, np.array([restitution]), np.empty(0))
