"""Results as xarray Datasets, read from the service's form; `dataset.bounce`: flights as a table, and a plot.

Results stay plain Datasets with all of xarray's own methods. The accessor serves diagrams, maps, thresholds
and whole sweeps alike. The caller shows or saves plots, as with `xarray.Dataset.plot`.
"""

import json
import sys
from collections.abc import Mapping
from math import prod
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import xarray

from service import pictures
from service.client.errors import UnexpectedAnswer
from worker.spec.errors import BounceError

if TYPE_CHECKING:
    import pandas

    from service.client.measured import Data

#: Columns of a table of flights that describe their cells.
_OF_CELLS: Final = ("outcome", "label", "lyapunov_error", "bounces", "periods", "flight_error", "multiplier")

_DTYPES: Final = frozenset({"bool", "str", "uint8", "int32", "int64", "float32", "float64", "complex128"})


def from_binary(body: bytes) -> xarray.Dataset:
    """The Dataset of a line of JSON and the arrays after it. Raises UnexpectedAnswer."""
    end = body.find(b"\n") + 1
    content = memoryview(bytearray(body))[end:]  # a Dataset can be written to
    try:
        document = json.loads(body[:end])
        data, coords = (
            {str(name): _variable(about, content, document["dims"]) for name, about in document[kind].items()}
            for kind in ("data_vars", "coords")
        )
        # NetCDF has neither booleans nor null: the Dataset can be written as it is.
        attrs = {
            name: int(x) if isinstance(x, bool) else np.nan if x is None else x
            for name, x in document["attrs"].items()
        }
        return xarray.Dataset(data, coords, attrs)
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError, RecursionError) as error:
        raise UnexpectedAnswer(
            "the answer is not a result: not a bounce service, or of another release"
        ) from error


def _variable(about: Mapping[str, Any], content: memoryview, sizes: Mapping[str, int]) -> xarray.Variable:
    data, dtype = about["data"], str(about["dtype"])
    if dtype not in _DTYPES:
        raise ValueError
    if isinstance(data, dict):
        shape, offset = tuple(map(int, data["shape"])), int(data["offset"])
        if min(shape, default=0) < 0 or offset < 0:
            raise ValueError
        values = np.frombuffer(content, dtype, prod(shape), offset).reshape(shape)
    else:
        values = np.array(data, dtype)
    if not values.size:  # JSON has the length of the first dimension only
        values = values.reshape([sizes[dim] for dim in about["dims"]])
    attrs = {
        name: np.array(x, values.dtype) if isinstance(x, list) else x for name, x in about["attrs"].items()
    }
    return xarray.Variable(about["dims"], values, attrs)


