"""A diagram as a picture fit for a paper."""

import io
import threading
from collections.abc import Sequence
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import AutoMinorLocator, MaxNLocator
from numpy.typing import NDArray

from kernel.params import Outcome
from kernel.threshold import threshold
from service.results.density import Window, density
from service.results.diagram import Diagram
from worker.spec import SweepSpec

SYMBOLS: Final = {"gamma": r"$\Gamma$", "omega": r"$\Omega$", "xi": r"$\xi$"}

#: Colour and relative size of the points: of one direction; of up below down, a rim where the two agree.
#: The colours survive colour blindness and a photocopier.
ALONE: Final = (("black", 1.0),)
OVERLAID: Final = (("#a6a6a6", 1.7), ("#b2182b", 0.8))

FONT: Final = "STIXGeneral"
TEXT: Final[dict[str, Any]] = {"fontfamily": FONT, "math_fontfamily": "stix"}
TURN: Final = 2 * np.pi
DPI: Final = 200

#: More points than this become an image inside an SVG.
MANY_POINTS: Final = 5_000

#: More of a direction are drawn as density, on so many columns and rows: about the pixels of the axes.
DENSE_POINTS: Final = 200_000
COLUMNS_AND_ROWS: Final = (1200, 680)
#: Opacity of a part of the picture on which one flight falls, and how many it takes to be opaque.
FAINTEST: Final = 0.5
OPAQUE: Final = 24

#: matplotlib shares caches between figures without locking them.
drawing: Final = threading.Lock()


def as_picture(diagrams: Sequence[Diagram], spec: SweepSpec, format: str) -> bytes:
    """A PNG or SVG of flight times along the axis, the directions over each other.

    A cell at rest has no flight and so no point. Missing cells are told on the picture.
    """
    with drawing, mpl.rc_context({"svg.hashsalt": "bouncing-spring"}):  # the same diagram is the same file
        figure = Figure(figsize=(6.8, 4.2), dpi=DPI, layout="constrained")
        _draw(figure.subplots(), diagrams, spec)
        file = io.BytesIO()
        figure.savefig(file, format=format, metadata={"Date": None} if format == "svg" else {})
    return file.getvalue()


def _draw(axes: Axes, diagrams: Sequence[Diagram], spec: SweepSpec) -> None:
    first = diagrams[0]
    _scale(axes, first.values, max(_highest(diagram) for diagram in diagrams))
    for diagram, (colour, size) in zip(diagrams, ALONE if len(diagrams) == 1 else OVERLAID, strict=True):
        if np.count_nonzero(diagram.shown) > DENSE_POINTS:
            _draw_density(axes, diagram, colour, size)
        else:
            _draw_points(axes, diagram, colour, size)
    _draw_turns(axes)
    if first.along == "gamma":
        _draw_threshold(axes, first)
    _describe(axes, first, spec)
    if len(diagrams) > 1:
        _legend(axes)
    _warn(axes, sum(diagram.missing for diagram in diagrams), sum(len(one.values) for one in diagrams))


def _draw_points(axes: Axes, diagram: Diagram, colour: str, scale: float) -> None:
    cells, flights = np.nonzero(diagram.shown)
    axes.plot(
        diagram.values[cells],
        diagram.flight_time[cells, flights],
        linestyle="none",
        marker=".",
        markersize=2 * _dot(diagram) * scale,  # the dot is half as wide as its marker
        markeredgewidth=0,
        color=colour,
        alpha=0.8,
        rasterized=len(cells) > MANY_POINTS,
        label=diagram.direction,
        zorder=3,
    )


def _dot(diagram: Diagram) -> float:
    """Width of a flight's dot, in points."""
    return float(np.clip(450 / max(len(diagram.values), 1), 0.7, 3.5))


def _draw_density(axes: Axes, diagram: Diagram, colour: str, scale: float) -> None:
    """What the dots of `_draw_points` would cover, the darker the more of them there are."""
    shown = diagram.shown
    window = Window(*axes.get_xlim(), *axes.get_ylim())
    log = axes.get_xscale() == "log"
    flights = diagram.flight_time[shown]
    counts = density(diagram.values, np.count_nonzero(shown, axis=1), flights, window, *COLUMNS_AND_ROWS, log)
    counts = _widened(counts, round(_dot(diagram) * scale * DPI / 72))
    shades = np.log(np.maximum(counts, 1)) / np.log(np.clip(counts.max(), 2, OPAQUE))
    image = np.empty((*counts.shape, 4))
    image[..., :3] = to_rgb(colour)
    image[..., 3] = np.where(counts > 0, np.minimum(FAINTEST + (1 - FAINTEST) * shades, 1.0), 0.0)
    # Over all of the axes, whatever their scale.
    sheet = axes.inset_axes((0.0, 0.0, 1.0, 1.0), zorder=3)
    sheet.set_axis_off()
    sheet.imshow(image, origin="lower", aspect="auto", interpolation="nearest")
    size = 2 * _dot(diagram) * scale
    axes.plot([], [], ".", markersize=size, markeredgewidth=0, color=colour, label=diagram.direction)


