"""Draws results on axes of matplotlib, for the client, for views and for documents.

Needs only xarray, so that the client stays light. Drawing loads matplotlib.
"""

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import xarray
from numpy.typing import NDArray

from kernel.labels import LABELS
from kernel.threshold import threshold

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
else:  # loaded where something is drawn
    Artist = Axes = Figure = Any

#: The colours of the project by their meaning, each on white and on a dark background. The page reads the
#: same file. Pictures are on white.
PALETTE: Final[dict[str, Any]] = json.loads((Path(__file__).parent / "static/palette.json").read_bytes())
#: Colours of lines by what they show: cells from rest, ramped up or down, Eq. 25, cycles in closed form,
#: masses.
LINES: Final[dict[str, str]] = {name: on_white for name, (on_white, _) in PALETTE["lines"].items()}
#: Colours of attractors by their number, of the other attractors of a plane, and of undecided starts.
ATTRACTORS: Final = tuple(on_white for on_white, _ in PALETTE["attractors"])
OTHER_ATTRACTORS: Final[str] = PALETTE["other_attractors"][0]
UNDECIDED: Final[str] = PALETTE["labels"]["missing"][0]
GREY: Final = "#a6a6a6"  # for anything behind the results
WARNING: Final[str] = LINES["cursor"]

_WAYS: Final = {"rest": "from rest", "up": "ramp up", "down": "ramp down"}

#: Colours of the classes of a map's cells, in the order of the legend, by their names on the page: cycles by
#: their plate periods, and by whether they have fewer, equal or more bounces; longer cycles; other cells by
#: their label.
_LABELLED: Final = {
    "missing": "not computed yet", "at_rest": "at rest", "settling": "still settling",
    "unstable": "unstable cycle",
}  # fmt: skip
CLASSES: Final = (
    {
        f"({sign}{n}, {n})": colour
        for n, colours in enumerate(PALETTE["periods"], 1)
        for sign, colour in zip(("<", "", ">"), colours, strict=True)
    }
    | {f"over {len(PALETTE['periods'])} periods": PALETTE["longer"][0]}
    | {_LABELLED.get(name, name): on_white for name, (on_white, _) in PALETTE["labels"].items()}
)

