"""Thresholds in closed form, of the rigid plate without restitution: what a sweep is compared with."""

import math

import numpy as np

from kernel.branches.events import flight_times
from kernel.branches.thresholds import UNRESOLVED, Thresholds, thresholds
from kernel.params import KernelInputError
from kernel.threshold import threshold
from worker.orbits import MAX_GRID


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
        with np.errstate(all="ignore"):  # an undamped spring may have poles
            return thresholds(omega, xi)
    except KernelInputError as error:
        return _undecided(omega, xi, str(error))


def predict_each(omega: tuple[float, ...], xi: float) -> list[Thresholds]:
    """`predict` at every omega: a call for workers."""
    return [predict(value, xi) for value in omega]


def _undecided(omega: float, xi: float, reason: str) -> Thresholds:
    gamma_th = float(threshold(omega, xi))
    return Thresholds(omega, xi, gamma_th, math.nan, math.nan, UNRESOLVED, reason, None, None)
