"""Bifurcation diagrams: the flights of all cells along one axis of the grid."""

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import numpy as np
import xarray
from numpy.typing import NDArray
from pydantic import Field

from kernel.labels import CHAOTIC, LABELS, QUASI_PERIODIC, UNSTABLE
from kernel.params import Outcome
from kernel.recount import counted
from kernel.threshold import threshold
from service.results.counting import LABEL, recounted, shortest
from service.results.density import Window, density
from service.results.selection import Stored, between, directions_of, fixed_axes, read
from service.views.variables import coordinate, variable
from service.views.view import Direction, Estimate, Every, MinFlight, Number, Query, View
from worker import schema
from worker.spec import AXES, SweepSpec
from worker.spec.contact_models import CONTACT_MODELS

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
    fixed = fixed_axes(spec, along, {axis: getattr(query, axis) for axis in AXES})
    directions = directions_of(spec, query.direction)
    window = between(spec.axis_values(along), query.start, query.stop)
    part = slice(window.start, window.stop, query.every)
    indices = {axis: at.index for axis, at in fixed.items()} | {along: part}
    lines = [_line(study, direction, indices, query.min_flight) for direction in directions]
    both = len(directions) > 1
    dims = ("direction", along) if both else (along,)
    arrays = {name: np.stack([line[name] for line in lines]) if both else lines[0][name] for name in lines[0]}
    rows = {row.name: row for row in rows_of(spec)}
    coords = {
        "direction": coordinate("direction", list(directions) if both else directions[0]),
        **{axis: coordinate(axis, at.value) for axis, at in fixed.items()},
        along: coordinate(along, spec.axis_values(along)[part]),
    }
    attrs: dict[str, Any] = {
        "along": along, "min_flight": shortest(spec, query.min_flight), "every": query.every,
        "model": spec.model.kind, "complete": study.is_complete(arrays["outcome"]),
    }  # fmt: skip
    if query.caption:
        attrs["caption"] = _caption(spec, attrs, arrays)
    return xarray.Dataset(
        {name: variable(dims, values, rows[name]) for name, values in arrays.items()}, coords, attrs
    )


def rows_of(spec: SweepSpec) -> Iterator[schema.Array]:
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
    arrays = read(study, names, direction, indices)
    arrays |= recounted(spec, arrays, min_flight)
    shown = counted(arrays["flight_time"], arrays["flights"], shortest(spec, min_flight))
    for name in ("flight_time", "takeoff_phase"):
        arrays[name] = np.where(shown, arrays[name], np.nan)
    return arrays


def estimate(spec: SweepSpec, query: DiagramQuery) -> Estimate:
    """All flights that the line can have. Raises InvalidRequest for a line that the sweep does not have."""
    fixed_axes(spec, query.along, {axis: getattr(query, axis) for axis in AXES})
    directions = directions_of(spec, query.direction)
    window = between(spec.axis_values(query.along), query.start, query.stop)
    lengths = {query.along: len(window), "flight": spec.keep}
    if len(directions) > 1:
        lengths = {"direction": len(directions), **lengths}
    return Estimate(lengths, (query.along,), query.every, reads=(query.along,))


