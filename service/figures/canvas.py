"""Paper: how wide, which letters, which colours; the caption under a picture; the picture as a file."""

import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, wraps
from typing import Any, Final, ParamSpec, TypeVar

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

#: Inches; printed a column (3.4 in) wide, the smallest letters are still 5.5 points high.
WIDTH: Final = 4.6
DPI: Final = 216
COLOURS: Final = 96
CAPTION_SIZE: Final = 7.5  # points
LINE: Final = 1.32 * CAPTION_SIZE / 72  # inches
ASCENT: Final = 0.76  # of a line's height
SPACE: Final = 0.33 * CAPTION_SIZE / 72  # inches between words, a little more than there is
MARGIN: Final = 0.06  # inches, on all sides

#: Colours that colour-blind eyes and photocopiers tell apart (Okabe and Ito's).
BLUE, ORANGE, GREEN, RED = "#0072b2", "#e69f00", "#009e73", "#d55e00"
GREY: Final = "0.55"
TURN: Final = 2 * np.pi

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
    "svg.hashsalt": "bouncing-spring",  # the same picture is the same file
}

_RAISED: Final = re.compile("[⁺⁻³⁴⁶]+")
_TOGETHER: Final = re.compile(r"(?<=[=≈]) | (?=[=≈])|(?<=\d) (?=[A%])|(?<=[⁻³⁶]) (?=A)|(?<=\d) (?=rad)")
_LOWERED: Final = str.maketrans("⁺⁻³⁴⁶", "+-346")

P = ParamSpec("P")
T = TypeVar("T")


def styled(draw: Callable[P, T]) -> Callable[P, T]:
    """A function that draws in the style of all figures."""

    @wraps(draw)
    def inside(*args: P.args, **kwargs: P.kwargs) -> T:
        with mpl.rc_context(STYLE):
            return draw(*args, **kwargs)

    return inside


@dataclass(frozen=True)
class Drawing:
    """A finished figure and what stands under it."""

    figure: Figure
    caption: Caption

    def encoded(self, format: str) -> bytes:
        """The bytes of a png or svg file."""
        file = io.BytesIO()
        with mpl.rc_context(STYLE):
            self.figure.savefig(file, format=format, metadata={"Date": None} if format == "svg" else {})
        return file.getvalue() if format == "svg" else self._small(file)

    def _small(self, file: io.BytesIO) -> bytes:
        """The PNG in as few colours as a drawing has, a third of the size, the caption in it as text."""
        text, small = PngInfo(), io.BytesIO()
        text.add_itxt("Description", str(self.caption))
        colours = (
            Image.open(file)
            .convert("RGB")
            .quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        )
        colours.save(small, "png", optimize=True, dpi=(DPI, DPI), pnginfo=text)
        return small.getvalue()


def page(height: float, caption: Caption) -> tuple[Drawing, SubFigure]:
    """A page with room to draw in, `height` inches high, above the caption."""
    lines = [line for heading, text in caption.paragraphs for line in _lines(heading, text)]
    below = LINE * len(lines) + 2 * MARGIN
    figure = Figure(figsize=(WIDTH, height + below), dpi=DPI, layout="constrained")
    above, under = split(figure, height, below)
    for i, (heading, line) in enumerate(lines):
        baseline = 1 - (MARGIN + (i + ASCENT) * LINE) / below
        place: Any = {"y": baseline, "fontsize": CAPTION_SIZE, "va": "baseline", "in_layout": False}
        under.text(MARGIN / WIDTH, s=heading, fontweight="bold", **place)
        under.text((MARGIN + _indent(heading)) / WIDTH, s=line, **place)
    return Drawing(figure, caption), above


def split(figure: Figure | SubFigure, above: float, below: float) -> tuple[SubFigure, SubFigure]:
    """Two parts, one over the other, of heights in this ratio."""
    parts: Any = figure.subfigures(2, 1, height_ratios=(above, below))
    return parts[0], parts[1]


def _lines(heading: str, text: str) -> list[tuple[str, str]]:
    """The words as lines that fit the page; the heading stands before the first of them."""
    lines, line, wide = [], "", _indent(heading)
    for word in map(_typeset, _units(text)):
        wider = wide + _inches(word) + SPACE
        if line and wider > WIDTH - 3 * MARGIN:
            lines.append(line)
            line, wider = "", _inches(word) + SPACE
        line, wide = f"{line} {word}".strip(), wider
    return [(heading if not i else "", one) for i, one in enumerate([*lines, line])]


def _units(text: str) -> list[str]:
    """Words; what belongs together, `Γ = 2` or `10⁻³ A`, is one."""
    return [
        unit.replace("\N{NO-BREAK SPACE}", " ")
        for unit in _TOGETHER.sub("\N{NO-BREAK SPACE}", text).split(" ")
    ]


def _indent(heading: str) -> float:
    """Inches that a heading takes before the words after it."""
    return _inches(heading, "bold") + 1.5 * SPACE if heading else 0.0


def _typeset(word: str) -> str:
    """Mathematics where the letters have none of their own."""
    raised = _RAISED.sub(lambda found: f"$^{{{found[0].translate(_LOWERED)}}}$", word)
    return raised.replace("Γ_th", r"$\Gamma_{\mathrm{th}}$")


@lru_cache
def _inches(word: str, weight: str = "normal") -> float:
    path = TextPath((0, 0), word, prop=FontProperties(family="STIXGeneral", size=CAPTION_SIZE, weight=weight))
    return float(path.vertices[:, 0].max()) / 72


def label(axes: Axes, text: str) -> None:
    """A panel's letter and what is particular to it, above its left corner."""
    axes.set_title(text, loc="left", pad=3)


def dots(axes: Axes, diagram: xarray.Dataset, *, colour: str = "black", size: float = 1.0) -> None:
    """A bifurcation diagram: a dot for every flight, over the axis its cells lie along."""
    along = str(diagram.flight_time.dims[0])
    times = diagram.flight_time.values
    values = np.broadcast_to(diagram[along].values[:, None], times.shape)
    flown = np.isfinite(times)
    marks(axes, values[flown], times[flown], colour=colour, size=size)


def marks(axes: Axes, x: Any, y: Any, *, colour: str, size: float) -> None:
    """Small dots, an image even inside an SVG, `size` points wide."""
    axes.plot(
        x, y, linestyle="none", marker=".", markersize=2 * size, markeredgewidth=0, color=colour,
        rasterized=True, zorder=3,
    )  # fmt: skip


def flights_over(axes: Axes, low: float, high: float, top: float) -> None:
    """The scales of a bifurcation diagram: flight times in rad, whole plate periods as faint lines."""
    axes.set_xlim(low, high)
    axes.set_ylim(0, top)
    axes.set_ylabel(r"$\varphi$  (rad)")
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    minor_ticks(axes)
    turns = range(1, int(top / TURN) + 1)
    right = axes.secondary_yaxis("right")
    right.set_yticks([turn * TURN for turn in turns], [rf"${2 * turn}\pi$" for turn in turns])
    right.tick_params(length=0, labelsize=7.5, labelcolor="0.4")
    for turn in turns:
        axes.axhline(turn * TURN, color="0.85", linewidth=0.6, zorder=1)


def minor_ticks(axes: Axes) -> None:
    """Ticks between the numbered ones, on both axes."""
    axes.xaxis.set_minor_locator(AutoMinorLocator())
    axes.yaxis.set_minor_locator(AutoMinorLocator())
