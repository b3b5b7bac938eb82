"""The work-precision picture: what a plate period costs against how far the flight times are off."""

import io
import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D

from service.render.bifurcation import FONT, TEXT, drawing
from worker.analysis.work_precision import Measured


class Series(NamedTuple):
    """Rows that make one line of the picture."""

    label: str
    colour: str
    marker: str
    ink: str  # of its words: dark enough to be read


#: Colours that colour-blind eyes tell apart (Okabe and Ito's); shapes that a photocopier keeps.
SERIES: Final = {
    "soft": Series("soft, exact", "#0072b2", "o", "#005a8e"),
    "verlet": Series("stepped, Verlet", "#d55e00", "s", "#a84a00"),
    "euler": Series("stepped, Euler", "#e69f00", "^", "#8a5f00"),
    "rigid": Series("rigid", "black", "D", "black"),
    "ball": Series(r"ball, $\varepsilon = f(\xi)$", "#009e73", "*", "#00704f"),
}
TITLES: Final = {
    "contact": "this contact is meant: $d = 10^{-3}$, $e = 0.01$",
    "plate": "a hard plate is meant: $d, e \\to 0$",
}
MOST_STEPS: Final = 100  # the one of a row that says more
ERRORS: Final = (3e-8, 30.0)
COSTS: Final = (0.02, 2e3)


def draw(rows: Sequence[Measured], format: str) -> bytes:
    """The bytes of a png or svg: one panel for each purpose."""
    with drawing, mpl.rc_context({"svg.hashsalt": "bouncing-spring"}):  # the same picture is the same file
        figure = Figure(figsize=(9.2, 4.4), dpi=200, layout="constrained")
        panels = figure.subplots(1, 2, sharey=True)
        for axes, purpose in zip(panels, TITLES, strict=True):
            _panel(axes, purpose, [row for row in rows if row.purpose == purpose])
        panels[0].set_ylabel("core-µs a cell and plate period", fontsize=11, **TEXT)
        _legend(panels[0])
        file = io.BytesIO()
        figure.savefig(file, format=format, metadata={"Date": None} if format == "svg" else {})
    return file.getvalue()


def _panel(axes: Axes, purpose: str, rows: list[Measured]) -> None:
    axes.set(xscale="log", yscale="log", xlim=ERRORS, ylim=COSTS)
    axes.grid(color="0.92", linewidth=0.6)
    axes.set_axisbelow(True)
    for name, series in SERIES.items():
        mine = [row for row in rows if _series(row) == name]
        for depth in {row.penetration for row in mine} if name in ("verlet", "euler") else {None}:
            _line(axes, series, [row for row in mine if depth in (None, row.penetration)])
    axes.set_title(TITLES[purpose], loc="left", fontsize=11, **TEXT)
    axes.set_xlabel("error of flight times (rad): median, and to the 95th percentile", fontsize=10, **TEXT)
    axes.text(0.985, 0.975, "nearer and cheaper: down and left", transform=axes.transAxes, fontsize=9,
              color="0.35", ha="right", va="top", **TEXT)  # fmt: skip
    axes.tick_params(which="both", direction="in", top=True, right=True, labelfontfamily=FONT, labelsize=9)


def _series(row: Measured) -> str:
    return row.scheme or row.model


def _line(axes: Axes, series: Series, rows: list[Measured]) -> None:
    points = [(row, row.error, row.cost) for row in rows if row.error is not None and row.cost is not None]
    joined = [(error, cost) for row, error, cost in points if error and row.model != "ball"]
    if joined:
        axes.plot(*zip(*joined, strict=True), color=series.colour, linewidth=1)
    for row, error, cost in points:
        if error:
            _point(axes, series, row, error, cost)
        else:
            _reference(axes, series, cost)


def _reference(axes: Axes, series: Series, cost: float) -> None:
    """The exact contact itself has no error: a line across."""
    axes.axhline(cost, color=series.colour, linewidth=1, linestyle=(0, (4, 2)))
    axes.annotate(f"exact soft, the reference: {cost:.2g} µs", (ERRORS[0] * 1.5, cost), (0, 4),
                  textcoords="offset points", color=series.ink, fontsize=9, **TEXT)  # fmt: skip


def _point(axes: Axes, series: Series, row: Measured, error: float, cost: float) -> None:
    most = row.error_95 if row.error_95 is not None else ERRORS[1]
    axes.plot([error, most], [cost, cost], color=series.colour, linewidth=0.8, alpha=0.45)
    axes.plot([error], [cost], color=series.colour, marker=series.marker, linestyle="none",
              markersize=10 if series.marker == "*" else 5.5, markeredgewidth=0)  # fmt: skip
    text, place = _words(row)
    axes.annotate(text, (error, cost), place, textcoords="offset points", fontsize=9, color=series.ink,
                  ha="right" if place[0] < 0 else "center", **TEXT)  # fmt: skip


def _words(row: Measured) -> tuple[str, tuple[int, int]]:
    """What stands beside a point, and where in points from it."""
    if row.model == "ball":
        return "where the dashpot locks" if row.locked_only else "everywhere", (0, 8)
    depth = f"$d = 10^{{{math.log10(row.penetration or 1.0):.0f}}}$"
    if row.model == "soft":
        return depth, (0, -13)
    if row.scheme == "verlet":
        which = f"{depth}, " if row.steps_per_contact == MOST_STEPS else ""
        return f"{which}{row.steps_per_contact}", (-6, -3)
    if row.scheme == "euler":
        return str(row.steps_per_contact), (10, 5)
    return "", (0, 0)


def _legend(axes: Axes) -> None:
    handles = [
        Line2D([], [], color=one.colour, marker=one.marker, label=one.label, linewidth=1, markeredgewidth=0,
               markersize=8 if one.marker == "*" else 5)
        for one in SERIES.values()
    ]  # fmt: skip
    given: dict[str, Any] = {"frameon": True, "framealpha": 0.9, "edgecolor": "0.8"}
    font = FontProperties(family=FONT, size=9, math_fontfamily="stix")
    handles.append(Line2D([], [], linestyle="none", label="(numbers: steps a contact)"))
    handles.insert(3, handles.pop())
    axes.legend(handles=handles, loc="lower left", prop=font, **given)
