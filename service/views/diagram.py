"""Bifurcation diagrams: the flights of all cells along one axis of the grid."""

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import numpy as np
import xarray
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from pydantic import Field

from kernel.labels import CHAOTIC, LABELS, QUASI_PERIODIC, UNSTABLE
from kernel.modes import counted
from kernel.params import Outcome
from kernel.threshold import threshold
from service.pictures import BLUE, GREY, RED, SYMBOLS
from service.views.selection import (
    LABEL,
    Stored,
    between,
    directions_of,
    fixed_axes,
    read_direction,
    recounted,
    shortest,
)
from service.views.style import DPI
from service.views.variables import cells_dataset, coordinate
from service.views.view import Direction, Estimate, Every, MinFlight, Number, Query, View
from worker.spec.contact_models import CONTACT_MODELS
from worker.study import Array
from worker.sweep import AXES, SweepSpec, schema

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class DiagramQuery(Query):
    """One line of the grid along one axis; the other axes take the nearest grid value."""

    along: Annotated[Literal["gamma", "omega", "xi"], Field(description="axis of the diagram")] = "gamma"
    gamma: Number | None = None
    omega: Number | None = None
    xi: Number | None = None
    direction: Direction = None
    min_flight: MinFlight = None
    every: Every = 1
    start: Annotated[Number | None, Field(description="smallest value of the axis")] = None
    stop: Annotated[Number | None, Field(description="largest value of the axis")] = None
    caption: Annotated[bool, Field(description="of a picture: how it was computed, above it")] = True


def compute(study: Stored[SweepSpec], query: DiagramQuery) -> xarray.Dataset:
    """The flights of the cells along an axis.

    A sweep ramped both ways has the dimension `direction`, unless one is selected. Flights up to
    `min_flight` do not count, neither here, where they are NaN, nor for `outcome`, `bounces` and `periods`,
    unless all of a cell are so short.
    """
    spec, along = study.spec, query.along
    fixed, window = fixed_axes(spec, along, dict(query)), _window(spec, query)
    part = slice(window.start, window.stop, query.every)
    indices = {along: part, **{axis: at.index for axis, at in fixed.items()}}
    cells = {
        direction: _line(study, direction, indices, query.min_flight)
        for direction in directions_of(spec, query.direction)
    }
    coords = {axis: coordinate(axis, at.value) for axis, at in fixed.items()}
    coords |= {along: coordinate(along, spec.axis_values(along)[part])}
    attrs: dict[str, Any] = {
        "along": along, "min_flight": shortest(spec, query.min_flight), "every": query.every,
        "model": spec.model.kind, "complete": all(study.is_complete(x["outcome"]) for x in cells.values()),
    }  # fmt: skip
    found = cells_dataset(cells, coords, rows_of(spec), attrs)
    if query.caption:
        found.attrs["caption"] = _caption(spec, found)
    return found


def _window(spec: SweepSpec, query: DiagramQuery) -> range:
    return between(spec.axis_values(query.along), query.start, query.stop)


def rows_of(spec: SweepSpec) -> Iterator[Array]:
    """The stored variables without the end states, and the label where exponents are stored."""
    yield from (row for row in schema.arrays(spec) if row is not schema.END_STATE)
    if spec.exponents:
        yield LABEL


def _line(
    study: Stored[SweepSpec], direction: str, indices: Any, min_flight: float | None
) -> dict[str, NDArray[Any]]:
    """The variables of the cells in one direction."""
    spec = study.spec
    names = [row.name for row in rows_of(spec) if row is not LABEL]
    arrays = read_direction(study, names, direction, indices)
    arrays |= recounted(spec, arrays, min_flight)
    shown = counted(arrays["flight_time"], arrays["flights"], shortest(spec, min_flight))
    for name in ("flight_time", "takeoff_phase"):
        arrays[name] = np.where(shown, arrays[name], np.nan)
    return arrays


def estimate(spec: SweepSpec, query: DiagramQuery) -> Estimate:
    """All flights that the line can have. Raises InvalidRequest for a line that the sweep does not have."""
    fixed_axes(spec, query.along, dict(query))
    directions = directions_of(spec, query.direction)
    lengths = {query.along: len(_window(spec, query)), "flight": spec.keep}
    if len(directions) > 1:
        lengths = {"direction": len(directions), **lengths}
    return Estimate(lengths, (query.along,), query.every, reads=(query.along,))


