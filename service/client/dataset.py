"""Results as xarray Datasets, read from the service's form; `dataset.bounce`: flights as a table, and a plot.

An accessor, as other packages on xarray have one: results stay plain Datasets, with all of xarray's own
methods, and these two answer for a diagram, a map, thresholds and a whole sweep alike. Nothing is shown or
saved: that is the caller's part, as with `xarray.Dataset.plot`.
"""

import json
import sys
from collections.abc import Mapping
from math import prod
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import xarray

from kernel.labels import LABELS
from service.client.errors import BounceError, UnexpectedAnswer

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes

GREY, RED, BLUE = "#a6a6a6", "#b2182b", "#2166ac"
#: Of cells from rest, ramped up, ramped down.
COLOURS: Final = {"rest": "black", "up": RED, "down": BLUE}
_WAYS: Final = {"rest": "from rest", "up": "ramp up", "down": "ramp down"}

#: Of cells on cycles of 1, 2, 3, 4 and more plate periods (Okabe and Ito); of those on none, by their label.
PERIODS: Final = ("#0072b2", "#56b4e9", "#009e73", "#e69f00", "#f0e442")
OTHERS: Final = {
    "at_rest": "#e8e8e8", "aperiodic": "#d55e00", "quasi-periodic": "#cc79a7", "chaotic": "#7f2704",
    "unstable": "#b2182b",
    "settling": "#bdbdbd", "unresolved": "#525252", "diverged": "#000000", "missing": "#ffffff",
}  # fmt: skip

AXES: Final = {
    "gamma": r"plate acceleration over gravity $\Gamma$",
    "omega": r"plate frequency over that of the spring $\Omega$",
    "xi": r"damping ratio $\xi$",
}
_SYMBOLS: Final = {"gamma": r"$\Gamma$", "omega": r"$\Omega$", "xi": r"$\xi$"}
FLIGHT: Final = "flight time (rad)"

#: What a table of flights says of their cells.
_OF_CELLS: Final = ("outcome", "label", "bounces", "periods")

#: Over the cells of a map whose directions differ, and what a legend calls them.
HATCH: Final = "////"
DIFFER: Final = "up and down differ"


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
    if not values.size:  # JSON tells the length of the first dimension only
        values = values.reshape([sizes[dim] for dim in about["dims"]])
    attrs = {
        name: np.array(x, values.dtype) if isinstance(x, list) else x for name, x in about["attrs"].items()
    }
    return xarray.Variable(about["dims"], values, attrs)


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
                codes = dataset[name].transpose(*cells).values[*where]
                meanings = dataset[name].attrs.get("flag_meanings", "").split()
                columns[name] = pandas.Categorical.from_codes(codes, meanings) if meanings else codes
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
        ax = ax if ax is not None else _new_axes()
        if "analytic" in dataset:
            draw_thresholds(ax, dataset)
            return ax
        if "outcome" not in dataset:
            raise BounceError("plot: is of a diagram, a map of modes, thresholds, or a whole sweep")
        dims = set(dataset.outcome.dims)
        if len(dims - {"direction"}) == 1 and "flight_time" in dataset:
            draw_diagram(ax, dataset)
            if branches is not None:
                draw_branches(ax, branches)
        elif dims == {"gamma", "omega"}:
            draw_modes(ax, dataset.transpose("omega", "gamma", ...))
        else:
            several = ", ".join(f"{dim} ({dataset.sizes[dim]} values)" for dim in dataset.outcome.dims)
            raise BounceError(f"plot: a line, or a plane of gamma and omega; select of {several}")
        return ax


xarray.register_dataset_accessor("bounce")(BounceAccessor)  # type: ignore[no-untyped-call]


def draw_diagram(ax: "Axes", diagram: xarray.Dataset) -> None:
    """The flights of every cell along the diagram's axis, as dots."""
    *_, along = (str(dim) for dim in diagram.flight_time.dims if dim not in ("direction", "flight"))
    for name in np.atleast_1d(diagram.direction.values):
        line = diagram.sel(direction=name) if diagram.direction.ndim else diagram
        flights = line.flight_time.transpose(along, "flight").values
        x = np.repeat(line[along].values, flights.shape[1])
        way = str(name)
        ax.plot(x, flights.ravel(), ".", markersize=1.5, color=COLOURS[way], label=_WAYS[way])
    ax.set_xlabel(AXES[along])
    ax.set_ylabel(FLIGHT)
    fixed = [f"{_SYMBOLS[axis]} = {diagram[axis].item():g}" for axis in AXES if axis != along]
    ax.set_title(", ".join(fixed))