def _caption(spec: SweepSpec, attrs: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> str:
    """How the cells were computed and which of them are shown."""
    start = "from rest" if spec.ramp_axis is None else f"ramped along {spec.ramp_axis}"
    flights = f", flights above {attrs['min_flight']:g} rad" if attrs["min_flight"] else ""
    thinned = f", 1 cell in {attrs['every']:,}" if attrs["every"] > 1 else ""
    outcome = arrays["outcome"]
    lost = int(np.count_nonzero(np.isin(outcome, (Outcome.UNRESOLVED, Outcome.DIVERGED))))
    unresolved = f", {lost:,} of {outcome.size:,} cells unresolved" if lost else ""
    codes = arrays.get(LABEL.name, outcome)
    special = (Outcome.SETTLING, QUASI_PERIODIC, CHAOTIC, UNSTABLE)
    counts = {code: int(np.count_nonzero(codes == code)) for code in special}
    told_apart = "".join(f", {count:,} {LABELS[code]}" for code, count in counts.items() if count)
    return f"{CONTACT_MODELS[spec.model.kind].label}, {start}{flights}{thinned}{unresolved}{told_apart}"


#: Inches.
SIZE: Final = (6.8, 4.2)

#: Relative size of the points: of a single direction; of up, drawn larger, and of down over it, so that up
#: shows as a rim where the two agree.
ALONE: Final = (("black", 1.0),)
OVERLAID: Final = (("#a6a6a6", 1.7), ("#b2182b", 0.8))

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
    along = found.attrs["along"]
    lines = [found.isel(direction=i) for i in range(found.sizes.get("direction", 0))] or [found]
    values, longest = found[along].values, float(np.nanmax(found.flight_time.values, initial=0.0))
    _scale(axes, values, longest or PERIOD)
    for line, (colour, size) in zip(lines, ALONE if len(lines) == 1 else OVERLAID, strict=True):
        few = np.count_nonzero(np.isfinite(line.flight_time.values)) <= DENSE_POINTS
        (_draw_points if few else _draw_density)(axes, line, along, colour, size)
    _draw_periods(axes)
    if along == "gamma":
        _draw_threshold(axes, values, float(found.omega), float(found.xi))
    _label(axes, found)
    if len(lines) > 1:
        _legend(axes)
    if not found.attrs["complete"]:
        missing = int(np.count_nonzero(found.outcome.values == Outcome.MISSING))
        total = found.outcome.size
        _warn(axes, f"{missing:,} of {total:,} cells are not computed yet" if missing else "being repaired")


def _draw_points(axes: "Axes", line: xarray.Dataset, along: str, colour: str, scale: float) -> None:
    times = line.flight_time.values
    cells, flights = np.nonzero(np.isfinite(times))
    axes.plot(
        line[along].values[cells], times[cells, flights], linestyle="none", marker=".",
        markersize=2 * _dot(len(times)) * scale,  # the dot of marker "." is half its size wide
        markeredgewidth=0, color=colour, alpha=0.8, rasterized=len(cells) > MANY_POINTS,
        label=str(line.direction.values), zorder=3,
    )  # fmt: skip


def _dot(cells: int) -> float:
    """Width of a flight's dot, in points."""
    return float(np.clip(450 / max(cells, 1), 0.7, 3.5))


def _draw_density(axes: "Axes", line: xarray.Dataset, along: str, colour: str, scale: float) -> None:
    """What the dots of `_draw_points` would cover, darker where there are more of them."""
    from matplotlib.colors import to_rgb

    from service.render.style import DPI

    times = line.flight_time.values
    shown = np.isfinite(times)
    window = Window(*axes.get_xlim(), *axes.get_ylim())
    log = axes.get_xscale() == "log"
    numbers = np.count_nonzero(shown, axis=1)
    counts = density(line[along].values, numbers, times[shown], window, *COLUMNS_AND_ROWS, log)
    dot = _dot(len(times)) * scale
    counts = _widened(counts, round(dot * DPI / 72))
    shades = np.log(np.maximum(counts, 1)) / np.log(np.clip(counts.max(), 2, OPAQUE))
    image = np.empty((*counts.shape, 4))
    image[..., :3] = to_rgb(colour)
    image[..., 3] = np.where(counts > 0, np.minimum(FAINTEST + (1 - FAINTEST) * shades, 1.0), 0.0)
    # An inset in axes coordinates, which a logarithmic axis does not distort.
    overlay = axes.inset_axes((0.0, 0.0, 1.0, 1.0), zorder=3)
    overlay.set_axis_off()
    overlay.imshow(image, origin="lower", aspect="auto", interpolation="nearest")
    label = str(line.direction.values)
    axes.plot([], [], ".", markersize=2 * dot, markeredgewidth=0, color=colour, label=label)


def _widened(counts: NDArray[np.int64], width: int) -> NDArray[np.int64]:
    """Every count spread over a square `width` bins wide; the highest count wins."""
    back = (width - 1) // 2
    for axis in (0, 1):
        spread = counts
        for shift in range(-back, width - back):
            shifted = np.roll(counts, shift, axis)
            edge = slice(0, shift) if shift > 0 else slice(counts.shape[axis] + shift, None)
            shifted[(edge, slice(None)) if axis == 0 else (slice(None), edge)] = 0
            spread = np.maximum(spread, shifted)
        counts = spread
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
    _, top = axes.get_ylim()
    periods = np.arange(1, int(top / PERIOD) + 1)
    periods = periods[:: max(1, len(periods) // 8)]
    right = axes.secondary_yaxis("right")
    right.set_yticks(periods * PERIOD, [rf"${2 * int(n)}\pi$" for n in periods])
    right.tick_params(labelsize=9, length=0, labelcolor="0.45")
    for label in right.get_yticklabels():
        label.set_math_fontfamily("stix")
    for n in periods:
        axes.axhline(n * PERIOD, color="0.85", linewidth=0.6, zorder=1)


def _draw_threshold(axes: "Axes", values: NDArray[np.float64], omega: float, xi: float) -> None:
    """Γ_th of Eq. 25, where a spring at rest begins to bounce."""
    from service.render.style import BLUE

    onset = float(threshold(omega, xi))
    if values[0] <= onset <= values[-1]:
        axes.axvline(onset, color=BLUE, linewidth=0.8, linestyle=(0, (4, 3)), zorder=2)
        axes.annotate(
            r"$\Gamma_{\mathrm{th}}$", (onset, 1), (3, -4), xycoords=("data", "axes fraction"),
            textcoords="offset points", verticalalignment="top", color=BLUE, fontsize=10,
            math_fontfamily="stix",
        )  # fmt: skip


def _label(axes: "Axes", found: xarray.Dataset) -> None:
    from service.render.style import FONT, SYMBOLS, TEXT

    along = found.attrs["along"]
    axes.set_xlabel(SYMBOLS[along], fontsize=12, **TEXT)
    axes.set_ylabel(r"flight time $\varphi$  (rad)", fontsize=12, **TEXT)
    axes.tick_params(which="both", direction="in", top=True, labelfontfamily=FONT, labelsize=10)
    if "caption" not in found.attrs:
        return
    fixed = (axis for axis in reversed(AXES) if axis != along)
    title = ",   ".join(f"{SYMBOLS[axis]} = {float(found[axis]):.6g}" for axis in fixed)
    caption = re.sub("(?<=along )[a-z]+", lambda axis: SYMBOLS[axis[0]], found.attrs["caption"])
    axes.set_title(title, loc="left", fontsize=11, **TEXT)
    axes.set_title(caption, loc="right", fontsize=8.5, color="0.35", **TEXT)


def _legend(axes: "Axes") -> None:
    from service.render.style import FONT

    legend = axes.legend(
        loc="upper left", frameon=False, markerscale=3, handletextpad=0.2, prop={"family": FONT, "size": 10}
    )
    legend.set_zorder(4)


def _warn(axes: "Axes", reason: str) -> None:
    from service.render.style import FONT, RED

    axes.annotate(
        f"incomplete: {reason}", (0.5, 0.5), xycoords="axes fraction", ha="center", color=RED, fontsize=11,
        fontfamily=FONT, zorder=5,
        bbox={"facecolor": "white", "edgecolor": RED, "linewidth": 0.6, "alpha": 0.9, "pad": 5},
    )  # fmt: skip


_LARGEST: Final = SweepSpec.parse(
    {"gamma": [1, 2], "omega": 1, "xi": 0.1, "exponents": 1, "refine": {"by": "mode"}}
)
VIEW: Final = View(
    "diagram", "Bifurcation diagram", SweepSpec, DiagramQuery, compute, estimate,
    variables=tuple(rows_of(_LARGEST)), rows="flight_time", draw=draw, size=SIZE,
)  # fmt: skip
