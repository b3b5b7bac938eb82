"""Labels of points: each at the nearest place that covers nothing, measured in pixels of a figure."""

from collections.abc import Sequence

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text
from matplotlib.transforms import Bbox
from tables import for_each

from service.render import point_labels
from service.render.point_labels import BESIDE, DIRECTIONS, GAP, MARKER, ROUNDS, PointLabel, place

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


def test_points_without_a_text_are_kept_free():
    axes = empty()
    (box,) = labelled(axes, (100.0, 80.0, "twelve"), (125.0, 80.0, ""))
    assert beside(box, (100.0, 80.0)) == pytest.approx(ROUNDS[0], abs=0.01)
    for x, y in ((100, 80), (125, 80)):
        assert not box.overlaps(Bbox.from_bounds(x - MARKER / 2, y - MARKER / 2, MARKER, MARKER))


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


def test_a_text_and_a_legend_that_are_there_are_not_covered():
    axes = empty()
    there = axes.text(105.0, 80.0, "a text", va="center")
    axes.plot([0, 1], [0, 1], label="line")
    legend = axes.legend(loc="center left", bbox_to_anchor=(70 / 288, 50 / 216), borderaxespad=0.0)
    (box,) = labelled(axes, (100.0, 80.0, "twelve"))
    covered = legend.get_window_extent(FigureCanvasAgg(axes.figure).get_renderer()).get_points() / PIXEL  # type: ignore[arg-type]
    for other in (box_of(there), Bbox(covered)):
        assert not box.overlaps(other)


def test_a_label_leaves_the_place_beside_its_point_to_a_legend():
    axes = empty()
    axes.scatter([0], [0], label="points")
    legend = axes.legend(loc="center left", bbox_to_anchor=(105 / 288, 80 / 216), borderaxespad=0.0)
    (box,) = labelled(axes, (100.0, 80.0, "twelve"))
    covered = legend.get_window_extent(FigureCanvasAgg(axes.figure).get_renderer()).get_points() / PIXEL  # type: ignore[arg-type]
    assert not box.overlaps(Bbox(covered))
    assert middle(box)[0] < 105.0


def test_a_label_rather_goes_where_no_line_is():
    axes = empty()
    axes.plot([100.0, 200.0], [80.0, 80.0])  # to the right
    (box,) = labelled(axes, (100.0, 80.0, "twelve"))
    assert box.y0 > 80.0 or box.y1 < 80.0 or box.x1 < 100.0
    assert beside(box, (100.0, 80.0)) == pytest.approx(ROUNDS[0], abs=0.01)


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


def test_without_points_nothing_is_written():
    axes = empty()
    assert labelled(axes) == []
    assert len(axes.texts) == 0


def test_a_label_that_is_just_beside_its_point_has_no_line():
    """A panel in which there is room to the right alone, beyond another point."""
    axes = empty(2.0, 0.25)
    (box,) = labelled(axes, (20.0, 9.0, "twelve"), (28.0, 9.0, ""))
    assert beside(box, (20.0, 9.0)) == pytest.approx(BESIDE, abs=0.01)
    (text,) = axes.texts
    assert isinstance(text, Annotation)
    assert text.arrow_patch is None


def test_places_go_round_the_point_nearer_ones_first():
    """A text of 20 by 6 points: its box touches the border of a box about the marker's."""
    offsets = list(point_labels._offsets(20.0, 6.0))
    assert [distance for distance, _ in offsets] == [round_ for round_ in ROUNDS for _ in range(DIRECTIONS)]
    across, up = (20.0 + MARKER) / 2 + ROUNDS[0], (6.0 + MARKER) / 2 + ROUNDS[0]
    for direction, expected in {0: (across, 0.0), 3: (up, up), 6: (0.0, up), 12: (-across, 0.0),
                                15: (-up, -up), 18: (0.0, -up)}.items():  # fmt: skip
        assert offsets[direction][1] == pytest.approx(expected)


BOX = Bbox.from_extents(2.0, 3.0, 6.0, 5.0)


@for_each(
    ("start", "end", "crosses"),
    [
        ((0.0, 4.0), (10.0, 4.0), True),
        ((0.0, 1.0), (8.0, 7.0), True),
        ((0.0, 4.0), (4.0, 4.0), True),  # ends inside
        ((0.0, 4.0), (1.9, 4.0), False),
        ((6.1, 4.0), (10.0, 4.0), False),
        ((0.0, 5.1), (10.0, 5.1), False),
        ((0.0, 2.9), (10.0, 2.9), False),
        ((4.0, 0.0), (4.0, 2.9), False),
    ],
)
def test_whether_a_line_passes_through_a_box(
    start: tuple[float, float], end: tuple[float, float], crosses: bool
):
    assert point_labels._crosses(np.array(start), end, BOX) is crosses
    assert point_labels._crosses(np.array(end), start, BOX) is crosses


def test_points_of_lines_within_a_box_are_counted_with_its_border():
    points = [(2.0, 3.0), (6.0, 5.0), (4.0, 4.0), (1.9, 4.0), (6.1, 4.0), (4.0, 2.9), (4.0, 5.1)]
    assert point_labels._covered(BOX, np.array(points)) == 3
    assert point_labels._covered(BOX, np.empty((0, 2))) == 0


@for_each(
    ("panel", "inside"),
    [
        ((1.9, 2.9, 6.1, 5.1), True),
        ((2.0, 2.9, 6.1, 5.1), False),
        ((1.9, 3.0, 6.1, 5.1), False),
        ((1.9, 2.9, 6.0, 5.1), False),
        ((1.9, 2.9, 6.1, 5.0), False),
    ],
)
def test_a_box_inside_a_panel_touches_no_side(panel: Sequence[float], inside: bool):
    assert point_labels._within(BOX, Bbox.from_extents(*panel)) is inside


def test_a_line_is_sampled_a_point_apart():
    axes = empty()
    (line,) = axes.plot([10.0, 40.0, 40.0, 40.5], [20.0, 60.0, 50.0, 50.0])  # 50, 10 and half a point long
    samples = point_labels._samples(axes, line, PIXEL) / PIXEL
    assert len(samples) == 1 + 50 + 10 + 1
    assert samples[0] == pytest.approx([10.0, 20.0])
    assert samples[25] == pytest.approx([25.0, 40.0])
    assert samples[50] == pytest.approx([40.0, 60.0])
    assert samples[51] == pytest.approx([40.0, 59.0])
    assert samples[-1] == pytest.approx([40.5, 50.0])
    (dot,) = axes.plot([10.0], [20.0])
    assert len(point_labels._samples(axes, dot, PIXEL)) == 1
