"""How many flights fall on each part of a window: what is drawn where points would cover each other."""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

#: Flights counted at a time, so that what is needed beside them stays small.
BLOCK: Final = 500_000


class Window(NamedTuple):
    """What is looked at of a line; x in units of its axis, y in rad."""

    left: float
    right: float
    bottom: float
    top: float


def density(
    values: NDArray[np.float64],
    shown: NDArray[Any],
    flights: NDArray[Any],
    window: Window,
    width: int,
    height: int,
    log: bool,
) -> NDArray[np.int64]:
    """(height, width) how many flights fall on each part of the window, low flights first.

    values: (n,) where cells lie along the axis; shown: (n,) how many of `flights` (rad, cell after cell) are
    each one's. `log`: columns go in equal ratios; the window's left is above 0 then.
    """
    warp = np.log if log else np.asarray
    left, right = float(warp(window.left)), float(warp(window.right))
    inside = values > 0 if log else np.full(len(values), True)
    columns = np.full(len(values), -1)
    columns[inside] = bins(warp(values[inside]), left, right, width)
    column = np.repeat(columns.astype(np.int32), shown)
    counts = np.zeros(width * height, np.int64)
    for low in range(0, len(flights), BLOCK):
        here, row = column[low : low + BLOCK], bins(flights[low : low + BLOCK], *window[2:], height)
        seen = (here >= 0) & (row >= 0)
        counts += np.bincount(row[seen] * width + here[seen], minlength=len(counts))
    return counts.reshape(height, width)


def bins(values: NDArray[Any], low: float, high: float, n: int) -> NDArray[np.int64]:
    """The bin of each value, the highest value in the last one; -1 outside."""
    if not high > low:
        return np.where(values == low, 0, -1)
    found = np.floor((values - low) * (n / (high - low)))
    found[values == high] = n - 1
    found[(found < 0) | (found >= n)] = -1
    return found.astype(np.int64)
