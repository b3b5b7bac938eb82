"""The work-precision diagram: cost of a plate period against the error of flight times."""

import math
from collections.abc import Sequence
from itertools import product
from typing import Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

from service.formats import PictureFormat
from service.software import software
from service.views.style import FONT, TEXT, encode
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
    "euler": Series("stepped, Euler\n(numbers: steps per contact)", "#e69f00", "^", "#8a5f00"),
    "rigid": Series("rigid", "black", "D", "black"),
    "ball": Series(
        "ball, $\\varepsilon = f(\\xi)$\n(hollow markers: nonadhesive)", "#009e73", "*", "#00704f"
    ),
}
TITLES: Final = {
    "adhesive": "studies of this contact, adhesive: $d = 10^{-3}$, $e = 0.01$",
    "nonadhesive": "the same, nonadhesive",
    "plate": "studies of a hard plate: $d, e \\to 0$",
}
SIZE: Final = (13.2, 4.4)  # inches
MOST_STEPS: Final = 100  # the point of a Verlet series that is labelled with its depth
#: Limits of the axes: rad, core-µs per cell per plate period.
ERRORS: Final = (1e-14, 100.0)
COSTS: Final = (0.02, 1e4)
#: Where labels may stand: distances from their points, in points of text, and directions.
DISTANCES: Final = (1.0, 3.0, 6.0, 11.0, 18.0, 26.0)
ANGLES: Final = np.pi / 4 + np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)


def draw(rows: Sequence[Measurement], format: PictureFormat) -> bytes:
    """The bytes of a picture: one panel for each purpose, hollow markers for the nonadhesive law."""
    return encode(SIZE, lambda figure: compose(figure, rows), format, {"release": software().release})


def compose(figure: Figure, rows: Sequence[Measurement]) -> None:
    """Draw the panels on a figure of SIZE."""
    panels = figure.subplots(1, len(TITLES), sharey=True)
    labelled = [
        [label for name in SERIES for label in _series(axes, name, rows, purpose)]
        for axes, purpose in zip(panels, TITLES, strict=True)
    ]
    for axes, title in zip(panels, TITLES.values(), strict=True):
        axes.set(xscale="log", yscale="log", xlim=ERRORS, ylim=COSTS)
        axes.grid(color="0.92", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.set_title(title, loc="left", fontsize=11, **TEXT)
        axes.set_xlabel(
            "error of flight times (rad): median, and to the 95th percentile", fontsize=10, **TEXT
        )
        axes.text(0.985, 0.975, "better: down and to the left", transform=axes.transAxes, fontsize=9,
                  color="0.35", ha="right", va="top", **TEXT)  # fmt: skip
        axes.tick_params(
            which="both", direction="in", top=True, right=True, labelfontfamily=FONT, labelsize=9
        )
    panels[0].set_ylabel("core-µs per cell per plate period", fontsize=11, **TEXT)
    handles = [
        Line2D([], [], color=series.colour, marker=series.marker, label=series.label, linewidth=1)
        for series in SERIES.values()
    ]
    font = FontProperties(family=FONT, size=9, math_fontfamily="stix")
    panels[0].legend(handles=handles, loc="lower left", prop=font, framealpha=0.9, edgecolor="0.8")
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # the panels stay where they were when the labels are placed
    for axes, labels in zip(panels, labelled, strict=True):
        _place(axes, labels)


def _series(axes: Axes, name: str, rows: Sequence[Measurement], purpose: str) -> list[Annotation]:
    """Draw the points of one model or scheme, joined over the steps or the depths; returns their labels."""
    lines: dict[object, list[Measurement]] = {}
    for row in rows:
        if row.purpose == purpose and (row.scheme or row.model) == name:
            lines.setdefault((row.adhesive, row.penetration if row.scheme else None), []).append(row)
    return [label for line in lines.values() for label in _line(axes, SERIES[name], line)]


def _line(axes: Axes, series: Series, rows: list[Measurement]) -> list[Annotation]:
    measured = [(row, row.error, row.cost) for row in rows if row.error is not None and row.cost is not None]
    points = [(row, error, cost) for row, error, cost in measured if error]
    for _, _, cost in (each for each in measured if not each[1]):  # the reference: a line across the panel
        axes.axhline(cost, color=series.colour, linewidth=1, linestyle=(0, (4, 2)))
        axes.annotate(f"exact soft, the reference: {cost:.2g} µs", (ERRORS[1] / 1.5, cost), (0, 4),
                      textcoords="offset points", color=series.text_colour, fontsize=9, ha="right",
                      **TEXT)  # fmt: skip
    if points and rows[0].model != "ball":
        axes.plot(*zip(*(each[1:] for each in points), strict=True), color=series.colour, linewidth=1)
    labels = []
    for i, (row, error, cost) in enumerate(points):
        hollow = row.adhesive is False
        percentile = row.error_95 if row.error_95 is not None else ERRORS[1]
        axes.plot([error, percentile], [cost, cost], color=series.colour, linewidth=0.8, alpha=0.45)
        axes.plot([error], [cost], color=series.colour, marker=series.marker, linestyle="none",
                  markersize=10 if series.marker == "*" else 5.5, markeredgewidth=1.2 if hollow else 0,
                  markerfacecolor="white" if hollow else series.colour)  # fmt: skip
        # of the depths under one law the ends are labelled: the points between them lie too close
        text = "" if row.model == "soft" and 0 < i < len(points) - 1 else _label(row)
        labels.append(axes.annotate(text, (error, cost), (0, 0), textcoords="offset points", fontsize=9,
                                    color=series.text_colour, ha="center", va="center", **TEXT))  # fmt: skip
    return labels


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


def _place(axes: Axes, labels: list[Annotation]) -> None:
    """Move each label to the nearest place where it covers no marker and no other text."""
    figure = axes.figure
    pixel = figure.dpi / 72
    centres = axes.transData.transform([label.xy for label in labels])
    taken = [Bbox.from_bounds(x - 4.5 * pixel, y - 4.5 * pixel, 9 * pixel, 9 * pixel) for x, y in centres]
    taken += [text.get_window_extent() for text in axes.texts if text not in labels]
    if (legend := axes.get_legend()) is not None:
        taken.append(legend.get_window_extent())
    for label, centre in zip(labels, centres, strict=True):
        size = label.get_window_extent()
        half = np.array([size.width, size.height]) / 2
        for distance, angle in product(DISTANCES, ANGLES):
            direction = np.array([math.cos(angle), math.sin(angle)])
            reach = np.min((half + (4.5 + distance) * pixel) / np.maximum(np.abs(direction), 1e-9))
            box = Bbox([centre + reach * direction - half, centre + reach * direction + half])
            inside = axes.bbox.x0 < box.x0 and box.x1 < axes.bbox.x1
            if label.get_text() and inside and not any(box.overlaps(other) for other in taken):
                label.set_position(reach * direction / pixel)
                taken.append(box)
                break