class BounceAccessor:
    """The methods of results beyond xarray's own."""

    def __init__(self, dataset: xarray.Dataset) -> None:
        self._dataset = dataset

    def to_dataframe(self) -> "pandas.DataFrame":
        """One row per flight: of a diagram, or of a whole sweep.

        Columns: the axes `gamma`, `omega`, `xi` and `direction`; `flight`, its place in its cell, from 0;
        `flight_time` and `takeoff_phase` in rad; `outcome`, `bounces` and `periods` of its cell, with
        exponents `label` and `lyapunov_error`, of certified cells `flight_error` and `multiplier`. Cells
        without a flight have no row. Raises BounceError for a Dataset that has no flights.
        """
        import pandas

        dataset = self._dataset
        if not {"flight_time", "takeoff_phase", "direction"} <= set(dataset.variables):
            raise BounceError("to_dataframe: is of a diagram or of a whole sweep, which have flights")
        cells = [str(dim) for dim in dataset.flight_time.dims if dim != "flight"]
        times = dataset.flight_time.transpose(*cells, "flight").values
        phases = dataset.takeoff_phase.transpose(*cells, "flight").values
        *cell, flight = np.nonzero(np.isfinite(times))
        columns: dict[str, Any] = {}
        for axis in ("gamma", "omega", "xi", "direction"):
            if axis in cells:
                columns[axis] = dataset[axis].values[cell[cells.index(axis)]]
            elif axis in dataset.coords:
                columns[axis] = np.repeat(dataset[axis].values, len(flight))
        columns["direction"] = pandas.Categorical([str(way) for way in columns["direction"].tolist()])
        columns |= {
            "flight": flight, "flight_time": times[*cell, flight], "takeoff_phase": phases[*cell, flight],
        }  # fmt: skip
        for name in _OF_CELLS:
            if name in dataset:
                codes = dataset[name].transpose(*cells).values[*cell]
                meanings = dataset[name].attrs.get("flag_meanings", "").split()
                columns[name] = pandas.Categorical.from_codes(codes, meanings) if meanings else codes
        return pandas.DataFrame(columns)

    def plot(
        self,
        *,
        ax: pictures.Axes | None = None,
        branches: xarray.Dataset | None = None,
        data: "Data | None" = None,
        frequency: float | None = None,
        **where: float | str,
    ) -> pictures.Axes:
        """Plot a diagram, a map of modes, thresholds, branches, or a part of a whole sweep with matplotlib.

        `where` selects a part of a whole sweep: `gamma`, `omega`, `xi` to the nearest grid value, `direction`
        up or down. The part must be a line, drawn as a diagram, or a plane of Γ and Ω, drawn as a map.
        `branches`, `data`, `frequency` and `ax` as of `Job.plot`. Returns the axes. Raises BounceError naming
        what to select.
        """
        from service.client.measured import measured

        dataset = _selected(self._dataset, where)
        scalars = set(pictures.AXES) & set(dataset.coords) - set(dataset.dims)
        selected = {axis: dataset[axis].item() for axis in scalars}
        is_sweep = "outcome" in dataset and "direction" in dataset.coords
        dims = set(dataset.outcome.dims) if is_sweep else set()
        is_line = len(dims - {"direction"}) == 1 and "flight_time" in dataset
        along, value = "omega", "gamma" if "analytic" in dataset else None
        if is_line:
            along, value = pictures.along_of(dataset), "flight_time"
        _check_branches(branches, along if is_line else None, selected)
        points = None if data is None or value is None else measured(data, along, value, selected, frequency)
        ax = ax if ax is not None else _new_axes()
        if "analytic" in dataset:
            pictures.draw_thresholds(ax, dataset)
            computed = np.stack([dataset.up.values, dataset.down.values], axis=-1)
        elif is_line:
            values, longest = dataset[along].values, 0.0
            flights = dataset.flight_time.transpose(along, ...).values
            computed = flights.reshape(len(flights), -1)
            if points is not None:
                shown = points.y[(points.x >= values[0]) & (points.x <= values[-1])]
                longest = float(max(np.nanmax(flights, initial=0.0), shown.max(initial=0.0)))
            pictures.draw_diagram(ax, dataset, longest)
            ax.set_title(pictures.values_at(dataset, [axis for axis in pictures.AXES if axis != along]))
            if branches is not None:
                pictures.draw_branches(ax, branches, along)
        elif "branch" in dataset.dims and "outcome" not in dataset:
            pictures.draw_cycles(ax, dataset)
        elif dims == {"gamma", "omega"}:
            if "flight_time" in dataset:  # of a whole sweep, whose margins nobody has asked for
                dataset = dataset.drop_vars("multiplier", errors="ignore")
            pictures.draw_modes(ax, dataset.transpose("omega", "gamma", ...))
        elif is_sweep:
            several = ", ".join(f"{dim} ({dataset.sizes[dim]} values)" for dim in dataset.outcome.dims)
            raise BounceError(f"plot: a line, or a plane of gamma and omega; select of {several}")
        else:
            raise BounceError("plot: is of a diagram, a map of modes, thresholds, branches, or a whole sweep")
        if points is not None:
            pictures.draw_measured(ax, points, dataset[along].values, computed)
        elif data is not None:
            raise BounceError("data: is drawn over a diagram or thresholds")
        return ax

    def plot_returns(self, *, ax: pictures.Axes | None = None) -> pictures.Axes:
        """Plot each flight of a diagram of one cell over the one before."""
        ax = ax if ax is not None else _new_axes()
        pictures.draw_returns(ax, self._dataset.squeeze(pictures.along_of(self._dataset)))
        return ax

    def plot_exponents(self, *, ax: pictures.Axes | None = None) -> pictures.Axes:
        """Plot the Lyapunov exponents of a diagram. Raises BounceError where none are stored."""
        if "lyapunov" not in self._dataset:
            raise BounceError("exponents: the sweep has none; submit it with exponents")
        ax = ax if ax is not None else _new_axes()
        pictures.draw_exponents(ax, self._dataset)
        return ax


xarray.register_dataset_accessor("bounce")(BounceAccessor)  # type: ignore[no-untyped-call]


def _check_branches(branches: Any, along: str | None, values: Mapping[str, float]) -> None:
    """Raise BounceError unless they are None, or of the spring of a diagram, along its axis."""
    if branches is None:
        return
    if along is None or not isinstance(branches, xarray.Dataset) or "branch" not in branches.dims:
        raise BounceError("branches: are a Dataset of orbits, drawn over a diagram")
    if (own := branches.attrs.get("along", "gamma")) != along:
        raise BounceError(f"branches: are along {own}, the diagram along {along}")
    for axis in values.keys() & set(branches.variables):
        given = branches[axis].values[np.isfinite(branches[axis].values)][:1]
        if not np.allclose(given, values[axis], rtol=1e-9, atol=0.0):
            raise BounceError(f"branches: are of {axis} {given[0]:g}, the diagram of {values[axis]:g}")


def _selected(dataset: xarray.Dataset, where: dict[str, float | str]) -> xarray.Dataset:
    """The part of a Dataset at the nearest grid values, of a sweep without axes of one value."""
    for axis, value in where.items():
        if axis not in (*pictures.AXES, "direction"):
            raise BounceError(f"plot: {axis} is no axis; the axes are gamma, omega, xi and direction")
        if axis not in dataset.dims:
            raise BounceError(f"plot: {axis} is selected already, or is no axis of these results")
        if axis == "direction" and value not in dataset.direction.values:
            ways = ", ".join(map(str, dataset.direction.values))
            raise BounceError(f"plot: direction must be one of {ways}, not {value!r:.40}")
        dataset = dataset.sel({axis: value}, method=None if axis == "direction" else "nearest")
    if "flight_time" not in dataset or len(set(pictures.AXES) & set(dataset.dims)) < 2:
        return dataset
    return dataset.squeeze([dim for dim in (*pictures.AXES, "direction") if dataset.sizes.get(dim) == 1])


def _new_axes() -> pictures.Axes:
    """The axes of a new figure, or current ones of pyplot, if in use or in a notebook, that are empty."""
    if not sys.modules.keys().isdisjoint(("matplotlib.pyplot", "ipykernel")):
        from matplotlib import pyplot  # shows them below the cell

        axes: pictures.Axes = pyplot.gca()
        return pyplot.figure().gca() if axes.has_data() else axes
    from matplotlib.figure import Figure

    return Figure(layout="constrained").subplots()
