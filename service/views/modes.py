"""Mode maps: outcome and mode of every cell of the plane (omega, gamma) at one xi, and hysteresis."""

from collections.abc import Mapping
from enum import IntEnum
from math import prod
from typing import Annotated, Any, Final, Literal

import numpy as np
import xarray
from numpy.typing import NDArray
from pydantic import Field

from kernel.modes import counted
from kernel.params import Outcome
from service.errors import InvalidRequest
from service.pictures import Figure, by_direction, draw_modes
from service.views import selection
from service.views.variables import cells_dataset, coordinate, row, variable
from service.views.view import Direction, Estimate, Every, Hide, Log, MinFlight, Number, Query, View
from worker.sweep import SweepSpec, schema
from worker.sweep.schema import COMPUTED, OUTCOME

#: Cells of one mode are on different cycles if their sorted flights differ by more than this, rad. A cycle is
#: found when its flights repeat within 1e-6 rad; near a fold they may still be 1e-4 from their limit.
OTHER_FLIGHTS: Final = 1e-3

#: Outcomes that do not identify an attractor. Such cells are not compared.
_UNKNOWN: Final = (Outcome.MISSING, Outcome.UNRESOLVED, Outcome.DIVERGED, Outcome.SETTLING)

#: Flights of both directions that are compared at a time, and bytes of memory of each: time, phase, whether
#: it counts, and the order.
_COMPARED: Final = selection.MAX_READ // 4
_PER_COMPARED: Final = 48

#: Bytes of memory for each cell of a plane with cells filled in.
_PER_FILLED: Final = 64

_PLANE: Final = ("omega", "gamma")
_ROWS: Final = (
    *selection.MODES, COMPUTED, schema.LYAPUNOV, schema.LYAPUNOV_ERROR, *schema.CERTIFICATE,
)  # fmt: skip
_HYSTERESIS: Final = row(
    "hysteresis", (), "|u1", "how the ramps up and down compare", flag_values=[0, 1, 2],
    flag_meanings="none other_mode other_flights",
)  # fmt: skip

Window = dict[str, slice]


class Hysteresis(IntEnum):
    """The difference between a cell's two directions."""

    NONE = 0  # they agree, or this is unknown
    MODE = 1  # different outcomes or modes
    FLIGHTS = 2  # the same mode with different flights


class ModesQuery(Query):
    """The plane of the grid at the nearest value of xi."""

    xi: Number | None = None
    direction: Direction = None
    min_flight: MinFlight = None
    every: Every = 1
    log: Log = None
    hysteresis: Annotated[bool, Field(description="where up and down differ, if a sweep has both")] = False
    color: Literal["mode", "multiplier"] = Field(
        "mode", description="multiplier: the margin of stability, of a sweep that certifies cells"
    )
    hide: Hide = None
    gamma_start: Number | None = None
    gamma_stop: Number | None = None
    omega_start: Number | None = None
    omega_stop: Number | None = None


def compute(study: selection.Stored[SweepSpec], query: ModesQuery) -> xarray.Dataset:
    """Outcome, bounces and plate periods of every cell.

    The cells are those of the plane at one ξ. A sweep ramped both ways has the dimension `direction`,
    unless one is selected. In an adaptive map `computed` marks the computed cells, the attribute
    `computed_share` is their share; others have the mode of their block, a neighbour's label and multiplier.
    With the color `multiplier` cells have their certificates, too. Cells of classes to `hide` are `missing`.
    """
    spec, directions = study.spec, selection.directions_of(study.spec, query.direction)
    xi, window = selection.nearest_index(spec, "xi", query.xi), _window(spec, query)
    certificates = [row.name for row in schema.CERTIFICATE] if query.color == "multiplier" else []
    names = (*selection.arrays_of_modes(spec, query.min_flight), *certificates)
    cells = {}
    for direction in directions:
        arrays = selection.read_direction(study, names, direction, {"xi": xi.index, **window})
        cells[direction] = selection.recounted(spec, arrays, query.min_flight)
        cells[direction] |= {name: arrays[name] for name in certificates}
        if spec.fills_in and certificates:
            cells[direction]["multiplier"] = selection.filled_in(cells[direction], "multiplier")
    coords = {"xi": coordinate("xi", xi.value)}
    coords |= {axis: coordinate(axis, spec.axis_values(axis)[part]) for axis, part in window.items()}
    attrs: dict[str, Any] = {
        "min_flight": selection.shortest(spec, query.min_flight), "every": query.every,
        "model": spec.model.kind,
        "complete": all(study.is_complete(arrays["outcome"]) for arrays in cells.values()),
    }  # fmt: skip
    attrs |= query.model_dump(include={"hide", "log"}, exclude_none=True)
    if query.hide is not None:
        cells = {name: _without(arrays, query.hide) for name, arrays in cells.items()}
    if spec.fills_in:
        attrs["computed_share"] = _computed_share(study, xi.index, directions[0])
    result = cells_dataset(cells, coords, _ROWS, attrs)
    if spec.fills_in and certificates:
        result["multiplier"].attrs["comment"] += "; of skipped cells that of a computed neighbour"
    if query.hysteresis:
        compared, complete = _hysteresis(study, xi.index, window, query.min_flight)
        result["hysteresis"] = variable(_PLANE, compared, _HYSTERESIS)
        result.attrs["complete"] &= complete
    return result


