"""`dataset.bounce` on every `xarray.Dataset` of results: its flights as a table, and its plot.

An accessor, as other packages on xarray have one: results stay plain Datasets, with all of xarray's own
methods, and these two answer for a diagram, a map, thresholds and a whole sweep alike.
"""

from typing import TYPE_CHECKING, Any, Final

import numpy as np
import xarray

from kernel.labels import LABELS
from kernel.params import Outcome
from service.client import plots
from service.client.errors import BounceError

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

#: The names behind the numbers of a variable.
_NAMES: Final = {"outcome": tuple(outcome.name.lower() for outcome in Outcome), "label": LABELS}
_OF_CELLS: Final = ("outcome", "label", "bounces", "periods")


class BounceAccessor:
    """What results can be asked beyond xarray's own methods."""

    def __init__(self, dataset: xarray.Dataset) -> None:
        self._dataset = dataset

    def to_dataframe(self) -> "pandas.DataFrame":
        """One row per flight: of a diagram, or of a whole sweep.

        Columns: the axes `gamma`, `omega`, `xi` and `direction`; `flight`, its place in its cell, from 0;
        `flight_time` and `takeoff_phase` in rad; `outcome`, `bounces` and `periods` of its cell, of a sweep
        with exponents `label`. Cells without a flight have no row. Raises BounceError for a Dataset that has
        no flights.
        """
        import pandas

        dataset = self._dataset
        if "flight_time" not in dataset or "flight" not in dataset.flight_time.dims:
            raise BounceError("to_dataframe: is of a diagram or of a whole sweep, which have flights")
        cells = [str(dim) for dim in dataset.flight_time.dims if dim != "flight"]
        times = dataset.flight_time.transpose(*cells, "flight").values
        phases = dataset.takeoff_phase.transpose(*cells, "flight").values
        *where, place = np.nonzero(np.isfinite(times))
        columns: dict[str, Any] = {}
        for axis in ("gamma", "omega", "xi", "direction"):
            if axis in cells:
                columns[axis] = dataset[axis].values[where[cells.index(axis)]]
            elif axis in dataset.coords:
                columns[axis] = np.repeat(dataset[axis].values, len(place))
        columns["direction"] = pandas.Categorical([str(way) for way in columns["direction"].tolist()])
        columns |= {
            "flight": place,
            "flight_time": times[*where, place],
            "takeoff_phase": phases[*where, place],
        }
        for name in _OF_CELLS:
            if name in dataset:
                values = dataset[name].transpose(*cells).values[*where]
                names = _NAMES.get(name)
                columns[name] = values if names is None else _categories(values, names)
        return pandas.DataFrame(columns)

    def plot(
        self, *, ax: "Axes | None" = None, branches: xarray.Dataset | None = None, **where: float | str
    ) -> "Axes":
        """Plot a diagram, a map of modes, thresholds, or a part of a whole sweep with matplotlib.

        `where` selects of a whole sweep: `gamma`, `omega`, `xi` to the nearest grid value, `direction` up or
        down. What is left must be a line, drawn as a diagram, or a plane of Γ and Ω, drawn as a map.
        `branches` and `ax` as of `Job.plot`. Returns the axes. Raises BounceError naming what to select.
        """
        dataset = _selected(self._dataset, where)
        ax = ax if ax is not None else plots.new_axes()
        if "analytic" in dataset:
            plots.draw_thresholds(ax, dataset)
            return ax
        if "outcome" not in dataset:
            raise BounceError("plot: is of a diagram, a map of modes, thresholds, or a whole sweep")
        dims = set(dataset.outcome.dims)
        if len(dims - {"direction"}) == 1 and "flight_time" in dataset:
            plots.draw_diagram(ax, dataset)
            if branches is not None:
                plots.draw_branches(ax, branches)
        elif dims == {"gamma", "omega"}:
            plots.draw_modes(ax, dataset.transpose("omega", "gamma", ...))
        else:
            several = ", ".join(f"{dim} ({dataset.sizes[dim]} values)" for dim in dataset.outcome.dims)
            raise BounceError(f"plot: a line, or a plane of gamma and omega; select of {several}")
        return ax


xarray.register_dataset_accessor("bounce")(BounceAccessor)  # type: ignore[no-untyped-call]


def _categories(codes: "NDArray[np.integer[Any]]", names: tuple[str, ...]) -> "pandas.Categorical[str]":
    import pandas

    return pandas.Categorical.from_codes(codes, pandas.Index(names))


def _selected(dataset: xarray.Dataset, where: dict[str, float | str]) -> xarray.Dataset:
    """The part of a Dataset at the nearest grid values, without axes of one value."""
    for axis, value in where.items():
        if axis not in (*plots.AXES, "direction"):
            raise BounceError(f"plot: {axis} is no axis; the axes are gamma, omega, xi and direction")
        if axis not in dataset.dims:
            raise BounceError(f"plot: {axis} is selected already, or is no axis of these results")
        if axis == "direction" and value not in dataset.direction.values:
            ways = ", ".join(map(str, dataset.direction.values))
            raise BounceError(f"plot: direction must be one of {ways}, not {value!r:.40}")
        dataset = dataset.sel({axis: value}, method=None if axis == "direction" else "nearest")
    return dataset.squeeze([dim for dim in (*plots.AXES, "direction") if dataset.sizes.get(dim) == 1])