def _caption(spec: SweepSpec, found: xarray.Dataset) -> str:
    """How the cells were computed and which of them are shown."""
    attrs, outcome = found.attrs, found.variables["outcome"].values
    start = "from rest" if spec.ramp_axis is None else f"ramped along {spec.ramp_axis}"
    flights = f", flights above {attrs['min_flight']:g} rad" if attrs["min_flight"] else ""
    thinned = f", 1 cell in {attrs['every']:,}" if attrs["every"] > 1 else ""
    lost = int(np.count_nonzero(np.isin(outcome, (Outcome.UNRESOLVED, Outcome.DIVERGED))))
    unresolved = f", {lost:,} of {outcome.size:,} cells unresolved" if lost else ""
    codes = found.variables[LABEL.name if LABEL.name in found else "outcome"].values
    special = (Outcome.SETTLING, QUASI_PERIODIC, CHAOTIC, UNSTABLE)
    counts = {code: int(np.count_nonzero(codes == code)) for code in special}
    told_apart = "".join(f", {count:,} {LABELS[code]}" for code, count in counts.items() if count)
    return f"{CONTACT_MODELS[spec.model.kind].label}, {start}{flights}{thinned}{unresolved}{told_apart}"


#: Inches.
SIZE: Final = (6.8, 4.2)

#: Relative size of the points: of a single direction; of up, drawn larger, and of down over it, so that up
#: shows as a rim where the two agree.
ALONE: Final = (("black", 1.0),)
OVERLAID: Final = ((GREY, 1.7), (RED, 0.8))

PERIOD: Final = 2 * np.pi  # of the plate, rad

#: More points than this become an image inside an SVG.
MANY_POINTS: Final = 5_000

#: More flights of a direction than this are drawn as density, on as many columns and rows as the axes have
#: pixels.
DENSE_POINTS: Final = 200_000
COLUMNS_AND_ROWS: Final = (1200, 680)
#: Opacity of a bin with one flight, and how many flights make it opaque.
FAINTEST: Final = 0.5
OPAQUE: Final = 24


def draw(found: xarray.Dataset, figure: "Figure") -> None:
    """Flight times along the axis, the directions over each other: dots, or density where dots would overlap.

    A cell at rest has no flight and so no point. The picture says how many cells are missing.
    """
    axes = figure.subplots()
    draw_flights(axes, found)
    axes.set_xlabel(SYMBOLS[found.attrs["along"]], fontsize=12)
    if "caption" in found.attrs:
        _draw_caption(axes, found)
    if found.sizes.get("direction", 1) > 1:
        draw_legend(axes)
    if not found.attrs["complete"]:
        missing = int(np.count_nonzero(found.outcome.values == Outcome.MISSING))
        total = found.outcome.size
        reason = f"{missing:,} of {total:,} cells are not computed yet" if missing else "being repaired"
        axes.annotate(
            f"incomplete: {reason}", (0.5, 0.5), xycoords="axes fraction", ha="center", color=RED,
            fontsize=11, zorder=5,
            bbox={"facecolor": "white", "edgecolor": RED, "linewidth": 0.6, "alpha": 0.9, "pad": 5},
        )  # fmt: skip


def draw_flights(axes: "Axes", found: xarray.Dataset, longest: float = 0.0) -> None:
    """The flights of a diagram on axes that have room for `longest`, rad; 0 for that of the diagram."""
    along, times = found.attrs["along"], found.flight_time.values
    lines = [found.isel(direction=i) for i in range(found.sizes.get("direction", 0))] or [found]
    values = found[along].values
    _scale(axes, values, longest or float(np.nanmax(times, initial=0.0)) or PERIOD)
    for line, (colour, size) in zip(lines, ALONE if len(lines) == 1 else OVERLAID, strict=True):
        shown = np.isfinite(line.flight_time.values)
        x, y = values[np.nonzero(shown)[0]], line.flight_time.values[shown]
        # The dot of marker "." is half its size wide.
        style: Any = {"marker": ".", "linestyle": "none", "markeredgewidth": 0, "color": colour,
                      "markersize": 2 * _dot(len(values)) * size,
                      "label": str(line.direction.values)}  # fmt: skip
        if len(x) > DENSE_POINTS:
            axes.plot([], [], **style)
            _draw_density(axes, x, y, colour, style["markersize"] / 2)
        else:
            axes.plot(x, y, alpha=0.8, rasterized=len(x) > MANY_POINTS, zorder=3, **style)
    _draw_periods(axes)
    if along == "gamma":
        _draw_threshold(axes, values, float(found.omega), float(found.xi))
    axes.set_ylabel(r"flight time $\varphi$  (rad)", fontsize=12)


def _dot(cells: int) -> float:
    """Width of a flight's dot, in points."""
    return float(np.clip(450 / cells, 0.7, 3.5))