#: Upper limits of the classes of certified cells, by the modulus of their leading multiplier; and their
#: colours.
MARGINS: Final = (0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
MARGIN_CLASSES: Final = {
    f"{low:g} to {high:g}": colour
    for low, high, colour in zip((0.0, *MARGINS), MARGINS, PALETTE["margins"], strict=False)
}

#: The names of these classes, in this order, in queries.
CLASS_NAMES: Final = (
    *(f"{n}-{than}" for n, _ in enumerate(PALETTE["periods"], 1) for than in ("fewer", "equal", "more")),
    "longer", *PALETTE["labels"], *(f"multiplier-{margin:g}" for margin in MARGINS),
)  # fmt: skip

#: Settings of matplotlib for files. Text is text in an SVG, and embedded as a font in a PDF. Matplotlib has
#: the first font; a viewer of an SVG without it takes the next one.
STYLE: Final[dict[Any, Any]] = {
    "font.family": "serif", "mathtext.fontset": "stix",
    "font.serif": ["STIXGeneral", "STIX Two Text", "Times New Roman", "Liberation Serif"],
    "xtick.direction": "in", "ytick.direction": "in", "xtick.top": True,
    "svg.hashsalt": "bouncing-spring", "svg.fonttype": "none", "pdf.fonttype": 42,
}  # fmt: skip

AXES: Final = {
    "gamma": r"plate acceleration over gravity $\Gamma$",
    "omega": r"plate frequency over that of the spring $\Omega$",
    "xi": r"damping ratio $\xi$",
}
SYMBOLS: Final = {"gamma": r"$\Gamma$", "omega": r"$\Omega$", "xi": r"$\xi$"}
FLIGHT: Final = "flight time (rad)"
#: The contact of every closed form.
IDEAL: Final = "rigid, restitution 0"

#: The hatch over cells of a map whose directions differ, and its name in the legend.
HATCH: Final = "////"
DIFFER: Final = "up and down differ"


#: Height of a strip of modes, relative to the axes.
STRIP: Final = 0.022

#: Ratio of the ends of a logarithmic axis whose linear one begins at zero.
LOG_RANGE: Final = 1000.0
#: Logarithmic axes with a smaller ratio have ticks in equal steps, with a larger one than the second only at
#: powers of ten. First digits of ticks.
LINEAR_RANGE: Final = 30.0
ROUND_RANGE: Final = 1500.0  # three decades, and half a cell at each end
ROUND: Final = (1.0, 2.0, 5.0)

#: Dots per inch of a picture.
DPI: Final = 200
PERIOD: Final = 2 * np.pi  # of the plate, rad
#: Relative sizes of the points of up, drawn first, and of down: where both agree, up shows as a rim.
OVERLAID: Final = (1.7, 0.8)
#: Size of the marker of the larger points in a legend.
LEGEND_DOT: Final = 8.0
#: Height of a legend beside axes, in heights of the axes: it may reach below their labels.
LEGEND_HEIGHT: Final = 1.2
#: More points than this become an image inside an SVG.
MANY_POINTS: Final = 5_000
#: More flights of a direction than this are drawn as density, in bins of a dot. Pixels of the axes.
DENSE_POINTS: Final = 200_000
COLUMNS_AND_ROWS: Final = (1200, 680)
#: Opacity of a bin with one flight, and how many flights make it opaque.
FAINTEST: Final = 0.5
OPAQUE: Final = 24


def along_of(diagram: xarray.Dataset) -> str:
    """The axis of a diagram."""
    [along] = (str(dim) for dim in diagram.flight_time.dims if dim not in ("direction", "flight"))
    return along


def by_direction(result: xarray.Dataset) -> list[xarray.Dataset]:
    """The results of each direction."""
    return [result.isel(direction=i) for i in range(result.sizes.get("direction", 0))] or [result]


def values_at(result: xarray.Dataset, axes: Iterable[str]) -> str:
    """The values of axes at which a result was computed, for titles."""
    return ", ".join(f"{SYMBOLS[axis]} = {result[axis].item():g}" for axis in axes)


def draw_diagram(axes: Axes, diagram: xarray.Dataset, longest: float = 0.0) -> None:
    """The flights of every cell, each direction in its colour: dots, or density where dots would overlap.

    longest: the flight, rad, for which the axes have room; 0 for the longest of the diagram. A cell at rest
    has no flight and so no point.
    """
    along, times, lines = along_of(diagram), diagram.flight_time.values, by_direction(diagram)
    values = diagram[along].values
    highest = longest or float(np.nanmax(times, initial=0.0)) or PERIOD
    _scale(axes, values, max(highest, PERIOD) if "branch_gamma" in diagram else highest)
    axes.set_ylim(diagram.attrs.get("flight_start"), diagram.attrs.get("flight_stop"))
    for line, size in zip(lines, OVERLAID if len(lines) > 1 else (1.0,), strict=True):
        flights, way = line.flight_time.transpose(along, "flight").values, str(line.direction.values)
        shown = np.isfinite(flights)
        x, y = values[np.nonzero(shown)[0]], flights[shown]
        # the dot of marker "." is half as wide as its size
        style: Any = {"marker": ".", "linestyle": "none", "markeredgewidth": 0, "color": LINES[way],
                      "markersize": 2 * dot_of(len(values)) * size, "label": _WAYS[way]}  # fmt: skip
        if len(x) > DENSE_POINTS:
            axes.plot([], [], **style)
            _draw_density(axes, x, y, values, LINES[way])
        else:
            axes.plot(x, y, alpha=0.8, rasterized=len(x) > MANY_POINTS, zorder=3, **style)
    _draw_periods(axes)
    if "branch_gamma" in diagram:
        names = (along, "flight_time", "stable", "violations")
        cycles = xarray.Dataset({name: diagram.variables[f"branch_{name}"] for name in names})
        cycles = cycles.assign(flight_time=cycles.flight_time.where(cycles.violations == 0))
        draw_branches(axes, cycles, along)
        plate = "" if diagram.attrs.get("own_branches", True) else ", ideal plate"
        for style, label in (("-", f"stable cycle{plate}"), ("--", f"unstable cycle{plate}")):
            axes.plot([], [], style, color=LINES["branch"], label=label, markersize=0.0)
    if along == "gamma" and diagram.attrs.get("model") != "ball":  # which has no spring
        _draw_threshold(axes, values, float(diagram.omega), float(diagram.xi))
    axes.set(xlabel=AXES[along], ylabel=FLIGHT)
    _set_scales(axes, diagram)


def draw_incomplete(axes: Axes, reason: str) -> None:
    """Over the axes, that the result is incomplete, and why."""
    axes.annotate(
        f"incomplete: {reason}", (0.5, 0.5), xycoords="axes fraction", ha="center", color=WARNING,
        fontsize=11, zorder=5,
        bbox={"facecolor": "white", "edgecolor": WARNING, "linewidth": 0.6, "alpha": 0.9, "pad": 5},
    )  # fmt: skip


def dot_of(cells: int) -> float:
    """Width of a flight's dot, in points."""
    return float(np.clip(450 / cells, 0.7, 3.5))


def _draw_density(
    axes: Axes, x: NDArray[np.float64], y: NDArray[np.float64], values: NDArray[np.float64], colour: str
) -> None:
    """Flights at values of the axis, as bins of a dot's size that are darker with more flights."""
    from matplotlib.colors import LinearSegmentedColormap, LogNorm, to_rgba

    columns, rows = (int(n * 72 / DPI / dot_of(len(values))) for n in COLUMNS_AND_ROWS)
    spaced = np.geomspace if axes.get_xscale() == "log" else np.linspace
    bins = edges(values) if len(values) <= columns else spaced(*axes.get_xlim(), columns + 1)
    shades = LinearSegmentedColormap.from_list("", [to_rgba(colour, FAINTEST), to_rgba(colour)])
    axes.hist2d(
        x, y, (bins, np.linspace(*axes.get_ylim(), rows + 1)), cmin=1, cmap=shades, zorder=3, rasterized=True,
        norm=LogNorm(1, OPAQUE, clip=True),
    )  # fmt: skip


def _scale(axes: Axes, values: NDArray[np.float64], highest: float) -> None:
    from matplotlib.ticker import AutoMinorLocator, MaxNLocator

    if len(values) > 1:
        axes.set_xlim(float(values[0]), float(values[-1]))
    if _is_geometric(values):
        _make_logarithmic(axes, "x")
    else:
        axes.xaxis.set_minor_locator(AutoMinorLocator())
    axes.yaxis.set_major_locator(MaxNLocator(8, steps=[*ROUND, 10.0]))
    axes.yaxis.set_minor_locator(AutoMinorLocator())
    axes.set_ylim(0, 1.06 * highest)


def _set_scales(axes: Axes, result: xarray.Dataset) -> None:
    """Make the axes in the attribute `log` logarithmic, for values above zero, and the others linear."""
    for name in "xy" if "log" in result.attrs else "":
        if name in result.attrs["log"]:
            _make_logarithmic(axes, name)
        elif getattr(axes, f"get_{name}scale")() == "log":  # a linear axis keeps its ticks
            getattr(axes, f"set_{name}scale")("linear")


def _make_logarithmic(axes: Axes, name: str) -> None:
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, ScalarFormatter

    low, high = getattr(axes, f"get_{name}lim")()
    low = low if low > 0.0 else high / LOG_RANGE
    getattr(axes, f"set_{name}lim")(low, high)
    getattr(axes, f"set_{name}scale")("log")
    axis, ratio = getattr(axes, f"{name}axis"), high / low
    digits = LogLocator(subs=ROUND) if ratio <= ROUND_RANGE else LogLocator()
    axis.set_major_locator(digits if ratio > LINEAR_RANGE else MaxNLocator(8, steps=[*ROUND, 10.0]))
    axis.set_major_formatter("{x:g}" if ratio > LINEAR_RANGE else ScalarFormatter())
    axis.set_minor_formatter(NullFormatter())


def _is_geometric(values: NDArray[np.float64]) -> bool:
    """Whether values have equal ratios and not equal steps."""
    if len(values) < 3 or values[0] <= 0:
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return bool(np.ptp(ratios) < 1e-6 * ratios[0] and np.ptp(steps) > 1e-6 * steps[0])


def _draw_periods(axes: Axes) -> None:
    """Whole plate periods as faint lines, counted on the right."""
    low, high = axes.get_ylim()
    periods = range(max(1, math.ceil(low / PERIOD)), int(high / PERIOD) + 1)
    for n in periods[:: max(1, len(periods) // 8)]:
        axes.axhline(n * PERIOD, color="0.85", linewidth=0.6, zorder=1)
        axes.annotate(
            rf"${2 * n}\pi$", (1, n * PERIOD), (4, 0), xycoords=("axes fraction", "data"),
            textcoords="offset points", verticalalignment="center", color="0.45", fontsize=9,
        )  # fmt: skip


def _draw_threshold(axes: Axes, values: NDArray[np.float64], omega: float, xi: float) -> None:
    """Γ_th of Eq. 25, at which a spring at rest begins to bounce."""
    onset = float(threshold(omega, xi))
    if values[0] <= onset <= values[-1]:
        axes.axvline(onset, color=LINES["threshold"], linewidth=0.8, linestyle=(0, (4, 3)), zorder=2)
        axes.annotate(
            r"$\Gamma_{\mathrm{th}}$", (onset, 1), (3, -4), xycoords=("data", "axes fraction"),
            textcoords="offset points", verticalalignment="top", color=LINES["threshold"], fontsize=10,
        )  # fmt: skip


def draw_branches(ax: Axes, branches: xarray.Dataset, along: str = "gamma") -> None:
    """Flight times over the parameter: solid if stable, dashed if unstable, thin dots if not admissible."""
    for i in range(branches.sizes["branch"]):
        branch = branches.isel(branch=i)
        gamma, flight = branch[along].values, branch.flight_time.values
        stable, admissible = branch.stable.values.astype(bool), branch.violations.values == 0
        for shown, style, width in (
            (stable & admissible, "-", 1.4),
            (~stable & admissible, "--", 1.0),
            (~admissible, ":", 0.6),
        ):
            shown[1:] |= shown[:-1]  # up to the beginning of the next piece
            x = np.where(shown, gamma, np.nan)
            ax.plot(x, flight, color=LINES["branch"], zorder=4, linestyle=style, linewidth=width)


def draw_cycles(ax: Axes, branches: xarray.Dataset) -> None:
    """Branches as `draw_branches`, with labels of the axes and a title."""
    along = branches.attrs.get("along", "gamma")
    draw_branches(ax, branches, along)
    fixed = ("gamma", "omega", "xi") if along != "gamma" and branches.gamma.size else ("omega", "xi")
    values = {axis: branches[axis].values.flat[0] for axis in fixed if axis != along}
    title = ", ".join(f"{SYMBOLS[axis]} = {value:g}" for axis, value in values.items())
    model = branches.attrs["model"]
    ax.set(xlabel=AXES[along], ylabel=FLIGHT, title=title if model == IDEAL else f"{title}: {model}")
    for style, label in (("-", "stable"), ("--", "unstable"), (":", "not admissible")):
        ax.plot([], [], color=LINES["branch"], linestyle=style, label=label)
    legend_beside(ax, ax.get_legend_handles_labels()[0])


def classes_of(arrays: Mapping[Any, Any], multiplier: NDArray[np.float64] | None = None) -> NDArray[np.int64]:
    """The index into CLASS_NAMES of each cell, from its label or outcome and its mode.

    Where it has a multiplier, from that. arrays: by name, or a Dataset.
    """
    names = ("label" if "label" in arrays else "outcome", "bounces", "periods")
    labels, bounces, periods = (np.asarray(arrays[name]) for name in names)
    cycles = 3 * (periods - 1) + 1 + np.sign(bounces - periods)
    cycles = np.where(periods > len(PALETTE["periods"]), CLASS_NAMES.index("longer"), cycles)
    cells = np.full(labels.shape, CLASS_NAMES.index("missing"))
    for code, label in enumerate(LABELS):
        labelled = labels == code
        cells[labelled] = cycles[labelled] if label == "periodic" else CLASS_NAMES.index(label)
    if multiplier is None:
        return cells
    margins = len(CLASSES) + np.searchsorted(MARGINS[:-1], multiplier, side="right")
    return np.where(np.isfinite(multiplier), margins, cells)


def draw_returns(ax: Axes, diagram: xarray.Dataset) -> None:
    """Each flight of one cell over the flight before, and the diagonal, where cycles of one flight lie."""
    times = diagram.flight_time.values
    low, high = np.nanmin(times, initial=np.inf), np.nanmax(times, initial=0.0)
    ends = (max(min(low, high) - 0.05 * high, 0.0), 1.05 * high or PERIOD)
    for line in by_direction(diagram):
        flights, way = line.flight_time.values.ravel(), str(line.direction.values)
        flights = flights[np.isfinite(flights)]
        ax.plot(flights[:-1], flights[1:], ".", color=LINES[way], markersize=5, label=_WAYS[way], zorder=3)
    ax.plot(ends, ends, color="0.7", linewidth=0.8, zorder=1)
    ax.set(xlim=ends, ylim=ends, aspect="equal", title=values_at(diagram, AXES))
    ax.set(xlabel=FLIGHT, ylabel="next flight time (rad)")


def draw_exponents(ax: Axes, diagram: xarray.Dataset) -> None:
    """The largest Lyapunov exponent along the axis with its standard error, the others faint."""
    along = along_of(diagram)
    for line in by_direction(diagram):
        exponents = line.lyapunov.transpose(along, "exponent").values
        way, finite = str(line.direction.values), np.where(np.isfinite(exponents), exponents, np.nan)
        style: Any = {"color": LINES[way], "linewidth": 1.0}
        ax.plot(line[along].values, finite[:, 1:], alpha=0.3, **style)
        ax.errorbar(
            line[along].values, finite[:, 0], line.lyapunov_error.values, label=_WAYS[way], fmt=".-",
            markersize=2, elinewidth=0.6, **style,
        )  # fmt: skip
    ax.axhline(0.0, color="0.6", linewidth=0.8, zorder=1)
    ax.set(xlabel=AXES[along], ylabel=r"Lyapunov exponents $\lambda$ (per plate period)")
    ax.set_title(values_at(diagram, (axis for axis in AXES if axis != along)))


def draw_measured(ax: Axes, points: Any, axis: NDArray[np.float64], computed: NDArray[np.float64]) -> None:
    """Measured points with their errors, and below them their residuals from the nearest computed values.

    points: a `service.client.measured.Measured`. computed (n, k): values at the n values of the axis, NaN
    where there are fewer. A point more than half a step beyond the axis has no residual.
    """
    cell = np.clip(np.searchsorted(edges(axis), points.x) - 1, 0, len(axis) - 1)
    differences = points.y[:, None] - computed[cell]
    differences[(points.x < edges(axis)[0]) | (points.x > edges(axis)[-1])] = np.nan
    nearest = np.where(np.isnan(differences), np.inf, np.abs(differences)).argmin(axis=1)
    residual = differences[np.arange(len(nearest)), nearest]
    _draw_points(ax, points.x, points.y, points.error, "measured")
    figure = ax.get_figure(root=True)
    if figure is not None and figure.get_layout_engine() is not None:  # it would make no room
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
    x, y, width, height = ax.get_position().bounds
    ax.set_position((x, y + 0.32 * height, width, 0.68 * height))
    below = ax.inset_axes((0.0, -0.47, 1.0, 0.35), sharex=ax)
    below.set_xlabel(ax.get_xlabel())
    below.axhline(0.0, color="0.6", linewidth=0.8)
    _draw_points(below, points.x, residual, points.error)
    below.set_title("measured − computed", loc="left", fontsize=8, pad=2)
    ax.set_xlabel("")
    ax.tick_params(labelbottom=False)
    near = np.abs(residual[np.isfinite(residual)])
    summary = f"{len(near)} of {len(residual)} points"
    if len(near):
        summary += f": median {np.median(near):.2g}, largest {near.max():.2g}"
    below.set_title(summary, loc="right", fontsize=8, pad=2)


def _draw_points(ax: Axes, x: Any, y: Any, error: Any, label: str = "") -> None:
    """Draw points with error bars, all in one collection: `errorbar` makes arrays for each point."""
    from matplotlib.collections import LineCollection

    bars = np.array([[x, x], [y - error, y + error]]).T
    bars = bars[np.isfinite(bars).all(axis=(1, 2))]
    ax.add_collection(LineCollection(bars, colors=WARNING, linewidths=1.0, zorder=6))
    ax.plot(x, y, "D", color=WARNING, markersize=4, markerfacecolor="white", label=label, zorder=6)


def draw_strips(ax: Axes, diagram: xarray.Dataset) -> None:
    """Above a diagram, a strip of each direction with the modes of its cells, and a legend.

    Classes in the attribute `hide` are left out.
    """
    cells = np.atleast_2d(classes_of(diagram))
    hidden = [CLASS_NAMES.index(name) for name in diagram.attrs.get("hide", "").split(",") if name]
    shown = np.ma.masked_where(np.isin(cells, hidden), cells)
    low, high = ax.get_xlim()
    ends = np.clip(edges(diagram[along_of(diagram)].values), low, high)
    above: Any = {"transform": ax.get_xaxis_transform(), "clip_on": False}
    for i, strip in enumerate(shown):
        sides = 1.0 + STRIP * (len(shown) - i - np.array([0.8, 0.0]))
        draw_cells(ax, ends, sides, strip[np.newaxis], CLASSES.values(), **above)
    lines: list[Any] = ax.get_legend_handles_labels()[0]
    lines = lines if len(lines) > 1 else []
    dot = max((line.get_markersize() for line in lines), default=1.0)
    legend_beside(ax, [*lines, *entries(shown, CLASSES)], 1.05, markerscale=LEGEND_DOT / dot)


def draw_caption(axes: Axes, result: xarray.Dataset) -> None:
    """Above a diagram, the values of the other axes, and how it was computed."""
    fixed = (axis for axis in AXES if axis != result.attrs["along"])
    title = ",   ".join(f"{SYMBOLS[axis]} = {float(result[axis]):.6g}" for axis in fixed)
    caption = re.sub("(?<=along )[a-z]+", lambda axis: SYMBOLS[axis[0]], result.attrs["caption"])
    pad = 4 + 9 * result.sizes.get("direction", 1)  # above the strips
    axes.set_title(title, loc="left", fontsize=11, pad=pad)
    axes.set_title(caption, loc="right", fontsize=8.5, color="0.35", pad=pad)


def entries(cells: NDArray[Any], classes: Mapping[str, str]) -> list[Artist]:
    """Legend entries of the classes that cells have; cells: indices into `classes`."""
    from matplotlib.patches import Patch

    names = list(classes)
    return [
        Patch(facecolor=classes[names[i]], edgecolor="black", linewidth=0.4, label=names[i])
        for i in np.unique(np.ma.compressed(cells)).tolist()
    ]


def draw_modes(ax: Axes, modes: xarray.Dataset) -> None:
    """The cells of the plane (Γ, Ω) in the colours of their classes, and of a spring Eq. 25 over them.

    With `multiplier`, certified cells by their margin of stability. With the attribute `hide`, missing cells
    are left out, as hidden cells are missing.
    """
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    classes = CLASSES | MARGIN_CLASSES
    multiplier = modes.multiplier.values if "multiplier" in modes else None
    cells = classes_of(modes, multiplier)
    counted = (
        "(bounces, plate periods) of a cycle" if multiplier is None else "modulus of the leading multiplier"
    )
    corners = edges(modes.gamma.values), edges(modes.omega.values)
    if "hide" in modes.attrs:
        cells = np.ma.masked_equal(cells, CLASS_NAMES.index("missing"))
    draw_cells(ax, *corners, cells, classes.values())
    for name, axis in (("x", "gamma"), ("y", "omega")):
        if _is_geometric(modes[axis].values):
            _make_logarithmic(ax, name)
    handles = entries(cells, classes)
    if modes.attrs.get("model") != "ball":
        handles += _draw_threshold_curve(ax, modes)
    if "hysteresis" in modes and (differ := modes.hysteresis.values > 0).any():
        ax.pcolor(
            *corners, np.ma.masked_where(~differ, differ),
            cmap=ListedColormap(["none"]), edgecolor="none", hatch=HATCH,
        )  # fmt: skip
        handles.append(Patch(facecolor="none", edgecolor="black", linewidth=0.4, hatch=HATCH, label=DIFFER))
    legend_beside(ax, handles)
    ax.set(xlabel=AXES["gamma"], ylabel=AXES["omega"])
    mark_single(ax, modes.gamma.values, modes.omega.values)
    way = str(modes.direction.values) if "direction" in modes else "rest"
    ramped = "" if way == "rest" else f", {_WAYS[way]}"
    share = modes.attrs.get("computed_share", 1.0)
    filled = "" if share == 1.0 else f", {100.0 * share:.2g} % of the cells computed"
    ax.set_title(f"{values_at(modes, ['xi'])}, {counted}{ramped}{filled}")
    _set_scales(ax, modes)


def _draw_threshold_curve(ax: Axes, modes: xarray.Dataset) -> list[Artist]:
    """Γ_th of Eq. 25 over Ω, for a legend if it is in view; across cells of one Ω or Γ what it is there."""
    left, right, low, high = ax.axis(ax.axis())  # those of the cells
    omega = np.geomspace(low if low > 0.0 else high / LOG_RANGE, high, 2000)
    onsets = threshold(omega, modes.xi.item())
    if len(modes.omega) == 1:
        onsets, omega = threshold(modes.omega.values, modes.xi.item()).repeat(2), np.array([low, high])
    elif len(modes.gamma) == 1:
        crossed = omega[1:][np.diff(onsets > modes.gamma.values)]
        onsets, omega = np.tile([left, right, np.nan], len(crossed)), crossed.repeat(3)
    ax.plot(onsets, omega, color="white", linewidth=2.4)
    lines = ax.plot(onsets, omega, "--", color="black", linewidth=1.1, label="threshold, Eq. 25")
    sides = np.digitize(onsets, [left, right])  # a step from one side to the other passes through
    return [*lines] if np.any(sides == 1) or np.any(np.abs(np.diff(sides)) > 1) else []


def draw_cells(
    ax: Axes, x: NDArray[Any], y: NDArray[Any], codes: NDArray[Any], colours: Iterable[str], **options: Any
) -> None:
    """Cells between these sides, each in the colour of its code, from 0."""
    from matplotlib.colors import ListedColormap

    shades = ListedColormap(list(colours))
    ax.pcolormesh(x, y, codes, rasterized=True, cmap=shades, vmin=-0.5, vmax=shades.N - 0.5, **options)


def mark_single(ax: Axes, x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
    """Put the only tick of an axis of one value there: the width of its cell says nothing."""
    for axis, values in ((ax.xaxis, x), (ax.yaxis, y)):
        if len(values) == 1:
            axis.set_ticks(values)


def legend_beside(ax: Axes, entries: Sequence[Artist], left: float = 1.01, **options: Any) -> None:
    """A legend to the right of the axes, in as many columns as it takes; left: its place, in their widths."""
    place: Any = {"loc": "upper left", "bbox_to_anchor": (left, 1.0), "borderaxespad": 0.0, "frameon": False}
    column = ax.legend(handles=entries, **place, **options).get_window_extent().height
    columns = math.ceil(column / (LEGEND_HEIGHT * ax.get_window_extent().height))
    if columns > 1:
        ax.legend(handles=entries, ncols=columns, **place, **options)


def draw_thresholds(ax: Axes, thresholds: xarray.Dataset) -> None:
    """Thresholds over Ω: computed, by Eq. 25, in closed form, and searched."""
    omega, predicted = thresholds.omega.values, thresholds.predicted_down.values
    causes = thresholds.cause.values if "cause" in thresholds else np.full(len(omega), "")
    searched = np.array([str(cause).endswith(", searched") for cause in causes])
    dash, dot = ("_", "o") if len(omega) == 1 else ("", "")  # one point has no line
    for form, color, label, values, size in (
        (f"{dash}--", "threshold", "Eq. 25", thresholds.analytic.values, 12),
        (f"{dot}-", "branch", "closed form, down", np.where(searched, np.nan, predicted), 4),
        ("D", "branch", "searched, down", np.where(searched, predicted, np.nan), 5),
        ("^", "up", "computed, up", thresholds.up.values, 4),
        ("v", "down", "computed, down", thresholds.down.values, 4),
    ):
        if np.isfinite(values).any():
            width, fill = (1.0 if "--" in form else 1.4), ("none" if form == "D" else "full")
            style: Any = {"linewidth": width, "markersize": size, "fillstyle": fill}
            ax.plot(omega, values, form, color=LINES[color], label=label, **style)
    for status in ("unresolved", "not searched"):
        number = int((causes == status).sum())
        if number:
            ax.plot([], [], " ", label=f"closed form, {status}: {number} of {len(omega)}")
    ax.set(xlabel=AXES["omega"], ylabel=r"threshold $\Gamma$", title=values_at(thresholds, ["xi"]))
    window = (thresholds.attrs.get("gamma_start"), thresholds.attrs.get("gamma_stop"))
    ax.set_ylim(*window, auto=window == (None, None))  # with room for measured points
    ax.legend(*ax.get_legend_handles_labels(), frameon=False)  # of a ball there may be none


def edges(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ends of the cells around increasing values; with equal ratios if the values have equal ratios."""
    if len(values) == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    if _is_geometric(values):
        return np.exp(edges(np.log(values)))
    middle = 0.5 * (values[1:] + values[:-1])
    return np.concatenate([[2.0 * values[0] - middle[0]], middle, [2.0 * values[-1] - middle[-1]]])


def metadata(format: str, origin: Mapping[str, str]) -> dict[str, str | None]:
    """The origin under the format's names of metadata, without the time of drawing."""
    program = f"bouncing-spring {origin['release']}"
    described = json.dumps(dict(origin), ensure_ascii=False)
    if format == "png":
        return {"Software": program, "Description": described}
    if format == "svg":
        return {"Creator": program, "Description": described, "Date": None}
    return {"Creator": program, "Subject": described, "CreationDate": None}
