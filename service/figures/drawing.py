"""Captions and claims of the figures, and the picture with its caption below.

Figures have the style of the views' pictures.
"""

import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from os import PathLike
from pathlib import Path
from textwrap import wrap
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib.figure import Figure, SubFigure
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from service.pictures import DPI
from service.software import software
from service.views import encode

#: Inches, and points. Printed in a column of 3.4 in, the smallest letters are 4.5 points high.
WIDTH: Final = 6.8
CAPTION_SIZE: Final = 10.0
LINE_HEIGHT: Final = 1.3 * CAPTION_SIZE / 72  # inches
LETTERS: Final = 112  # of a line of the caption
MARGIN: Final = 0.08  # inches
COLOURS: Final = 96  # of the palette of a PNG

#: Spaces at which no line breaks: in formulas, quantities and modes such as `Γ = 2`, `10⁻³ A` and `(1, 2)`.
_UNBREAKABLE: Final = re.compile(
    r"(?<=[=≈]) | (?=[=≈])|(?<=\d) (?=[A%]|rad)|(?<=[⁻³⁶]) (?=A)|(?<=\(\d,) (?=\d)"
)
#: Superscripts, which the font lacks.
_RAISED: Final = re.compile("[⁺⁻³⁴⁵⁶]+")
_PLAIN: Final = str.maketrans("⁺⁻³⁴⁵⁶", "+-3456")


class Verdict(StrEnum):
    """How a result compares with the paper; the value is the label in a caption."""

    AGREES = "Agrees"  # the paper says the same
    CONTRADICTS = "Contradicts"  # the paper says otherwise
    LEFT_OPEN = "Left open by the paper"  # the paper does not say


class Claim(NamedTuple):
    """A statement on a result."""

    verdict: Verdict
    text: str


def compared(holds: bool | np.bool_, text: str) -> Claim:
    """A claim on a statement of the paper; `holds`: whether the result agrees."""
    return Claim(Verdict.AGREES if holds else Verdict.CONTRADICTS, text)


def left_open(text: str) -> Claim:
    """A claim on a question that the paper leaves open."""
    return Claim(Verdict.LEFT_OPEN, text)


@dataclass(frozen=True)
class Caption:
    """The text under a figure; `shows` describes what is drawn and how it was computed."""

    number: int
    shows: str
    claims: tuple[Claim, ...]

    @property
    def paragraphs(self) -> list[tuple[str, str]]:
        """Headings and texts: what is shown, then the claims of each verdict, if there are any."""
        paragraphs = [(f"Fig. {self.number}.", self.shows)]
        for verdict in Verdict:
            if texts := [claim.text for claim in self.claims if claim.verdict is verdict]:
                paragraphs.append((f"{verdict}:", f"{'; '.join(texts)}."))
        return paragraphs

    def __str__(self) -> str:
        return "\n".join(f"{heading} {text}" for heading, text in self.paragraphs)

    @property
    def lines(self) -> list[str]:
        """The caption in lines of LETTERS, headings in bold, as matplotlib draws them."""
        lines = []
        for heading, text in self.paragraphs:
            unbroken = _UNBREAKABLE.sub("\N{NO-BREAK SPACE}", f"{heading} {text}")
            first, *rest = wrap(unbroken, LETTERS, break_on_hyphens=False)
            bold, mark = heading[:-1].replace(" ", "~"), heading[-1]
            lines += [rf"$\mathbf{{{bold}}}${mark} {first.removeprefix(heading)}", *rest]
        raised = (_RAISED.sub(lambda match: f"$^{{{match[0].translate(_PLAIN)}}}$", line) for line in lines)
        return [line.replace("Γ_th", r"$\Gamma_{\mathrm{th}}$") for line in raised]


class Drawing(NamedTuple):
    """A figure `height` inches high that `draw` draws above its caption."""

    caption: Caption
    height: float
    draw: Callable[[SubFigure], None]

    def compose(self, figure: Figure) -> None:
        """Draw the figure and its caption."""
        lines = self.caption.lines
        below = LINE_HEIGHT * len(lines) + 2 * MARGIN
        figure.set_size_inches(WIDTH, self.height + below)
        areas: Any = figure.subfigures(2, 1, height_ratios=(self.height, below))
        self.draw(areas[0])
        areas[1].text(
            MARGIN / WIDTH, 1 - MARGIN / below, "\n".join(lines), fontsize=CAPTION_SIZE, va="top",
            linespacing=1.3, in_layout=False,
        )  # fmt: skip

    def save(self, path: str | PathLike[str]) -> None:
        """Write the figure to a file, .png, .svg or .pdf."""
        Path(path).write_bytes(self.encoded(Path(path).suffix.removeprefix(".")))

    def encoded(self, format: str) -> bytes:
        """The bytes of a file, with the caption in its metadata; a palette makes a PNG a third as large."""
        origin = {"release": software().release, "caption": str(self.caption)}
        content = encode.picture((WIDTH, self.height), self.compose, format, origin)
        if format != "png":
            return content
        image, described, file = Image.open(io.BytesIO(content)), PngInfo(), io.BytesIO()
        described.add_itxt("Description", str(self.caption))
        reduced = image.convert("RGB").quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        reduced.save(file, "png", optimize=True, dpi=(DPI, DPI), pnginfo=described)
        return file.getvalue()


def named(bounces: int, periods: int) -> str:
    """A mode in the notation of the paper."""
    return f"({bounces}, {periods})"


def percent(share: float, digits: int = 0) -> str:
    """A share as a quantity with its unit: `86 %`."""
    return f"{100 * share:.{digits}f} %"
