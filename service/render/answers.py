"""Answers as bytes, from a sweep and the parameters of a query: what `service.background` computes.

Arguments and results can be pickled. The functions raise what those of `service.results` raise.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from service.render import binary
from service.results import line as lines
from service.results import mode_map
from service.results.selection import Sweep


class Answer(NamedTuple):
    """The body of an answer."""

    content: bytes
    complete: bool
    dense: bool = False  # counts, which compress well


class Line(NamedTuple):
    """Which line of the grid, and which flights of it."""

    along: str
    values: Mapping[str, float | None]  # of the other axes
    direction: str | None
    min_flight: float | None


class View(NamedTuple):
    """A window of a line, None being its end, and the pixels it is drawn on."""

    left: float | None
    right: float | None
    bottom: float
    top: float | None
    log: bool
    width: int
    height: int
    most: int  # flights sent as points


def packed_line(sweep: Sweep, line: Line, view: View) -> Answer:
    """A line in binary form, its flights as points or, if there are too many, as density."""
    cells = lines.read_line(sweep, *line)
    window = lines.window_of(cells, view.left, view.right, view.bottom, view.top, log=view.log)
    dense = len(cells.flights) > view.most
    flights: dict[str, Any]
    if dense:
        flights = {"density": lines.counts(cells, window, view.width, view.height, log=view.log)}
    else:
        flights = {"flight_time": cells.flights}
    complete = cells.missing == 0 and not sweep.repairing
    attributes = {
        "along": line.along,
        "fixed": cells.fixed,
        "direction": cells.direction,
        "every": cells.every,
        "min_flight": cells.min_flight,
        "missing": cells.missing,
        "complete": complete,
        "points": len(cells.flights),
        "highest": cells.longest,
    }
    return Answer(binary.packed(attributes, {**cells.cells, **flights}), complete, dense)


def packed_plane(
    sweep: Sweep,
    xi: float | None,
    direction: str | None,
    gamma: tuple[float | None, float | None],
    omega: tuple[float | None, float | None],
    max_points: int,
    min_flight: float | None,
    hysteresis: bool,
) -> Answer:
    """A window of the mode map in binary form."""
    plane = mode_map.modes_between(
        sweep, xi, direction, gamma, omega, max_points, min_flight, hysteresis=hysteresis
    )
    attributes = {
        "xi": plane.xi,
        "direction": plane.direction,
        "complete": plane.complete,
        "every_gamma": plane.every,
        "every_omega": plane.every,
        "min_flight": plane.min_flight,
    }
    arrays = {"omega": plane.omega, "gamma": plane.gamma, **plane.arrays}
    return Answer(binary.packed(attributes, arrays), plane.complete, dense=True)
