"""The basins of a cell: its attractors, and the attractor that each start of the plane reaches."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import xarray
from numpy.typing import NDArray

from kernel.labels import label_codes
from kernel.params import STATE_FIELDS, Outcome
from service.pictures import ATTRACTORS, UNDECIDED, Axes, Figure, draw_cells, edges, legend_beside, values_at
from service.views.selection import Stored, attractor_label, nearest_values, read_stored
from service.views.variables import coordinate, dataset, row, variable
from service.views.view import Estimate, Number, Query, View
from worker.basins.attractors import EXPONENT_WINDOW
from worker.basins.schema import LIFETIME, SIDES
from worker.basins.schema import basin_arrays as stored_arrays
from worker.basins.specification import Basin, BasinSpec
from worker.study import Array
from worker.sweep import AXES

_OF_START: Final = row(
    "attractor_of_start", ("row", "column"), "|u1", "attractor that a start reaches", comment="0: undecided"
)
_LABEL: Final = row("attractor_label", ("attractor",), "U", "what the attractor does")
_LIFETIME: Final = {
    "long_name": "life of aperiodic motion that was seen to end", "units": "plate periods",
    "comment": "NaN: no such motion was seen to end",
}  # fmt: skip


class BasinQuery(Query):
    """The cell nearest to these values. An axis with one value may be omitted."""

    gamma: Number | None = None
    omega: Number | None = None
    xi: Number | None = None


def compute(study: Stored[BasinSpec], query: BasinQuery) -> xarray.Dataset:
    """The attractors of one cell, and their basins.

    Attractors are numbered from 1 by the share of the starts of the plane that reach them. A start without
    an attractor has the number 0.
    """
    spec, plane = study.spec, study.spec.protocol
    points = nearest_values(spec, query, reversed(AXES))
    rows = stored_arrays(spec)
    indices = {axis: point.index for axis, point in points.items()}
    stored = read_stored(study, [row.name for row in rows], indices)
    count = int((stored["attractor_outcome"] != Outcome.MISSING).sum())
    data = {
        row.name: variable((), values[:count] if "attractor" in row.dims else values, row)
        for row, values in ((_as_result(row), stored[row.name]) for row in rows if row.name != "outcome")
    }
    data["attractor_label"] = variable((), _labels(spec, stored, count), _LABEL)
    lifetime = data["attractor_lifetime"]
    lifetime.values[np.isinf(lifetime.values)] = np.nan
    row_attrs, column_attrs = SIDES[plane.plane]
    coords = {axis: coordinate(axis, point.value) for axis, point in points.items()} | {
        "row": coordinate("row", plane.row_values, **row_attrs),
        "column": coordinate("column", plane.column_values, **column_attrs),
        "attractor": coordinate("attractor", np.arange(1, count + 1, dtype=np.int32), long_name="attractor"),
        "state": coordinate("state", STATE_FIELDS, long_name="component of the state"),
    }
    attrs = {
        "plane": plane.plane, "height": plane.height, "model": spec.model.kind,
        "complete": study.is_complete(stored["outcome"]),
    }  # fmt: skip
    return dataset(data, coords, attrs)


def _as_result(array: Array) -> Array:
    """A stored array as the result has it: `fraction` (id) is `attractor_fraction` (attractor)."""
    if array.name == "attractor":
        return _OF_START
    if "id" not in array.dims:
        return array
    attrs = _LIFETIME if array.name == LIFETIME.name else array.attrs
    dims = tuple("attractor" if dim == "id" else dim for dim in array.dims)
    return array._replace(name=f"attractor_{array.name.removeprefix('attractor_')}", dims=dims, attrs=attrs)


def _labels(spec: BasinSpec, stored: Mapping[str, NDArray[Any]], count: int) -> NDArray[np.str_]:
    codes = stored["attractor_outcome"][:count]
    if spec.exponents:
        lyapunov, error = stored["lyapunov"][:count], stored["lyapunov_error"][:count]
        codes = label_codes(codes, lyapunov, error, EXPONENT_WINDOW)
    modes = zip(codes.tolist(), stored["bounces"].tolist(), stored["periods"].tolist(), strict=False)
    return np.array([attractor_label(*mode) for mode in modes], np.str_)


def estimate(spec: BasinSpec, query: BasinQuery) -> Estimate:
    """The starts of one cell. Raises InvalidRequest for a cell that the grid does not have."""
    nearest_values(spec, query, AXES)
    return Estimate({"row": spec.protocol.rows, "column": spec.protocol.columns})


#: Attractors named beside the picture.
NAMED: Final = 16


def draw(result: xarray.Dataset, figure: Figure) -> None:
    """Draw the plane of starts, each in the colour of its attractor."""
    axes = figure.subplots()
    colours = [ATTRACTORS[i % len(ATTRACTORS)] for i in range(result.sizes["attractor"])]
    sides = edges(result.column.values), edges(result.row.values)
    draw_cells(axes, *sides, result.attractor_of_start.values, [UNDECIDED, *colours])
    for axis, side in ((axes.xaxis, result.column), (axes.yaxis, result.row)):
        units = "" if side.units == "1" else f" ({side.units})"
        axis.set_label_text(f"{side.long_name}{units}".replace("omega", "Ω"))
    axes.set_title(f"{values_at(result, reversed(AXES))}  ({result.attrs['model']})", fontsize=11)
    _legend(axes, result, colours)


def _legend(axes: Axes, result: xarray.Dataset, colours: list[str]) -> None:
    from matplotlib.patches import Patch

    columns = (
        result[f"attractor_{name}"].values.tolist() for name in ("label", "fraction", "longest_flight")
    )
    entries = [
        Patch(color=colour, label=f"{label}  {_percent(share)}{f', up to {longest:.4g} rad' * (longest > 0)}")
        for colour, label, share, longest in list(zip(colours, *columns, strict=True))[:NAMED]
    ]
    undecided = result.undecided.item()
    if undecided > 0.0 or not np.isfinite(undecided):
        text = f"undecided  {_percent(undecided)}" if np.isfinite(undecided) else "not computed"
        entries.append(Patch(facecolor=UNDECIDED, edgecolor="black", linewidth=0.5, label=text))
    if len(colours) > NAMED:
        entries.append(Patch(alpha=0.0, label=f"and {len(colours) - NAMED} more"))
    legend_beside(axes, entries)


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %" if np.isfinite(share) and share >= 0.001 else f"{100.0 * share:.2g} %"


_STORED: Final = stored_arrays(
    BasinSpec(gamma=1.0, omega=1.0, xi=0.1, protocol=Basin(kind="basin"), exponents=1)
)
VIEW: Final = View(
    "basins", "Basin of a cell", BasinSpec, BasinQuery, compute, estimate,
    variables=(*(_as_result(row) for row in _STORED if row.name != "outcome"), _LABEL),
    rows="attractor_fraction", draw=draw,
)  # fmt: skip
