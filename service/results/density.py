"""Counts flights per bin of a window: the picture of a diagram with more points than pixels."""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

#: Flights counted in one pass, which bounds the memory of the intermediate arrays.
BLOCK: Final = 500_000


class Window(NamedTuple):
    """A rectangle of a diagram; x in units of its axis, y in rad."""

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
    """(height, width) flights per bin of the window; row 0 holds the shortest flights.

    values: (n,) of the cells along the axis; shown: (n,) how many of `flights` (rad, cell after cell) each
    cell has. `log`: columns are spaced at equal ratios, and the window's left edge is above 0.
    """
    scale = np.log if log else np.asarray
    left, right = float(scale(window.left)), float(scale(window.right))
    drawable = values > 0 if log else np.full(len(values), True)
    cell_columns = np.full(len(values), -1)
    cell_columns[drawable] = bins(scale(values[drawable]), left, right, width)
    columns = np.repeat(cell_columns.astype(np.int32), shown)
    counts = np.zeros(width * height, np.int64)
    for low in range(0, len(flights), BLOCK):
        column = columns[low : low + BLOCK]
        row = bins(flights[low : low + BLOCK], window.bottom, window.top, height)
        inside = (column >= 0) & (row >= 0)
        counts += np.bincount(row[inside] * width + column[inside], minlength=len(counts))
    return counts.reshape(height, width)


def bins(values: NDArray[Any], low: float, high: float, n: int) -> NDArray[np.int64]:
    """The bin of each value among n between low and high, both included; -1 outside."""
    if not high > low:
        return np.where(values == low, 0, -1)
    index = np.floor((values - low) * (n / (high - low)))
    index[values == high] = n - 1
    index[(index < 0) | (index >= n)] = -1
    return index.astype(np.int64)
