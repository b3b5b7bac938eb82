"""Answers as bytes, from a sweep and the parameters of a query: what `service.background` computes.

Arguments and results can be pickled. The functions raise what those of `service.results` raise.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from service.render import binary
from service.results import line as lines
from service.views import modes
from service.views.selection import Stored, between, thinning
from worker.spec import SweepSpec


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


def packed_line(sweep: Stored[SweepSpec], line: Line, view: View) -> Answer:
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
    sweep: Stored[SweepSpec],
    xi: float | None,
    direction: str | None,
    gamma: tuple[float | None, float | None],
    omega: tuple[float | None, float | None],
    max_points: int,
    min_flight: float | None,
    hysteresis: bool,
) -> Answer:
    """A window of the mode map in binary form."""
    spec = sweep.spec
    columns = between(spec.axis_values("gamma"), *gamma)
    rows = between(spec.axis_values("omega"), *omega)
    query = modes.ModesQuery(
        xi=xi, direction=direction or spec.directions[0], min_flight=min_flight, hysteresis=hysteresis,
        gamma_start=gamma[0], gamma_stop=gamma[1], omega_start=omega[0], omega_stop=omega[1],
    )  # fmt: skip
    most = min(max_points, modes.estimate(spec, query).most or max_points)
    every = thinning((len(rows), len(columns)), 1, most) or 1
    found = modes.compute(sweep, query.model_copy(update={"every": every}))
    attributes = {
        "xi": found.xi.item(),
        "direction": found.direction.item(),
        "complete": found.attrs["complete"],
        "every_gamma": every,
        "every_omega": every,
        "min_flight": found.attrs["min_flight"],
    }
    arrays = {name: found[name].values for name in ("omega", "gamma", *found.data_vars)}
    return Answer(binary.packed(attributes, arrays), bool(found.attrs["complete"]), dense=True)
