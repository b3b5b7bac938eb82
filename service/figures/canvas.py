"""The common style of the figures: width, fonts, colours, axes, the caption, the encoded file.

The pictures that the service draws have a style of their own in `service.render`. They are made for screens,
these for a printed column with a caption; and `service.figures` may not import the service.
"""

import io
import re
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import matplotlib as mpl
import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath
from matplotlib.ticker import AutoMinorLocator, MaxNLocator
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from service.figures.caption import Caption

#: Inches. Printed in a column of 3.4 in, the smallest letters are 5.5 points high.
WIDTH: Final = 4.6
DPI: Final = 216
COLOURS: Final = 96  # of the palette of a PNG
CAPTION_SIZE: Final = 7.5  # points
LINE_HEIGHT: Final = 1.32 * CAPTION_SIZE / 72  # inches
ASCENT: Final = 0.76  # of the line height
WORD_SPACE: Final = 0.33 * CAPTION_SIZE / 72  # inches; slightly more than the font's, so that lines fit
MARGIN: Final = 0.06  # inches, on all sides

#: The palette of Okabe and Ito, distinct for colour-blind readers and in grey.
BLUE, ORANGE, GREEN, RED = "#0072b2", "#e69f00", "#009e73", "#d55e00"
GREY: Final = "0.55"
PERIOD: Final = 2 * np.pi  # rad of plate phase

STYLE: Final[Any] = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 9,
    "axes.labelsize": 10,
    "axes.titlesize": 9,
    "axes.linewidth": 0.6,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.top": True,
    "ytick.right": True,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "lines.linewidth": 1.1,
    "svg.hashsalt": "bouncing-spring",  # the same drawing gives the same bytes
}

_SUPERSCRIPTS: Final = re.compile("[⁺⁻³⁴⁵⁶]+")
_UNBREAKABLE: Final = re.compile(
    r"(?<=[=≈]) | (?=[=≈])|(?<=\d) (?=[A%])|(?<=[⁻³⁶]) (?=A)|(?<=\d) (?=rad)|(?<=\(\d,) (?=\d)"
)
_SUBSCRIPTS: Final = re.compile(r"([ΓΩ])_(\w+)")
_GREEK: Final = {"Γ": "Gamma", "Ω": "Omega"}
_PLAIN: Final = str.maketrans("⁺⁻³⁴⁵⁶", "+-3456")


def style() -> AbstractContextManager[None]:
    """The style of the figures, within a block."""
    return mpl.rc_context(STYLE)


#: Metadata without the time of drawing, by format: the same drawing gives the same bytes.
_TIMELESS: Final[dict[str, dict[str, None]]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}


@dataclass(frozen=True)
class Drawing:
    """A finished figure and its caption."""

    figure: Figure
    caption: Caption

    def encoded(self, format: str) -> bytes:
        """The bytes of a png, svg or pdf file."""
        file = io.BytesIO()
        with style():
            self.figure.savefig(file, format=format, metadata=_TIMELESS.get(format, {}))
        return self._with_palette(file) if format == "png" else file.getvalue()

    def _with_palette(self, file: io.BytesIO) -> bytes:
        """The PNG with a palette, which has a third of the size, and the caption as its Description."""
        text, reduced = PngInfo(), io.BytesIO()
        text.add_itxt("Description", str(self.caption))
        colours = (
            Image.open(file)
            .convert("RGB")
            .quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        )
        colours.save(reduced, "png", optimize=True, dpi=(DPI, DPI), pnginfo=text)
        return reduced.getvalue()


def new_drawing(height: float, caption: Caption) -> tuple[Drawing, SubFigure]:
    """An empty figure: an area `height` inches high to draw in, above the caption."""
    lines = [line for heading, text in caption.paragraphs for line in _lines(heading, text)]
    below = LINE_HEIGHT * len(lines) + 2 * MARGIN
    figure = Figure(figsize=(WIDTH, height + below), dpi=DPI, layout="constrained")
    above, under = split(figure, height, below)
    for i, (heading, line) in enumerate(lines):
        baseline = 1 - (MARGIN + (i + ASCENT) * LINE_HEIGHT) / below
        style: Any = {"y": baseline, "fontsize": CAPTION_SIZE, "va": "baseline", "in_layout": False}
        under.text(MARGIN / WIDTH, s=heading, fontweight="bold", **style)
        under.text((MARGIN + _indent(heading)) / WIDTH, s=line, **style)
    return Drawing(figure, caption), above


