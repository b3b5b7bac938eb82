"""What a bifurcation diagram's picture draws, read back from its artists."""

from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from service.results.diagram import Diagram

from kernel.threshold import threshold
from service.render import bifurcation
from service.render.style import BLUE, GREY, RED
from worker.spec import SweepSpec

NAN = float("nan")
SPEC: dict[str, Any] = {"gamma": [0.5, 1.5, 2.5, 3.5], "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"}}


def cells(**changes: Any) -> Diagram:
    """Four cells: at rest, bouncing once, bouncing twice, and at rest."""
    arrays: dict[str, Any] = {
        "flight_time": np.array([[NAN, NAN], [4.0, NAN], [3.0, 6.0], [NAN, NAN]]),
        "flights": np.array([0, 1, 2, 0], np.int32),
        "outcome": np.array([3, 1, 2, 3], np.uint8),
    }
    fields: dict[str, Any] = {
        "along": "gamma",
        "fixed": {"omega": 0.5, "xi": 0.26},
        "direction": "rest",
        "values": np.array([0.5, 1.5, 2.5, 3.5]),
        "arrays": arrays | changes.pop("arrays", {}),
    }
    return Diagram(**(fields | changes))


def drawn(*diagrams: Diagram, **spec: Any) -> Axes:
    figure = Figure(figsize=bifurcation.SIZE)
    axes = figure.subplots()
    bifurcation._draw(axes, diagrams, SweepSpec(**(SPEC | spec)))
    figure.draw_without_rendering()
    return axes


def points(axes: Axes) -> list[Line2D]:
    return [line for line in axes.lines if line.get_marker() == "."]


def onsets(axes: Axes) -> list[float]:
    """Positions of the vertical lines."""
    return [line.get_xdata()[0] for line in axes.lines if list(line.get_ydata()) == [0, 1]]


def texts(axes: Axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


def test_a_point_for_each_flight_at_its_cell():
    (dots,) = points(drawn(cells()))
    assert sorted(zip(dots.get_xdata(), dots.get_ydata(), strict=True)) == [
        (1.5, 4.0),
        (2.5, 3.0),
        (2.5, 6.0),
    ]
    assert to_hex(dots.get_color()) == "#000000"
    assert dots.get_linestyle() == "None"


def test_flights_that_do_not_count_are_left_out():
    (dots,) = points(drawn(cells(min_flight=3.5)))
    assert sorted(zip(dots.get_xdata(), dots.get_ydata(), strict=True)) == [(1.5, 4.0), (2.5, 6.0)]


def test_up_is_a_rim_below_down():
    lower = np.array([[NAN, NAN], [2.0, NAN], [1.0, 5.0], [NAN, NAN]])
    axes = drawn(cells(direction="up"), cells(direction="down", arrays={"flight_time": lower}))
    up, down = points(axes)
    assert (up.get_label(), down.get_label()) == ("up", "down")
    assert (to_hex(up.get_color()), to_hex(down.get_color())) == (GREY, RED)
    assert up.get_markersize() > 2 * down.get_markersize()
    assert list(up.get_ydata()) == [4.0, 3.0, 6.0]
    assert list(down.get_ydata()) == [2.0, 1.0, 5.0]
    legend = axes.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["up", "down"]
    assert drawn(cells()).get_legend() is None


def test_the_axes_span_the_cells_and_the_longest_flight_of_all_directions():
    axes = drawn(
        cells(direction="up"), cells(direction="down", arrays={"flight_time": cells().flight_time * 2})
    )
    assert axes.get_xlim() == (0.5, 3.5)
    assert axes.get_ylim() == pytest.approx((0.0, 1.06 * 12.0))
    assert axes.get_xscale() == "linear"


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        ([1.0, 2.0, 4.0, 8.0], "log"),
        ([1.0, 2.0, 3.0, 4.0], "linear"),
        ([1.0, 2.0, 4.0, 8.1], "linear"),
        ([0.0, 1.0, 10.0, 100.0], "linear"),
        ([1.0, 1.0 + 1e-9, 1.0 + 2e-9, 1.0 + 3e-9], "linear"),  # equal steps and equal ratios
        ([1.0, 10.0], "linear"),
        ([1.0, 2.0, 4.0], "log"),
    ],
)
def test_values_in_equal_ratios_have_a_logarithmic_axis(values: list[float], scale: str):
    number = len(values)
    arrays = {name: array[:number] for name, array in cells().arrays.items()}
    assert drawn(cells(values=np.array(values), arrays=arrays)).get_xscale() == scale


def test_the_threshold_is_a_line_where_the_axis_has_it():
    onset = float(threshold(0.5, 0.26))
    assert onsets(drawn(cells())) == pytest.approx([onset])
    (line,) = [line for line in drawn(cells()).lines if list(line.get_ydata()) == [0, 1]]
    assert to_hex(line.get_color()) == BLUE
    for values in ([onset, 2, 3, 4], [0.1, 0.2, 0.3, onset]):
        assert onsets(drawn(cells(values=np.array(values)))) == pytest.approx([onset])
    for values in ([onset + 0.01, 2, 3, 4], [0.1, 0.2, 0.3, onset - 0.01]):
        assert onsets(drawn(cells(values=np.array(values)))) == []
    assert r"$\Gamma_{\mathrm{th}}$" in texts(drawn(cells()))
    along_omega = cells(along="omega", fixed={"gamma": 2.0, "xi": 0.26})
    assert onsets(drawn(along_omega)) == []
    other = drawn(cells(fixed={"omega": 0.7, "xi": 0.05}))
    assert onsets(other) == pytest.approx([float(threshold(0.7, 0.05))])


def test_a_picture_says_what_is_missing():
    missing = cells(direction="up", arrays={"outcome": np.array([3, 0, 0, 3], np.uint8)})
    whole = cells(direction="down")
    assert "incomplete: 2 of 8 cells are not computed yet" in texts(drawn(missing, whole))
    assert [text for text in texts(drawn(whole)) if "incomplete" in text] == []
    assert "incomplete: being repaired" in texts(drawn(cells(repairing=True)))


# Density
