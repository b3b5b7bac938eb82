"""A bifurcation diagram as a picture: dots, or density where dots would cover each other."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.ticker import AutoMinorLocator, MaxNLocator
from numpy.typing import NDArray

from kernel.labels import CHAOTIC, LABELS, QUASI_PERIODIC, UNSTABLE
from kernel.params import Outcome
from kernel.threshold import threshold
from service.formats import PictureFormat
from service.render.style import BLUE, DPI, FONT, GREY, RED, SYMBOLS, TEXT, Origin, encode
from service.results.counting import LABEL
from service.results.density import Window, density
from service.results.diagram import Diagram
from worker.spec import SweepSpec
from worker.spec.contact_models import CONTACT_MODELS

#: Inches.
SIZE: Final = (6.8, 4.2)

#: Colour and relative size of the points: of a single direction; of up, drawn larger, and of down over it,
#: so that up shows as a rim where the two agree.
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


def draw(
    diagrams: Sequence[Diagram],
    spec: SweepSpec,
    format: PictureFormat,
    origin: Origin,
    *,
    caption: bool = True,
) -> bytes:
    """A picture of flight times along the axis, the directions over each other.

    A cell at rest has no flight and so no point. The picture says how many cells are missing. `caption`: with
    the fixed values and how the cells were computed above it.
    """
    return encode(SIZE, lambda figure: _draw(figure.subplots(), diagrams, spec, caption), format, origin)


def _draw(axes: Axes, diagrams: Sequence[Diagram], spec: SweepSpec, caption: bool = True) -> None:
    first = diagrams[0]
    _scale(axes, first.values, max(_longest(diagram) for diagram in diagrams))
    for diagram, (colour, size) in zip(diagrams, ALONE if len(diagrams) == 1 else OVERLAID, strict=True):
        if np.count_nonzero(diagram.shown) > DENSE_POINTS:
            _draw_density(axes, diagram, colour, size)
        else:
            _draw_points(axes, diagram, colour, size)
    _draw_periods(axes)
    if first.along == "gamma":
        _draw_threshold(axes, first)
    _label(axes, first)
    if caption:
        _describe(axes, first, spec)
    if len(diagrams) > 1:
        _legend(axes)
    _warn(axes, diagrams)


def _draw_points(axes: Axes, diagram: Diagram, colour: str, scale: float) -> None:
    cells, flights = np.nonzero(diagram.shown)
    axes.plot(
        diagram.values[cells],
        diagram.flight_time[cells, flights],
        linestyle="none",
        marker=".",
        markersize=2 * _dot(diagram) * scale,  # the dot of marker "." is half its size wide
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
    """What the dots of `_draw_points` would cover, darker where there are more of them."""
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
    # An inset in axes coordinates, which a logarithmic axis does not distort.
    overlay = axes.inset_axes((0.0, 0.0, 1.0, 1.0), zorder=3)
    overlay.set_axis_off()
    overlay.imshow(image, origin="lower", aspect="auto", interpolation="nearest")
    size = 2 * _dot(diagram) * scale
    axes.plot([], [], ".", markersize=size, markeredgewidth=0, color=colour, label=diagram.direction)


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


def _longest(diagram: Diagram) -> float:
    """The longest flight shown, in rad; a plate period if there is none."""
    return float(np.max(diagram.flight_time, where=diagram.shown, initial=0.0)) or PERIOD


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


def _draw_periods(axes: Axes) -> None:
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


def _draw_threshold(axes: Axes, diagram: Diagram) -> None:
    """Γ_th of Eq. 25, where a spring at rest begins to bounce."""
    onset = float(threshold(diagram.fixed["omega"], diagram.fixed["xi"]))
    if diagram.values[0] <= onset <= diagram.values[-1]:
        axes.axvline(onset, color=BLUE, linewidth=0.8, linestyle=(0, (4, 3)), zorder=2)
        axes.annotate(
            r"$\Gamma_{\mathrm{th}}$",
            (onset, 1),
            (3, -4),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            verticalalignment="top",
            color=BLUE,
            fontsize=10,
            math_fontfamily="stix",
        )


def _label(axes: Axes, diagram: Diagram) -> None:
    axes.set_xlabel(SYMBOLS[diagram.along], fontsize=12, **TEXT)
    axes.set_ylabel(r"flight time $\varphi$  (rad)", fontsize=12, **TEXT)
    axes.tick_params(which="both", direction="in", top=True, labelfontfamily=FONT, labelsize=10)


def _describe(axes: Axes, diagram: Diagram, spec: SweepSpec) -> None:
    fixed = ",   ".join(f"{SYMBOLS[axis]} = {value:.6g}" for axis, value in diagram.fixed.items())
    axes.set_title(fixed, loc="left", fontsize=11, **TEXT)
    axes.set_title(_subtitle(diagram, spec), loc="right", fontsize=8.5, color="0.35", **TEXT)


def _subtitle(diagram: Diagram, spec: SweepSpec) -> str:
    """How the cells were computed and which of them are shown."""
    start = "from rest" if spec.ramp_axis is None else f"ramped along {SYMBOLS[spec.ramp_axis]}"
    flights = f", flights above {diagram.min_flight:g} rad" if diagram.min_flight else ""
    thinned = f", 1 cell in {diagram.every:,}" if diagram.every > 1 else ""
    lost = int(np.count_nonzero(np.isin(diagram.outcome, (Outcome.UNRESOLVED, Outcome.DIVERGED))))
    unresolved = f", {lost:,} of {len(diagram.values):,} cells unresolved" if lost else ""
    contact = CONTACT_MODELS[spec.model.kind].label
    return f"{contact}, {start}{flights}{thinned}{unresolved}{_told_apart(diagram)}"


def _told_apart(diagram: Diagram) -> str:
    """How many cells settle, and with exponents how many are quasi-periodic, chaotic or unstable."""
    codes = diagram.arrays.get(LABEL.name, diagram.outcome)
    counts = {
        code: int(np.count_nonzero(codes == code))
        for code in (Outcome.SETTLING, QUASI_PERIODIC, CHAOTIC, UNSTABLE)
    }
    return "".join(f", {count:,} {LABELS[code]}" for code, count in counts.items() if count)


def _legend(axes: Axes) -> None:
    legend = axes.legend(
        loc="upper left",
        frameon=False,
        markerscale=3,
        handletextpad=0.2,
        prop={"family": FONT, "size": 10},
    )
    legend.set_zorder(4)


def _warn(axes: Axes, diagrams: Sequence[Diagram]) -> None:
    missing = sum(diagram.missing for diagram in diagrams)
    cells = sum(len(diagram.values) for diagram in diagrams)
    if not all(diagram.complete for diagram in diagrams):
        reason = f"{missing:,} of {cells:,} cells are not computed yet" if missing else "being repaired"
        axes.annotate(
            f"incomplete: {reason}",
            (0.5, 0.5),
            xycoords="axes fraction",
            ha="center",
            color=RED,
            fontsize=11,
            fontfamily=FONT,
            bbox={"facecolor": "white", "edgecolor": RED, "linewidth": 0.6, "alpha": 0.9, "pad": 5},
            zorder=5,
        )