def draw_branches(ax: "Axes", branches: xarray.Dataset) -> None:
    """Cycles of one flight over Γ: solid where stable, dashed where not, thin where they cannot happen."""
    for i in range(branches.sizes["branch"]):
        branch = branches.isel(branch=i)
        gamma, flight = branch.gamma.values, branch.flight_time.values
        stable, admissible = branch.stable.values.astype(bool), branch.admissible.values == 0
        for shown, style, width in (
            (stable & admissible, "-", 1.4),
            (~stable & admissible, "--", 1.0),
            (~admissible, ":", 0.6),
        ):
            x = np.where(shown, gamma, np.nan)
            ax.plot(x, flight, color="black", linestyle=style, linewidth=width)


def draw_modes(ax: "Axes", modes: xarray.Dataset) -> None:
    """The cells of the plane (Γ, Ω) by the plate periods of their cycle, or by what else they do."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    names = [*(f"cycle of {n}" for n in (1, 2, 3, 4)), "longer cycle", *OTHERS]
    codes = modes.label.values if "label" in modes else modes.outcome.values
    periods = np.clip(modes.periods.values, 1, len(PERIODS)) - 1
    cells = np.full(codes.shape, names.index("missing"))
    for code, label in enumerate(LABELS):
        here = codes == code
        cells[here] = periods[here] if label == "periodic" else names.index(label)
    ax.pcolormesh(
        modes.gamma.values, modes.omega.values, cells, shading="nearest",
        cmap=ListedColormap([*PERIODS, *OTHERS.values()]), vmin=-0.5, vmax=len(names) - 0.5,
    )  # fmt: skip
    colours = [*PERIODS, *OTHERS.values()]
    seen = np.unique(cells).tolist()
    handles = [
        Patch(facecolor=colours[i], edgecolor="black", linewidth=0.4, label=names[i].replace("_", " "))
        for i in seen
    ]
    if "hysteresis" in modes and (differ := modes.hysteresis.values > 0).any():
        ax.pcolor(
            modes.gamma.values, modes.omega.values, np.ma.masked_where(~differ, differ), shading="nearest",
            cmap=ListedColormap(["none"]), edgecolor="none", hatch=HATCH,
        )  # fmt: skip
        handles.append(Patch(facecolor="none", edgecolor="black", linewidth=0.4, hatch=HATCH, label=DIFFER))
    ax.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, frameon=False)
    ax.set_xlabel(AXES["gamma"])
    ax.set_ylabel(AXES["omega"])
    ax.set_title(f"{_SYMBOLS['xi']} = {modes.xi.item():g}, periods of the plate in a cycle")


def draw_thresholds(ax: "Axes", thresholds: xarray.Dataset) -> None:
    """Where bouncing begins and ends over Ω: as computed, by Eq. 25, and in closed form."""
    omega = thresholds.omega.values
    ax.plot(omega, thresholds.analytic.values, "--", color="black", linewidth=1.0, label="Eq. 25")
    ax.plot(
        omega, thresholds.predicted_down.values, "-", color=GREY, linewidth=1.4, label="closed form, down"
    )
    for status in ("unresolved", "not searched"):
        number = int((thresholds.cause.values == status).sum()) if "cause" in thresholds else 0
        if number:
            ax.plot([], [], " ", label=f"closed form, {status}: {number} of {len(omega)}")
    for name, marker in (("up", "^"), ("down", "v")):
        values = thresholds[name].values
        if np.isfinite(values).any():
            ax.plot(omega, values, marker, markersize=4, color=COLOURS[name], label=f"computed, {name}")
    ax.set_xlabel(AXES["omega"])
    ax.set_ylabel(r"threshold $\Gamma$")
    ax.set_title(f"{_SYMBOLS['xi']} = {thresholds.xi.item():g}")
    ax.legend(frameon=False)


def _selected(dataset: xarray.Dataset, where: dict[str, float | str]) -> xarray.Dataset:
    """The part of a Dataset at the nearest grid values, of a sweep without axes of one value."""
    for axis, value in where.items():
        if axis not in (*AXES, "direction"):
            raise BounceError(f"plot: {axis} is no axis; the axes are gamma, omega, xi and direction")
        if axis not in dataset.dims:
            raise BounceError(f"plot: {axis} is selected already, or is no axis of these results")
        if axis == "direction" and value not in dataset.direction.values:
            ways = ", ".join(map(str, dataset.direction.values))
            raise BounceError(f"plot: direction must be one of {ways}, not {value!r:.40}")
        dataset = dataset.sel({axis: value}, method=None if axis == "direction" else "nearest")
    if "flight_time" not in dataset or len(set(AXES) & set(dataset.dims)) < 2:
        return dataset
    return dataset.squeeze([dim for dim in (*AXES, "direction") if dataset.sizes.get(dim) == 1])


def _new_axes() -> "Axes":
    """The current axes of pyplot if it is in use, as in a notebook; those of a new figure otherwise."""
    pyplot = sys.modules.get("matplotlib.pyplot")
    if pyplot is not None:
        axes: Axes = pyplot.gca()
        return axes
    from matplotlib.figure import Figure

    return Figure(layout="constrained").subplots()
