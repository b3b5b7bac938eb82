"""Labels of points: each at the nearest place that covers nothing, measured in pixels of a figure."""

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text
from matplotlib.transforms import Bbox

from service.render import point_labels
from service.render.point_labels import BESIDE, GAP, MARKER, ROUNDS, PointLabel, place

#: Pixels of a point of text: figures have 144 pixels per inch.
PIXEL = 2.0


def empty(width: float = 4.0, height: float = 3.0) -> Axes:
    """Axes as large as their figure, whose coordinates are points of text."""
    figure = Figure(figsize=(width, height), dpi=72 * PIXEL)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0, 72 * width), ylim=(0, 72 * height))
    figure.draw_without_rendering()
    return axes


def labelled(axes: Axes, *labels: tuple[float, float, str]) -> list[Bbox]:
    """The boxes of the labels that were written, in points."""
    before = len(axes.texts)
    place(axes, [PointLabel(*label, "black") for label in labels])
    return [box_of(text) for text in axes.texts[before:]]


def box_of(text: Text) -> Bbox:
    figure = text.get_figure(root=True)
    assert figure is not None
    renderer = FigureCanvasAgg(figure).get_renderer()
    text.get_window_extent(renderer)  # with the line to the point, and puts the text where it belongs
    return Bbox(Text.get_window_extent(text, renderer).get_points() / PIXEL)


def middle(box: Bbox) -> tuple[float, float]:
    return ((box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2)


def beside(box: Bbox, point: tuple[float, float]) -> float:
    """How far a box is from the box of a marker, along the axis in which they are further apart."""
    across, up = (abs(a - b) for a, b in zip(middle(box), point, strict=True))
    return max(across - (box.width + MARKER) / 2, up - (box.height + MARKER) / 2)


def test_a_label_alone_is_to_the_right_of_its_point():
    axes = empty()
    (box,) = labelled(axes, (100.0, 80.0, "twelve"))
    assert middle(box) == pytest.approx((100.0 + (box.width + MARKER) / 2 + ROUNDS[0], 80.0), abs=0.01)
    (text,) = axes.texts
    assert isinstance(text, Annotation)
    assert text.arrow_patch is None


def test_labels_of_one_point_do_not_cover_each_other():
    axes = empty()
    boxes = labelled(axes, *[(144.0, 108.0, f"a wide label {n}") for n in range(9)])
    for i, box in enumerate(boxes):
        assert not any(box.padded(0.99 * GAP).overlaps(other) for other in boxes[:i])
    distances = [beside(box, (144.0, 108.0)) for box in boxes]
    assert distances[0] == pytest.approx(ROUNDS[0], abs=0.01)
    np.testing.assert_allclose(distances, sorted(distances), atol=0.01)
    assert len(set(np.round(distances, 1))) > 1


def test_a_line_leads_to_a_label_that_is_far_from_its_point():
    """Between the other points there is room for the line, and not for the text."""
    others = [(30.0, 0.0), (-30.0, 0.0), (20.0, 20.0), (-20.0, 20.0), (20.0, -20.0), (-20.0, -20.0)]
    axes = empty()
    (box,) = labelled(
        axes, (144.0, 108.0, "a wide label 1"), *[(144.0 + x, 108.0 + y, "") for x, y in others]
    )
    assert beside(box, (144.0, 108.0)) > BESIDE + 0.01
    (text,) = axes.texts
    assert isinstance(text, Annotation)
    assert text.arrow_patch is not None
    for x, y in others:
        marker = Bbox.from_bounds(144.0 + x - MARKER / 2, 108.0 + y - MARKER / 2, MARKER, MARKER)
        assert not box.overlaps(marker)
        assert not point_labels._crosses(np.array([144.0, 108.0]), middle(box), marker)


@pytest.mark.parametrize(("x", "y"), [(2.0, 80.0), (286.0, 80.0), (100.0, 2.0), (100.0, 214.0)])
def test_a_label_stays_in_its_panel(x: float, y: float):
    (box,) = labelled(empty(), (x, y, "twelve"))
    assert box.x0 > 0
    assert box.y0 > 0
    assert box.x1 < 288
    assert box.y1 < 216


def test_a_label_without_a_place_is_left_out():
    axes = empty(0.5, 0.5)
    assert labelled(axes, (18.0, 18.0, "longer than the panel")) == []
    assert len(axes.texts) == 0
