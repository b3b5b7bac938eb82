"""Labels of points, each at the nearest place that covers no marker and no other text.

The offsets depend on the sizes of the text alone, measured as Agg draws it: every format has the same ones.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.lines import Line2D
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from service.render.style import TEXT

#: Sizes in points: of the letters, of a marker's box, between two boxes, and of the rounds about a point.
SIZE: Final = 9
MARKER: Final = 9.0
GAP: Final = 1.0
ROUNDS: Final = (2.0, 5.0, 10.0, 16.0, 24.0, 34.0, 46.0, 60.0)
#: A label further from its point than this has a line to it.
BESIDE: Final = 10.0
DIRECTIONS: Final = 24
#: Line samples under a label that are as bad as one point of distance.
COVERED: Final = 1.5


class PointLabel(NamedTuple):
    """A point of a plot, and the text to write beside it; an empty one for a point without."""

    x: float
    y: float
    text: str
    colour: str


def place(axes: Axes, labels: Sequence[PointLabel]) -> None:
    """Write the labels beside their points, in order; one for which there is no place is left out.

    The axes must have their place in the figure, and everything else drawn on them.
    """
    figure = axes.get_figure(root=True)
    if figure is None:
        raise ValueError("the axes belong to no figure")
    renderer = RendererAgg(*figure.bbox.size, figure.dpi)  # type: ignore[no-untyped-call]
    pixel = figure.dpi / 72
    centres = axes.transData.transform([(label.x, label.y) for label in labels] or np.empty((0, 2)))
    taken = [_box(x, y, MARKER * pixel, MARKER * pixel) for x, y in centres]
    taken += [text.get_window_extent(renderer) for text in axes.texts]
    if (legend := axes.get_legend()) is not None:
        taken.append(legend.get_window_extent(renderer))
    texts: list[Bbox] = taken[len(labels) :]
    lines = np.concatenate([np.empty((0, 2)), *(_samples(axes, line, pixel) for line in axes.lines)])
    for label, centre in zip(labels, centres, strict=True):
        if label.text:
            _write(axes, label, centre, taken[: len(labels)], texts, lines, renderer)


def _write(
    axes: Axes, label: PointLabel, centre: NDArray[np.float64], markers: list[Bbox], texts: list[Bbox],
    lines: NDArray[np.float64], renderer: RendererAgg,
) -> None:  # fmt: skip
    """Write one label at the free place that is nearest and covers least of the lines; it joins `texts`."""
    pixel, panel = renderer.dpi / 72, axes.get_window_extent(renderer)
    style: dict[str, Any] = {"color": label.colour, "fontsize": SIZE, "ha": "center", "va": "center", **TEXT}
    text = axes.annotate(label.text, (label.x, label.y), (0, 0), textcoords="offset points", **style)
    extent = text.get_window_extent(renderer)
    middle = np.array([extent.x0 + extent.x1, extent.y0 + extent.y1]) / 2 - centre  # of the text
    apart = [marker for marker in markers if not marker.contains(*centre)]
    best: tuple[float, float, NDArray[np.float64], Bbox] | None = None
    for distance, offset in _offsets(extent.width / pixel, extent.height / pixel):
        x, y = centre + offset * pixel
        box = _box(x, y, extent.width, extent.height)
        if not _within(box, panel) or any(_near(box, other, GAP * pixel) for other in (*markers, *texts)):
            continue
        if distance > BESIDE and any(_crosses(centre, (x, y), other) for other in (*apart, *texts)):
            continue
        badness = distance + _covered(box, lines) / COVERED
        if best is None or badness < best[0] - 1e-9:
            best = badness, distance, offset - middle / pixel, box
    text.remove()
    if best is None:
        return
    _, distance, offset, box = best
    arrow: dict[str, Any] = {
        "arrowstyle": "-",
        "color": label.colour,
        "linewidth": 0.5,
        "alpha": 0.7,
        "shrinkA": 0,
        "shrinkB": 3,
    }
    where: dict[str, Any] = {
        "textcoords": "offset points",
        "arrowprops": arrow if distance > BESIDE else None,
    }
    axes.annotate(label.text, (label.x, label.y), (float(offset[0]), float(offset[1])), **where, **style)
    texts.append(box)


def _offsets(width: float, height: float) -> Iterator[tuple[float, NDArray[np.float64]]]:
    """Distances of a text's box from a marker's, and the offsets of its middle, in points."""
    for distance in ROUNDS:
        for i in range(DIRECTIONS):
            angle = 2.0 * math.pi * i / DIRECTIONS
            across, up = math.cos(angle), math.sin(angle)
            half = np.array([width + MARKER, height + MARKER]) / 2 + distance
            reach = min(half / np.maximum(np.abs([across, up]), 1e-9))  # to the border of the box of centres
            yield distance, np.array([across, up]) * reach


def _box(x: float, y: float, width: float, height: float) -> Bbox:
    return Bbox.from_bounds(x - width / 2, y - height / 2, width, height)


def _near(box: Bbox, other: Bbox, gap: float) -> bool:
    return bool(box.padded(gap).overlaps(other))


def _crosses(start: NDArray[np.float64], end: tuple[float, float], box: Bbox) -> bool:
    """Whether the line between two points passes through a box, to a fiftieth of its length."""
    points = start + (np.array(end) - start) * np.linspace(0.0, 1.0, 51)[:, None]
    return _covered(box, points) > 0


def _within(box: Bbox, panel: Bbox) -> bool:
    return bool(panel.x0 < box.x0 and box.x1 < panel.x1 and panel.y0 < box.y0 and box.y1 < panel.y1)


def _samples(axes: Axes, line: Line2D, pixel: float) -> NDArray[np.float64]:
    """Positions along a line (n, 2), a point apart, in pixels."""
    corners = line.get_transform().transform(np.column_stack(line.get_data(orig=False)).astype(float))
    parts = [corners[:1]]
    for first, last in pairwise(corners):
        steps = max(1, math.ceil(float(np.hypot(*(last - first))) / pixel))
        parts.append(first + (last - first) * np.arange(1, steps + 1)[:, None] / steps)
    return np.concatenate(parts)


def _covered(box: Bbox, lines: NDArray[np.float64]) -> int:
    inside = (lines >= (box.x0, box.y0)) & (lines <= (box.x1, box.y1))
    return int(inside.all(axis=1).sum())
