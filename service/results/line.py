"""A line of cells for the page: outcome and mode of each cell, and its flights as points or as density."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.params import Outcome
from kernel.recount import counted
from service.errors import InvalidRequest
from service.results.density import Window, density
from service.views.selection import (
    MAX_READ,
    Stored,
    arrays_of_modes,
    directions_of,
    fixed_axes,
    read_direction,
    recounted,
    shortest,
    thinning,
)
from worker.spec import SweepSpec

#: Counts above this are sent as this: one byte per bin.
MAX_COUNT: Final = 255


@dataclass(frozen=True)
class FlightLine:
    """n cells along one axis and their flights, cell after cell."""

    fixed: dict[str, float]
    direction: str
    cells: dict[
        str, NDArray[Any]
    ]  # each (n,): values, shown, outcome, bounces, periods, with exponents label
    flights: NDArray[np.float32]  # (sum of shown,) rad; single precision is finer than a screen
    every: int  # the cells are every n-th of the axis
    min_flight: float  # rad; the flights are those that count

    @property
    def missing(self) -> int:
        """Cells that are not computed yet."""
        return int(np.count_nonzero(self.cells["outcome"] == Outcome.MISSING))

    @property
    def longest(self) -> float:
        """The longest flight, rad; 0 if there is none."""
        return float(self.flights.max(initial=0.0))


def read_line(
    sweep: Stored[SweepSpec],
    along: str,
    values: Mapping[str, float | None],
    direction: str | None,
    min_flight: float | None,
) -> FlightLine:
    """The cells along `along` and their flights that count; a very long line is thinned.

    `min_flight` is in rad; None is the sweep's `micro_flight`. Raises InvalidRequest as
    `selection.fixed_axes`.
    """
    spec = sweep.spec
    fixed = fixed_axes(spec, along, values)
    direction = directions_of(spec, direction)[0]
    axis = spec.axis_values(along)
    every = thinning((len(axis),), spec.keep, MAX_READ) or len(axis)
    indices = {name: point.index for name, point in fixed.items()} | {along: slice(None, None, every)}
    names = {"flight_time", "flights", *arrays_of_modes(spec, min_flight)}
    arrays = read_direction(sweep, sorted(names), direction, indices)
    times = arrays["flight_time"]
    shown = counted(times, arrays["flights"], shortest(spec, min_flight))
    cells = {"values": axis[::every], "shown": np.count_nonzero(shown, axis=1).astype(np.int32)}
    cells |= recounted(spec, arrays, min_flight)
    fixed_values = {name: point.value for name, point in fixed.items()}
    return FlightLine(
        fixed_values, direction, cells, times[shown].astype(np.float32), every, shortest(spec, min_flight)
    )


def window_of(
    line: FlightLine,
    left: float | None,
    right: float | None,
    bottom: float,
    top: float | None,
    *,
    log: bool,
) -> Window:
    """The window between these edges; None is the end of the line. Raises InvalidRequest for an empty one."""
    values = line.cells["values"]
    window = Window(
        float(values[0]) if left is None else left,
        float(values[-1]) if right is None else right,
        bottom,
        max(line.longest, bottom) if top is None else top,
    )
    if log and window.left <= 0:
        raise InvalidRequest.of("left", f"must be above 0 on a logarithmic axis, not {window.left!r}")
    if window.right < window.left:
        raise InvalidRequest.of("right", f"must not be below left, which is {window.left!r}")
    if window.top < window.bottom:
        raise InvalidRequest.of("top", f"must not be below bottom, which is {window.bottom!r}")
    return window


def counts(line: FlightLine, window: Window, width: int, height: int, *, log: bool) -> NDArray[np.uint8]:
    """(height, width) flights per bin of the window, at most MAX_COUNT; row 0 holds the shortest flights."""
    flights = density(line.cells["values"], line.cells["shown"], line.flights, window, width, height, log)
    return np.minimum(flights, MAX_COUNT).astype(np.uint8)