def split(figure: Figure | SubFigure, above: float, below: float) -> tuple[SubFigure, SubFigure]:
    """Two areas, one above the other, with heights in this ratio."""
    parts: Any = figure.subfigures(2, 1, height_ratios=(above, below))
    return parts[0], parts[1]


def _lines(heading: str, text: str) -> list[tuple[str, str]]:
    """The text in lines that fit the width; the heading precedes the first line."""
    lines, line, width = [], "", _indent(heading)
    for word in map(_with_mathtext, _unbreakable(text)):
        extended = width + _inches(word) + WORD_SPACE
        if line and extended > WIDTH - 3 * MARGIN:
            lines.append(line)
            line, extended = "", _inches(word) + WORD_SPACE
        line, width = f"{line} {word}".strip(), extended
    return [(heading if not i else "", text) for i, text in enumerate([*lines, line])]


def _unbreakable(text: str) -> list[str]:
    """Words; formulas, quantities and modes such as `Γ = 2`, `10⁻³ A` and `(1, 2)` count as one word."""
    return [
        unit.replace("\N{NO-BREAK SPACE}", " ")
        for unit in _UNBREAKABLE.sub("\N{NO-BREAK SPACE}", text).split(" ")
    ]


def _indent(heading: str) -> float:
    """Width of a heading and the space after it, in inches."""
    words = heading.split()
    return sum(_inches(word, "bold") + WORD_SPACE for word in words) + 0.9 * WORD_SPACE if words else 0.0


def _with_mathtext(word: str) -> str:
    """The word with mathtext for what the font lacks: superscripts, and subscripts of Γ and Ω."""
    raised = _SUPERSCRIPTS.sub(lambda match: f"$^{{{match[0].translate(_PLAIN)}}}$", word)
    return _SUBSCRIPTS.sub(lambda match: rf"$\{_GREEK[match[1]]}_{{\mathrm{{{match[2]}}}}}$", raised)


@lru_cache
def _inches(word: str, weight: str = "normal") -> float:
    path = TextPath((0, 0), word, prop=FontProperties(family="STIXGeneral", size=CAPTION_SIZE, weight=weight))
    return float(path.vertices[:, 0].max()) / 72


def panel_title(axes: Axes, text: str) -> None:
    """The letter and the parameters of a panel, above its left corner."""
    axes.set_title(text, loc="left", pad=3)


def plot_flights(axes: Axes, diagram: xarray.Dataset, *, colour: str = "black", markersize: float) -> None:
    """Plot a bifurcation diagram: a dot per flight over the axis of the diagram."""
    along = str(diagram.flight_time.dims[0])
    times = diagram.flight_time.values
    values = np.broadcast_to(diagram[along].values[:, None], times.shape)
    flights = np.isfinite(times)
    plot_dots(axes, values[flights], times[flights], colour=colour, markersize=markersize)


def plot_dots(axes: Axes, x: Any, y: Any, *, colour: str, markersize: float) -> None:
    """Plot dots, rasterized also in an SVG."""
    axes.plot(
        x, y, linestyle="none", marker=".", markersize=markersize, markeredgewidth=0, color=colour,
        rasterized=True, zorder=3,
    )  # fmt: skip


def flight_scales(axes: Axes, low: float, high: float, top: float) -> None:
    """Axes of a bifurcation diagram: flight times in rad, whole plate periods as faint lines."""
    axes.set_xlim(low, high)
    axes.set_ylim(0, top)
    axes.set_ylabel(r"$\varphi$  (rad)")
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    minor_ticks(axes)
    periods = range(1, int(top / PERIOD) + 1)
    right = axes.secondary_yaxis("right")
    right.set_yticks([n * PERIOD for n in periods], [rf"${2 * n}\pi$" for n in periods])
    right.tick_params(length=0, labelsize=7.5, labelcolor="0.4")
    for n in periods:
        axes.axhline(n * PERIOD, color="0.85", linewidth=0.6, zorder=1)


def minor_ticks(axes: Axes) -> None:
    """Minor ticks on both axes."""
    axes.xaxis.set_minor_locator(AutoMinorLocator())
    axes.yaxis.set_minor_locator(AutoMinorLocator())