def _without(arrays: Mapping[str, NDArray[Any]], hide: str) -> dict[str, NDArray[Any]]:
    """The arrays of a plane, with the cells of hidden classes as missing."""
    hidden = selection.hidden_cells(arrays, hide, arrays.get("multiplier"))
    missing = dict.fromkeys((selection.LABEL.name, *schema.MODE_ARRAYS), 0.0)
    missing |= {row.name: np.nan for row in schema.CERTIFICATE}
    return {
        name: np.where(hidden, values.dtype.type(missing[name]), values) if name in missing else values
        for name, values in arrays.items()
    }


def _window(spec: SweepSpec, query: ModesQuery) -> Window:
    """The indices of the cells between the given values of omega and gamma."""
    parts = {
        axis: selection.between(spec.axis_values(axis), query, f"{axis}_start", f"{axis}_stop")
        for axis in ("omega", "gamma")
    }
    return {axis: slice(part.start, part.stop, query.every) for axis, part in parts.items()}


def estimate(spec: SweepSpec, query: ModesQuery) -> Estimate:
    """All cells of the plane. Raises InvalidRequest if the sweep lacks the plane or a variable."""
    selection.nearest_index(spec, "xi", query.xi)
    directions, window = selection.directions_of(spec, query.direction), _window(spec, query)
    lengths = {axis: part.stop - part.start for axis, part in window.items()}
    if query.color == "multiplier" and not spec.certifies:
        able = "one with settle 'auto' and no exponents" if spec.model.certifies else "one of a soft contact"
        raise InvalidRequest.of("color", f"must be 'mode': this sweep certifies no cells, as {able} does")
    cells = prod(-(-n // query.every) for n in lengths.values())
    memory, most = _PER_FILLED * cells * spec.fills_in, None
    if selection.needs_flights(spec, query.min_flight):
        if spec.fills_in:
            rule = (
                f"must be the sweep's, {spec.micro_flight:g}: an adaptive map is refined where modes of "
                "these flights change, and those of others change elsewhere; submit the map with "
                f"micro_flight {query.min_flight:g} instead, or read diagrams, which count other flights "
                "where cells are computed"
            )
            raise InvalidRequest.of("min_flight", rule)
        most = max(1, selection.MAX_READ // spec.keep)
        memory = 100 * spec.keep * min(most, cells)
    if query.hysteresis:
        if len(spec.directions) < 2:
            way = "from rest" if spec.ramp_axis is None else f"ramped {spec.directions[0]} only"
            rule = f'needs a sweep ramped both ways, with the direction "both"; this one is {way}'
            raise InvalidRequest.of("hysteresis", rule)
        memory += comparison_memory(spec)
    if len(directions) > 1:
        lengths = {"direction": len(directions), **lengths}
    if spec.exponents:
        lengths["exponent"] = spec.exponents
    return Estimate(lengths, _PLANE, query.every, reads=_PLANE, memory=memory, most=most)


def comparison_memory(spec: SweepSpec) -> int:
    """Most bytes of memory for comparing the directions of a plane."""
    row = len(spec.directions) * spec.keep * len(spec.axis_values("gamma"))
    return min(row * len(spec.axis_values("omega")), max(_COMPARED, row)) * _PER_COMPARED


def _computed_share(study: selection.Stored[SweepSpec], xi: int, direction: str) -> float:
    """The share of computed cells among the done cells of an adaptive map at one xi.

    It counts all cells, even for a thinned answer, whose rows and columns have the corners of blocks, most of
    which are computed.
    """
    spec = study.spec
    done = computed = 0
    omegas, gammas = (len(spec.axis_values(axis)) for axis in _PLANE)
    rows = max(1, selection.MAX_READ // gammas)
    for low in range(0, omegas, rows):
        names, some = (OUTCOME.name, COMPUTED.name), slice(low, low + rows)
        part = selection.read_direction(study, names, direction, {"xi": xi, "omega": some})
        done += int(np.count_nonzero(part[OUTCOME.name] != Outcome.MISSING))
        computed += int(np.count_nonzero(part[COMPUTED.name]))
    return computed / done if done else 0.0


def _hysteresis(
    study: selection.Stored[SweepSpec], xi: int, window: Window, min_flight: float | None
) -> tuple[NDArray[np.uint8], bool]:
    """`compare` for the cells of a window, some rows at a time, and whether all are computed both ways."""
    spec = study.spec
    names = {*selection.arrays_of_modes(spec, min_flight), "flight_time", "flights"}
    rows, columns = (range(len(spec.axis_values(axis)))[window[axis]] for axis in _PLANE)
    at_once = max(1, _COMPARED // (len(spec.directions) * spec.keep * len(columns)))
    parts, complete = [], True
    for first in range(0, len(rows), at_once):
        some = rows[first : first + at_once]
        indices: selection.Indices = {"xi": xi, **window, "omega": slice(some.start, some.stop, some.step)}
        up, down = (
            arrays | selection.recounted(spec, arrays, min_flight)
            for arrays in (
                selection.read_direction(study, sorted(names), direction, indices)
                for direction in spec.directions
            )
        )
        complete &= study.is_complete(up["outcome"]) and study.is_complete(down["outcome"])
        parts.append(compare(up, down, selection.shortest(spec, min_flight)))
    return np.concatenate(parts), complete


def compare(
    up: Mapping[str, NDArray[Any]], down: Mapping[str, NDArray[Any]], min_flight: float
) -> NDArray[np.uint8]:
    """A `Hysteresis` for each cell, in the shape of `outcome`.

    up, down: `outcome`, `bounces`, `periods` (...) counted with `min_flight`, rad, and the stored
    `flight_time` (..., keep), rad, and `flights` (...). Two cells without a cycle agree, as their flights
    never repeat; so do two that keep less than a cycle, perhaps different parts of it.
    """
    known = ~np.isin(up["outcome"], _UNKNOWN) & ~np.isin(down["outcome"], _UNKNOWN)
    same = np.logical_and.reduce([up[name] == down[name] for name in ("outcome", "bounces", "periods")])
    result: NDArray[np.uint8] = np.where(known & ~same, Hysteresis.MODE, Hysteresis.NONE).astype(np.uint8)
    cycles = same & (up["outcome"] == Outcome.PERIODIC) & (up["bounces"] <= up["flight_time"].shape[-1])
    for bounces in np.unique(up["bounces"][cycles]).tolist():
        cells = cycles & (up["bounces"] == bounces)
        ends = [
            _last(arrays["flight_time"][cells], arrays["flights"][cells], bounces, min_flight)
            for arrays in (up, down)
        ]
        other = np.max(np.abs(ends[0] - ends[1]), axis=1) > OTHER_FLIGHTS
        result[cells] = np.where(other, Hysteresis.FLIGHTS, Hysteresis.NONE)
    return result


def _last(
    times: NDArray[np.float64], flights: NDArray[np.int32], count: int, min_flight: float
) -> NDArray[np.float64]:
    """The last `count` flights that count, sorted, (n, count), rad; NaN where there are fewer.

    times (n, keep), rad, and flights (n,): as stored.
    """
    counts = counted(times, flights, min_flight)
    order = np.argsort(counts, axis=1, kind="stable")[:, -count:]
    last = np.where(np.take_along_axis(counts, order, 1), np.take_along_axis(times, order, 1), np.nan)
    return np.sort(last, axis=1)


def draw(result: xarray.Dataset, figure: Figure) -> None:
    """Draw a map of each direction."""
    ways = by_direction(result)
    for axes, way in zip(figure.subplots(1, len(ways), squeeze=False)[0], ways, strict=True):
        draw_modes(axes, way)


VIEW: Final = View(
    "modes", "Mode map", SweepSpec, ModesQuery, compute, estimate,
    variables=(*_ROWS, _HYSTERESIS), rows="outcome", draw=draw, size=(11.0, 4.2),
)  # fmt: skip
