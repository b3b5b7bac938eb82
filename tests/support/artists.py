"""The content of a matplotlib figure, read back from its artists."""

import re
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axis import Tick
from matplotlib.collections import Collection
from matplotlib.colors import to_hex
from matplotlib.figure import FigureBase
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Annotation, Text
from numpy.typing import NDArray

#: Digits after the point of a position, in widths and heights of the figure.
DIGITS = 5
#: Larger differences of a position are not of rounding; a pixel of most pictures is ten times as large.
TOLERANCE = 1e-4
_POSITION = re.compile(rf"-?\d+\.\d{{{DIGITS}}}")


def read_back(figure: FigureBase) -> list[str]:
    """A line of text for each visible artist: its kind, its content, and its position.

    Positions are in widths and heights of the figure: the corners of a text; for a line, a patch or a
    collection the number of points, the ranges of x and y, their means, and a mean weighted by the order of
    the points. Omits ticks but not their labels. Two figures with the same lines look the same except for the
    widths of lines and the sizes of markers.
    """
    figure.get_figure(root=True).draw_without_rendering()
    return [line for artist in _visible(figure) if (line := _described(artist))]


def difference(drawn: Sequence[str], expected: Sequence[str]) -> str:
    """The first artist that differs by more than TOLERANCE; empty if none does."""
    for number, (line, before) in enumerate(zip_longest(drawn, expected, fillvalue="nothing")):
        words, values = _words_and_positions(line)
        expected_words, expected_values = _words_and_positions(before)
        same = words == expected_words
        if not same or not np.allclose(values, expected_values, rtol=TOLERANCE, atol=TOLERANCE):
            return f"artist {number}: {line}, expected {before}"
    return ""


def _words_and_positions(line: str) -> tuple[list[str], list[float]]:
    """Words, which have to be the same, and positions, which may differ by rounding."""
    words = [word for word in line.split() if not _POSITION.fullmatch(word)]
    return words, [float(word) for word in line.split() if _POSITION.fullmatch(word)]


def _visible(artist: Artist) -> Iterator[Artist]:
    """Visible artists in the order in which they are drawn."""
    if not artist.get_visible():
        return
    yield artist
    for child in artist.get_children():
        if isinstance(artist, Tick) and isinstance(child, Line2D):
            continue
        yield from _visible(child)


def _described(artist: Artist) -> str | None:
    if isinstance(artist, Text):
        return _text(artist)
    if isinstance(artist, Line2D):
        return _line(artist)
    if isinstance(artist, AxesImage):
        corners = artist.get_window_extent().get_points()
        return f"image {_values(artist.to_rgba(artist.get_array()))} {_where(artist, corners)}"
    if isinstance(artist, Collection):
        array = artist.get_array()
        values = "" if array is None else f"{_values(artist.to_rgba(array))} "
        return f"collection {len(artist.get_paths())} {values}{_where(artist, _collected(artist))}"
    if isinstance(artist, Patch):
        vertices = artist.get_transform().transform(artist.get_path().vertices)
        return f"patch {_hex(artist.get_facecolor())} {_where(artist, vertices)}"
    return None


def _line(artist: Line2D) -> str | None:
    marker, (offset, dashes) = artist.get_marker(), artist._unscaled_dash_pattern
    if artist.get_linestyle() == "None":
        if marker in ("None", None, ""):
            return None
        shown = f"{marker} {_hex(artist.get_markerfacecolor())} {_hex(artist.get_markeredgecolor())}"
    else:
        lengths = "" if dashes is None else "-".join(f"{length:.2f}" for length in dashes)
        begins = f"{offset}+" if offset else ""
        shown = f"{marker} {_hex(artist.get_color())} {begins}{lengths or 'solid'}"
    clipped = "" if artist.get_clip_on() else "unclipped "
    return f"line {shown} {clipped}{_where(artist, artist.get_transform().transform(artist.get_xydata()))}"


def _hex(colour: Any) -> str:
    return to_hex(colour, keep_alpha=False)


def _values(array: Any) -> str:
    """The shape of an array of colours, its mean, and a mean weighted by the order of its values."""
    values = np.asarray(array, float)
    order = np.linspace(1.0, 2.0, values.size)
    return f"{values.shape} {_numbers(np.array([values.mean(), np.mean(order * values.ravel())]))}"


def _collected(artist: Collection) -> NDArray[np.float64]:
    """The places where paths are drawn, or the vertices of paths that are drawn once, in pixels."""
    transform, to_pixels, offsets, paths = artist._prepare_points()
    places = np.asarray(to_pixels.transform(np.ma.filled(np.ma.asarray(offsets, float), np.nan)))
    if len(offsets) > 1 or not paths:
        return places
    return np.concatenate([transform.transform(path.vertices) for path in paths]) + places


def _text(artist: Text) -> str | None:
    if not artist.get_text().strip():
        return None
    box = Text.get_window_extent(artist).get_points() / _size(artist)  # of an annotation without its arrow
    unclipped = isinstance(artist, Annotation) and artist.get_annotation_clip() is False
    clipped = "unclipped " if unclipped else ""
    return f"text {artist.get_text()!r} {_hex(artist.get_color())} {clipped}{_numbers(box)}"


def _where(artist: Artist, points: Any) -> str:
    """The number of finite points, and their ranges and means."""
    places = np.asarray(points, float).reshape(-1, 2) / _size(artist)
    places = places[np.isfinite(places).all(axis=1)]
    if not len(places):
        return "0"
    order = np.linspace(1.0, 2.0, len(places))[:, None]
    means = places.mean(axis=0), (order * places).mean(axis=0)
    return f"{len(places)} {_numbers(np.array([places.min(axis=0), places.max(axis=0), *means]))}"


def _size(artist: Artist) -> NDArray[np.float64]:
    figure = artist.get_figure(root=True)
    assert figure is not None
    return np.asarray(figure.bbox.size)


def _numbers(values: NDArray[np.float64]) -> str:
    return " ".join(f"{value:.{DIGITS}f}" for value in (values + 0.0).ravel())
