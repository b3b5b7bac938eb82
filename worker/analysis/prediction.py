"""Thresholds in closed form, of the rigid plate without restitution: what a sweep is compared with."""

import math
from typing import Final

from kernel.branches.events import flight_times
from kernel.branches.thresholds import UNRESOLVED, Thresholds, thresholds
from kernel.params import KernelInputError
from kernel.threshold import threshold

#: Points of the grid on which a branch is looked at, at most: below Omega = 0.04 or so a branch needs more,
#: and the cost grows with their square, to 0.4 s at this limit.
MAX_GRID: Final = 2_000


def predict(omega: float, xi: float) -> Thresholds:
    """The thresholds, omega > 0 and xi >= 0; `unresolved` also where the branches are not looked at."""
    try:
        points = len(flight_times(omega, xi, 1))
    except KernelInputError as error:
        return _undecided(omega, xi, str(error))
    if points > MAX_GRID:
        reason = (
            f"omega: {omega:g} takes branches of {points:,} points; they are looked at up to {MAX_GRID:,}"
        )
        return _undecided(omega, xi, reason)
    try:
        return thresholds(omega, xi)
    except KernelInputError as error:
        return _undecided(omega, xi, str(error))


def predict_each(omega: tuple[float, ...], xi: float) -> list[Thresholds]:
    """`predict` at every omega: a call for workers."""
    return [predict(value, xi) for value in omega]


def _undecided(omega: float, xi: float, reason: str) -> Thresholds:
    gamma_th = float(threshold(omega, xi))
    return Thresholds(omega, xi, gamma_th, math.nan, math.nan, UNRESOLVED, reason, None, None)
