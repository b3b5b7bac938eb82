"""Mode maps: outcome and mode of every cell of the (omega, gamma) plane at one xi."""

from typing import Annotated, Any, Final

import numpy as np
import xarray
from pydantic import Field

from service.results import mode_map
from service.results.counting import LABEL
from service.results.hysteresis import check_both_ways
from service.results.selection import MAX_READ, Stored, between, directions_of, nearest_index
from service.views.variables import VARIABLES, coordinate, variable
from service.views.view import Direction, Estimate, Every, MinFlight, Number, Query, View
from worker import schema
from worker.spec import SweepSpec

_ROWS: Final = {
    row.name: row
    for row in (
        *(row for row in schema.RECORD if row.name in schema.MODE_ARRAYS),
        schema.OUTCOME, LABEL, schema.COMPUTED, VARIABLES["hysteresis"],
    )
}  # fmt: skip


class ModesQuery(Query):
    """The plane of the grid at the nearest value of xi."""

    xi: Number | None = None
    direction: Direction = None
    min_flight: MinFlight = None
    every: Every = 1
    hysteresis: Annotated[bool, Field(description="of a sweep ramped both ways: where they differ")] = False
    gamma_start: Number | None = None
    gamma_stop: Number | None = None
    omega_start: Number | None = None
    omega_stop: Number | None = None


def compute(study: Stored[SweepSpec], query: ModesQuery) -> xarray.Dataset:
    """Outcome, bounces and plate periods of every cell.

    The cells are those of the plane at one ξ. A sweep ramped both ways has the dimension `direction`,
    unless one is selected. An adaptive map has `computed`: the other cells have the values of the nearest
    corner or centre of their block. The attribute `computed_share` is the share of cells that were computed.
    """
    spec, directions = study.spec, directions_of(study.spec, query.direction)
    window = _window(spec, query)
    planes = [
        mode_map.modes(
            study, query.xi, direction, every=query.every, min_flight=query.min_flight,
            hysteresis=query.hysteresis and direction == directions[0], **window,
        )
        for direction in directions
    ]  # fmt: skip
    first, both = planes[0], len(planes) > 1
    dims = ("direction",) * both + ("omega", "gamma")
    data = {}
    for name, values in first.arrays.items():
        compared = name == "hysteresis"
        stacked = np.stack([plane.arrays[name] for plane in planes]) if both and not compared else values
        data[name] = variable(("omega", "gamma") if compared else dims, stacked, _ROWS[name])
    coords = {
        "direction": coordinate("direction", list(directions) if both else directions[0]),
        "xi": coordinate("xi", first.xi),
        "omega": coordinate("omega", first.omega),
        "gamma": coordinate("gamma", first.gamma),
    }
    attrs: dict[str, Any] = {
        "min_flight": first.min_flight, "every": query.every, "model": spec.model.kind,
        "complete": all(plane.complete for plane in planes),
    }  # fmt: skip
    if first.computed is not None:
        attrs["computed_share"] = first.computed
    return xarray.Dataset(data, coords, attrs)


def _window(spec: SweepSpec, query: ModesQuery) -> dict[str, range]:
    """The indices of the cells between the given values of omega and gamma."""
    ends = {"omega": (query.omega_start, query.omega_stop), "gamma": (query.gamma_start, query.gamma_stop)}
    return {axis: between(spec.axis_values(axis), *values) for axis, values in ends.items()}


def estimate(spec: SweepSpec, query: ModesQuery) -> Estimate:
    """All cells of the plane. Raises InvalidRequest for a plane that the sweep does not have."""
    nearest_index(spec, "xi", query.xi)
    directions = directions_of(spec, query.direction)
    if query.hysteresis:
        check_both_ways(spec)
    mode_map.check_min_flight(spec, query.min_flight)
    lengths = {axis: len(part) for axis, part in _window(spec, query).items()}
    if len(directions) > 1:
        lengths = {"direction": len(directions), **lengths}
    _, flights = mode_map.plane_size(spec, query.min_flight, MAX_READ, query.every)
    compared = mode_map.comparison_memory(spec) if query.hysteresis else 0
    return Estimate(
        lengths, ("omega", "gamma"), query.every, reads=("omega", "gamma"),
        memory=100 * flights + compared, most=mode_map.most_cells(spec, query.min_flight, MAX_READ),
    )  # fmt: skip


VIEW: Final = View(
    "modes", "Mode map", SweepSpec, ModesQuery, compute, estimate,
    variables=tuple(_ROWS.values()), rows="outcome",
)  # fmt: skip