def _widened(counts: NDArray[np.int64], width: int) -> NDArray[np.int64]:
    """Every count spread over a square of so many parts; the highest wins."""
    back = (width - 1) // 2
    for axis in (0, 1):
        spread = counts
        for shift in range(-back, width - back):
            moved = np.roll(counts, shift, axis)
            edge = slice(0, shift) if shift > 0 else slice(counts.shape[axis] + shift, None)
            moved[(edge, slice(None)) if axis == 0 else (slice(None), edge)] = 0
            spread = np.maximum(spread, moved)
        counts = spread
    return counts


def _highest(diagram: Diagram) -> float:
    """The longest flight shown, in rad; a turn if there is none."""
    return float(np.max(diagram.flight_time, where=diagram.shown, initial=0.0)) or TURN


def _scale(axes: Axes, values: NDArray[np.float64], highest: float) -> None:
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


def _draw_turns(axes: Axes) -> None:
    """Whole plate periods as faint lines, counted on the right."""
    _, top = axes.get_ylim()
    turns = np.arange(1, int(top / TURN) + 1)
    step = max(1, len(turns) // 8)
    right = axes.secondary_yaxis("right")
    right.set_yticks(turns[::step] * TURN, [_turns(int(turn)) for turn in turns[::step]])
    right.tick_params(labelsize=9, length=0, labelcolor="0.45")
    for label in right.get_yticklabels():
        label.set_math_fontfamily("stix")
    for turn in turns[::step]:
        axes.axhline(turn * TURN, color="0.85", linewidth=0.6, zorder=1)


def _turns(turns: int) -> str:
    return rf"${2 * turns}\pi$"


def _draw_threshold(axes: Axes, diagram: Diagram) -> None:
    """Γ_th of Eq. 25, where a spring at rest begins to bounce."""
    onset = float(threshold(diagram.fixed["omega"], diagram.fixed["xi"]))
    if diagram.values[0] <= onset <= diagram.values[-1]:
        axes.axvline(onset, color="#2166ac", linewidth=0.8, linestyle=(0, (4, 3)), zorder=2)
        axes.annotate(
            r"$\Gamma_{\mathrm{th}}$",
            (onset, 1),
            (3, -4),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            verticalalignment="top",
            color="#2166ac",
            fontsize=10,
            math_fontfamily="stix",
        )


def _describe(axes: Axes, diagram: Diagram, spec: SweepSpec) -> None:
    axes.set_xlabel(SYMBOLS[diagram.along], fontsize=12, **TEXT)
    axes.set_ylabel(r"flight time $\varphi$  (rad)", fontsize=12, **TEXT)
    fixed = ",   ".join(f"{SYMBOLS[axis]} = {value:.6g}" for axis, value in diagram.fixed.items())
    axes.set_title(fixed, loc="left", fontsize=11, **TEXT)
    axes.set_title(_how(diagram, spec), loc="right", fontsize=8.5, color="0.35", **TEXT)
    axes.tick_params(which="both", direction="in", top=True, labelfontfamily=FONT, labelsize=10)


def _how(diagram: Diagram, spec: SweepSpec) -> str:
    """How the cells were computed, in a few words."""
    start = "from rest" if spec.ramp_axis is None else f"ramped along {SYMBOLS[spec.ramp_axis]}"
    least = f", flights of at least {diagram.min_flight:g} rad" if diagram.min_flight else ""
    thinned = f", 1 cell in {diagram.every:,}" if diagram.every > 1 else ""
    lost = int(np.count_nonzero(np.isin(diagram.outcome, (Outcome.UNRESOLVED, Outcome.DIVERGED))))
    unresolved = f", {lost:,} of {len(diagram.values):,} cells unresolved" if lost else ""
    return f"{spec.model.kind} contact, {start}{least}{thinned}{unresolved}"


def _legend(axes: Axes) -> None:
    legend = axes.legend(
        loc="upper left",
        frameon=False,
        markerscale=3,
        handletextpad=0.2,
        prop={"family": FONT, "size": 10},
    )
    legend.set_zorder(4)


def _warn(axes: Axes, missing: int, cells: int) -> None:
    if missing:
        axes.annotate(
            f"incomplete: {missing:,} of {cells:,} cells are not computed yet",
            (0.5, 0.5),
            xycoords="axes fraction",
            ha="center",
            color="#b2182b",
            fontsize=11,
            fontfamily=FONT,
            bbox={"facecolor": "white", "edgecolor": "#b2182b", "linewidth": 0.6, "alpha": 0.9, "pad": 5},
            zorder=5,
        )
