"""What the service's pictures share: letters, symbols, colours, resolution, and how a figure becomes a file.

The figures of the paper (`service.figures`) keep a style of their own: they are drawn for a printed column
in a process that has only the client, which must not import the service.
"""

import io
import json
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import matplotlib as mpl
from matplotlib.figure import Figure

from service.formats import PictureFormat

FONT: Final = "STIXGeneral"
TEXT: Final[dict[str, Any]] = {"fontfamily": FONT, "math_fontfamily": "stix"}
SYMBOLS: Final = {"gamma": r"$\Gamma$", "omega": r"$\Omega$", "xi": r"$\xi$"}
DPI: Final = 200

#: Colours that remain distinct to colour-blind readers and on a photocopy (ColorBrewer's RdBu).
GREY, RED, BLUE = "#a6a6a6", "#b2182b", "#2166ac"

#: Colours of the attractors in order, repeated beyond (Okabe and Ito); of undecided starts.
COLOURS: Final = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#666666")
UNDECIDED: Final = "#ffffff"

#: Draws all pictures: matplotlib's settings belong to the process, its open font files to the thread.
_THREAD: Final = ThreadPoolExecutor(1, thread_name_prefix="pictures")


#: What a picture was made from, by name: job, specification, versions.
Origin = Mapping[str, str]


def encode(
    size: tuple[float, float], draw: Callable[[Figure], None], format: PictureFormat, origin: Origin
) -> bytes:
    """The bytes of a picture that `draw` draws, the same for the same drawing; `size` is in inches.

    `origin` is in the file's metadata. Text is text in an SVG, and embedded as a font in a PDF.
    """
    return _THREAD.submit(_encode, size, draw, format, origin).result()


def _encode(
    size: tuple[float, float], draw: Callable[[Figure], None], format: PictureFormat, origin: Origin
) -> bytes:
    with mpl.rc_context({"svg.hashsalt": "bouncing-spring", "svg.fonttype": "none", "pdf.fonttype": 42}):
        figure = Figure(figsize=size, dpi=DPI, layout="constrained")
        draw(figure)
        file = io.BytesIO()
        figure.savefig(file, format=format, metadata=_metadata(format, origin))
    return file.getvalue()


def _metadata(format: PictureFormat, origin: Origin) -> dict[str, str | None]:
    """The origin under the names that the format has for it, without the time of drawing."""
    program = f"bouncing-spring {origin['release']}"
    described = json.dumps(dict(origin), ensure_ascii=False)
    if format == "png":
        return {"Software": program, "Description": described}
    if format == "svg":
        return {"Creator": program, "Description": described, "Date": None}
    return {"Creator": program, "Subject": described, "CreationDate": None}
