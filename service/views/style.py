"""What the files of pictures share: letters, and how a figure becomes a file.

Does not import matplotlib, which only a process that draws loads.
"""

import io
import json
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Final

from service.pictures import DPI

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

#: Settings of matplotlib. Text is text in an SVG, and embedded as a font in a PDF.
STYLE: Final[dict[Any, Any]] = {
    "font.family": "STIXGeneral", "mathtext.fontset": "stix",
    "xtick.direction": "in", "ytick.direction": "in", "xtick.top": True,
    "svg.hashsalt": "bouncing-spring", "svg.fonttype": "none", "pdf.fonttype": 42,
}  # fmt: skip
FONT: Final = "STIXGeneral"
TEXT: Final[dict[str, Any]] = {"fontfamily": FONT, "math_fontfamily": "stix"}

#: Draws all pictures: matplotlib's settings belong to the process, its open font files to the thread.
_THREAD: Final = ThreadPoolExecutor(1, thread_name_prefix="pictures")


#: What a picture was made from, by name: job, specification, versions.
Origin = Mapping[str, str]


def legend_beside(axes: "Axes", entries: "list[Patch]") -> None:
    """A legend on the right of the axes."""
    axes.legend(
        handles=entries, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, frameon=False
    )


def encode(size: tuple[float, float], draw: "Callable[[Figure], None]", format: str, origin: Origin) -> bytes:
    """The bytes of a picture that `draw` draws, the same for the same drawing; `size` is in inches.

    `origin` is in the file's metadata.
    """
    return _THREAD.submit(_encode, size, draw, format, origin).result()


def _encode(
    size: tuple[float, float], draw: "Callable[[Figure], None]", format: str, origin: Origin
) -> bytes:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=size, dpi=DPI, layout="constrained")
        draw(figure)
        file = io.BytesIO()
        figure.savefig(file, format=format, metadata=_metadata(format, origin))
    return file.getvalue()


def _metadata(format: str, origin: Origin) -> dict[str, str | None]:
    """The origin under the names that the format has for it, without the time of drawing."""
    program = f"bouncing-spring {origin['release']}"
    described = json.dumps(dict(origin), ensure_ascii=False)
    if format == "png":
        return {"Software": program, "Description": described}
    if format == "svg":
        return {"Creator": program, "Description": described, "Date": None}
    return {"Creator": program, "Subject": described, "CreationDate": None}
