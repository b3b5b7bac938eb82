"""What the service's pictures share: letters, symbols, colours, resolution, and how a figure becomes a file.

The figures of the paper (`service.figures`) keep a style of their own: they are drawn for a printed column
in a process that has only the client, which must not import the service.
"""

import io
from collections.abc import Callable
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

#: Draws all pictures: matplotlib's settings belong to the process, its open font files to the thread.
_THREAD: Final = ThreadPoolExecutor(1, thread_name_prefix="pictures")


def encode(size: tuple[float, float], draw: Callable[[Figure], None], format: PictureFormat) -> bytes:
    """The bytes of a png or svg that `draw` draws, the same for the same drawing; `size` is in inches."""
    return _THREAD.submit(_encode, size, draw, format).result()


def _encode(size: tuple[float, float], draw: Callable[[Figure], None], format: PictureFormat) -> bytes:
    with mpl.rc_context({"svg.hashsalt": "bouncing-spring"}):
        figure = Figure(figsize=size, dpi=DPI, layout="constrained")
        draw(figure)
        file = io.BytesIO()
        figure.savefig(file, format=format, metadata={"Date": None} if format == "svg" else {})
    return file.getvalue()