def _draw_density(
    axes: "Axes", x: NDArray[np.float64], y: NDArray[np.float64], colour: str, dot: float
) -> None:
    """What the dots of these flights, `dot` points wide, would cover, darker where there are more of them."""
    from matplotlib.colors import to_rgb

    columns, rows = COLUMNS_AND_ROWS
    scale = np.log if axes.get_xscale() == "log" else np.asarray
    column = _bins(scale(x), scale(axes.get_xlim()), columns)
    counts = np.bincount(_bins(y, axes.get_ylim(), rows) * columns + column, minlength=columns * rows)
    counts = _widened(counts.reshape(rows, columns), round(dot * DPI / 72))
    shades = np.log(np.maximum(counts, 1)) / np.log(np.clip(counts.max(), 2, OPAQUE))
    image = np.empty((*counts.shape, 4))
    image[..., :3] = to_rgb(colour)
    image[..., 3] = np.where(counts > 0, np.minimum(FAINTEST + (1 - FAINTEST) * shades, 1.0), 0.0)
    # An inset in axes coordinates, which a logarithmic axis does not distort.
    overlay = axes.inset_axes((0.0, 0.0, 1.0, 1.0), zorder=3)
    overlay.set_axis_off()
    overlay.imshow(image, origin="lower", aspect="auto", interpolation="nearest")


def _bins(values: NDArray[np.float64], ends: Any, number: int) -> NDArray[np.int64]:
    """The bin of each value among `number` between two ends."""
    low, high = ends
    return np.asarray(np.clip((values - low) * (number / (high - low)), 0, number - 1), np.int64)


def _widened(counts: NDArray[np.int64], width: int) -> NDArray[np.int64]:
    """Every count spread over a square `width` bins wide; the highest count wins."""
    for axis in (0, 1):
        pad = [(width // 2, (width - 1) // 2) if axis == i else (0, 0) for i in (0, 1)]
        counts = sliding_window_view(np.pad(counts, pad), width, axis).max(axis=-1)
    return counts


def _scale(axes: "Axes", values: NDArray[np.float64], highest: float) -> None:
    from matplotlib.ticker import AutoMinorLocator, MaxNLocator

    if len(values) > 1:
        axes.set_xlim(float(values[0]), float(values[-1]))
    if _is_geometric(values):
        axes.set_xscale("log")
    else:
        axes.xaxis.set_minor_locator(AutoMinorLocator())
    axes.yaxis.set_major_locator(MaxNLocator(8, steps=[1, 2, 5, 10]))
    axes.yaxis.set_minor_locator(AutoMinorLocator())
    axes.set_ylim(0, 1.06 * highest)


def _is_geometric(values: NDArray[np.float64]) -> bool:
    """Whether the values go in equal ratios and not in equal steps."""
    if len(values) < 3 or values[0] <= 0:
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return bool(np.ptp(ratios) < 1e-6 * ratios[0] and np.ptp(steps) > 1e-6 * steps[0])


def _draw_periods(axes: "Axes") -> None:
    """Whole plate periods as faint lines, counted on the right."""
    periods = np.arange(1, int(axes.get_ylim()[1] / PERIOD) + 1)
    periods = periods[:: max(1, len(periods) // 8)]
    right = axes.secondary_yaxis("right")
    right.set_yticks(periods * PERIOD, [rf"${2 * int(n)}\pi$" for n in periods])
    right.tick_params(labelsize=9, length=0, labelcolor="0.45")
    for n in periods:
        axes.axhline(n * PERIOD, color="0.85", linewidth=0.6, zorder=1)


def _draw_threshold(axes: "Axes", values: NDArray[np.float64], omega: float, xi: float) -> None:
    """Γ_th of Eq. 25, where a spring at rest begins to bounce."""
    onset = float(threshold(omega, xi))
    if values[0] <= onset <= values[-1]:
        axes.axvline(onset, color=BLUE, linewidth=0.8, linestyle=(0, (4, 3)), zorder=2)
        axes.annotate(
            r"$\Gamma_{\mathrm{th}}$", (onset, 1), (3, -4), xycoords=("data", "axes fraction"),
            textcoords="offset points", verticalalignment="top", color=BLUE, fontsize=10,
        )  # fmt: skip


def _draw_caption(axes: "Axes", found: xarray.Dataset) -> None:
    fixed = (axis for axis in reversed(AXES) if axis != found.attrs["along"])
    title = ",   ".join(f"{SYMBOLS[axis]} = {float(found[axis]):.6g}" for axis in fixed)
    caption = re.sub("(?<=along )[a-z]+", lambda axis: SYMBOLS[axis[0]], found.attrs["caption"])
    axes.set_title(title, loc="left", fontsize=11)
    axes.set_title(caption, loc="right", fontsize=8.5, color="0.35")


def draw_legend(axes: "Axes", **options: Any) -> None:
    """The directions of a diagram."""
    axes.legend(
        **{"loc": "upper left", "markerscale": 3, "handletextpad": 0.2, "frameon": False} | options
    ).set_zorder(4)


VIEW: Final = View(
    "diagram", "Bifurcation diagram", SweepSpec, DiagramQuery, compute, estimate,
    variables=(*(row for row in schema.ARRAYS if row is not schema.END_STATE), LABEL),
    rows="flight_time", draw=draw, size=SIZE,
)  # fmt: skip
