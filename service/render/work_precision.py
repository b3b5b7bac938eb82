"""The work-precision diagram: cost of a plate period against the error of flight times."""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D

from service.formats import PictureFormat
from service.render.point_labels import PointLabel, place
from service.render.style import FONT, TEXT, encode
from service.software import software
from worker.analysis.work_precision import Measurement


class Series(NamedTuple):
    """How the rows of one model or scheme are drawn."""

    label: str
    colour: str
    marker: str
    text_colour: str  # a darker shade, for contrast with the white ground


#: Colours that colour-blind readers can tell apart (Okabe and Ito's), and markers for a photocopy.
SERIES: Final = {
    "soft": Series("soft, exact", "#0072b2", "o", "#005a8e"),
    "verlet": Series("stepped, Verlet", "#d55e00", "s", "#a84a00"),
    "euler": Series("stepped, Euler", "#e69f00", "^", "#8a5f00"),
    "rigid": Series("rigid", "black", "D", "black"),
    "ball": Series(r"ball, $\varepsilon = f(\xi)$", "#009e73", "*", "#00704f"),
}
TITLES: Final = {
    "adhesive": "studies of this contact, adhesive: $d = 10^{-3}$, $e = 0.01$",
    "nonadhesive": "the same, nonadhesive",
    "plate": "studies of a hard plate: $d, e \\to 0$",
}
SIZE: Final = (13.2, 4.4)  # inches
#: Bytes of memory that drawing takes at most.
MEMORY: Final = 48 * 2**20
MOST_STEPS: Final = 100  # the point of a Verlet series that is labelled with its depth
#: Limits of the axes: rad, core-µs per cell per plate period.
ERRORS: Final = (1e-14, 100.0)
COSTS: Final = (0.02, 1e4)


def draw(rows: Sequence[Measurement], format: PictureFormat) -> bytes:
    """The bytes of a picture: one panel for each purpose, hollow markers for the nonadhesive law."""
    return encode(SIZE, lambda figure: compose(figure, rows), format, {"release": software().release})


def compose(figure: Figure, rows: Sequence[Measurement]) -> None:
    """Draw the panels on a figure of SIZE, each label where it covers no other label and no marker."""
    axes = figure.subplots(1, len(TITLES), sharey=True)
    points = [
        _panel(panel, purpose, [row for row in rows if row.purpose == purpose])
        for panel, purpose in zip(axes, TITLES, strict=True)
    ]
    axes[0].set_ylabel("core-µs per cell per plate period", fontsize=11, **TEXT)
    _legend(axes[0])
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # the panels stay where they were when the labels were placed
    for panel, labelled in zip(axes, points, strict=True):
        place(panel, labelled)


def _panel(axes: Axes, purpose: str, rows: list[Measurement]) -> list[PointLabel]:
    """Everything but the labels of the points; the points."""
    points: list[PointLabel] = []
    axes.set(xscale="log", yscale="log", xlim=ERRORS, ylim=COSTS)
    axes.grid(color="0.92", linewidth=0.6)
    axes.set_axisbelow(True)
    for name, series in SERIES.items():
        lines: dict[object, list[Measurement]] = {}
        for row in (row for row in rows if (row.scheme or row.model) == name):
            # a line joins the numbers of steps in one contact, or the depths under one law
            lines.setdefault((row.adhesive, row.penetration if row.scheme else None), []).append(row)
        for line in lines.values():
            points += _line(axes, series, line)
    axes.set_title(TITLES[purpose], loc="left", fontsize=11, **TEXT)
    axes.set_xlabel("error of flight times (rad): median, and to the 95th percentile", fontsize=10, **TEXT)
    axes.text(0.985, 0.975, "better: down and to the left", transform=axes.transAxes, fontsize=9,
              color="0.35", ha="right", va="top", **TEXT)  # fmt: skip
    axes.tick_params(which="both", direction="in", top=True, right=True, labelfontfamily=FONT, labelsize=9)
    return points


def _line(axes: Axes, series: Series, rows: list[Measurement]) -> list[PointLabel]:
    points = [(row, row.error, row.cost) for row in rows if row.error is not None and row.cost is not None]
    joined = [(error, cost) for row, error, cost in points if error and row.model != "ball"]
    if joined:
        axes.plot(*zip(*joined, strict=True), color=series.colour, linewidth=1)
    depths = sorted(row.penetration or 1.0 for row, error, _ in points if error)
    drawn = []
    for row, error, cost in points:
        if error:
            drawn.append(_point(axes, series, row, error, cost))
            # of the depths under one law the ends are labelled: the points between them lie too close
            if row.model != "soft" or row.penetration in (depths[0], depths[-1]):
                drawn[-1] = drawn[-1]._replace(text=_label(row))
        else:
            _reference(axes, series, cost)
    return drawn


def _reference(axes: Axes, series: Series, cost: float) -> None:
    """The reference has no error: a line across the panel."""
    axes.axhline(cost, color=series.colour, linewidth=1, linestyle=(0, (4, 2)))
    axes.annotate(f"exact soft, the reference: {cost:.2g} µs", (ERRORS[1] / 1.5, cost), (0, 4),
                  textcoords="offset points", color=series.text_colour, fontsize=9, ha="right",
                  **TEXT)  # fmt: skip


def _point(axes: Axes, series: Series, row: Measurement, error: float, cost: float) -> PointLabel:
    percentile = row.error_95 if row.error_95 is not None else ERRORS[1]
    axes.plot([error, percentile], [cost, cost], color=series.colour, linewidth=0.8, alpha=0.45)
    hollow = row.adhesive is False
    axes.plot([error], [cost], color=series.colour, marker=series.marker, linestyle="none",
              markersize=10 if series.marker == "*" else 5.5, markeredgewidth=1.2 if hollow else 0,
              markerfacecolor="white" if hollow else series.colour)  # fmt: skip
    return PointLabel(error, cost, "", series.text_colour)


def _label(row: Measurement) -> str:
    """The label of a point."""
    if row.model == "ball":
        return "where the dashpot locks" if row.locked_only else "everywhere"
    depth = f"$d = 10^{{{math.log10(row.penetration or 1.0):.0f}}}$"
    if row.model == "soft":
        return depth
    if row.scheme is None:
        return ""
    with_depth = row.scheme == "verlet" and row.steps_per_contact == MOST_STEPS
    return f"{depth}, {row.steps_per_contact}" if with_depth else str(row.steps_per_contact)


def _legend(axes: Axes) -> None:
    handles = [
        Line2D([], [], color=series.colour, marker=series.marker, label=series.label, linewidth=1,
               markeredgewidth=0, markersize=8 if series.marker == "*" else 5)
        for series in SERIES.values()
    ]  # fmt: skip
    steps = Line2D([], [], linestyle="none", label="(numbers: steps per contact)")
    handles.insert(list(SERIES).index("euler") + 1, steps)
    handles.append(Line2D([], [], linestyle="none", label="(hollow markers: nonadhesive)"))
    font = FontProperties(family=FONT, size=9, math_fontfamily="stix")
    axes.legend(handles=handles, loc="lower left", prop=font, frameon=True, framealpha=0.9, edgecolor="0.8")
