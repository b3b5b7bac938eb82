"""What a bifurcation diagram's picture draws, read back from its artists."""

from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D

from kernel.labels import CHAOTIC, QUASI_PERIODIC
from kernel.params import Outcome
from kernel.threshold import threshold
from service.render import bifurcation
from service.render.style import BLUE, GREY, RED, SYMBOLS
from service.results.counting import LABEL
from service.results.diagram import Diagram
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


def levels(axes: Axes) -> list[float]:
    """Heights of the horizontal lines."""
    return [line.get_ydata()[0] for line in axes.lines if list(line.get_xdata()) == [0, 1]]


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


@pytest.mark.parametrize(("number", "width"), [(4, 3.5), (300, 1.5), (10_000, 0.7)])
def test_dots_shrink_with_the_number_of_cells(number: int, width: float):
    assert bifurcation._dot(cells(values=np.linspace(1, 2, number))) == pytest.approx(width)


def test_many_points_are_one_image_inside_a_vector_picture(monkeypatch: pytest.MonkeyPatch):
    for most, image in ((3, False), (2, True)):
        monkeypatch.setattr(bifurcation, "MANY_POINTS", most)
        assert points(drawn(cells()))[0].get_rasterized() is image


def test_the_axes_span_the_cells_and_the_longest_flight_of_all_directions():
    axes = drawn(
        cells(direction="up"), cells(direction="down", arrays={"flight_time": cells().flight_time * 2})
    )
    assert axes.get_xlim() == (0.5, 3.5)
    assert axes.get_ylim() == pytest.approx((0.0, 1.06 * 12.0))
    assert axes.get_xscale() == "linear"


def test_a_cell_alone_has_an_axis_around_it():
    arrays = {name: array[1:2] for name, array in cells().arrays.items()}
    axes = drawn(cells(values=np.array([1.5]), arrays=arrays))
    left, right = axes.get_xlim()
    assert left < 1.5 < right
    (dots,) = points(axes)
    assert dots.get_xydata().tolist() == [[1.5, 4.0]]


@pytest.mark.parametrize(("longest", "step"), [(6.0, 1.0), (8.2, 2.0), (30.0, 5.0), (60.0, 10.0)])
def test_the_axis_of_flights_has_at_most_nine_ticks_at_round_numbers(longest: float, step: float):
    axes = drawn(cells(arrays={"flight_time": cells().flight_time * longest / 6.0}))
    assert set(np.diff(axes.get_yticks())) == {step}


def test_without_flights_the_axis_is_a_plate_period():
    axes = drawn(cells(arrays={"flights": np.zeros(4, np.int32)}))
    assert axes.get_ylim() == pytest.approx((0.0, 1.06 * 2 * np.pi))


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


def test_many_close_values_are_told_apart_too():
    assert bifurcation._is_geometric(np.geomspace(1.0, 1.2, 1000))
    assert not bifurcation._is_geometric(np.linspace(1.0, 1.2, 1000))
    assert not bifurcation._is_geometric(np.linspace(1.0, 1.2, 1000) ** 2)


def test_whole_plate_periods_are_lines_and_counted_on_the_right():
    long = cells(arrays={"flight_time": np.array([[NAN, NAN], [4.0, NAN], [3.0, 20.0], [NAN, NAN]])})
    axes = drawn(long)
    assert levels(axes) == pytest.approx([2 * np.pi, 4 * np.pi, 6 * np.pi])
    (right,) = axes.child_axes
    assert [text.get_text() for text in right.get_yticklabels()] == [r"$2\pi$", r"$4\pi$", r"$6\pi$"]
    assert list(right.get_yticks()) == pytest.approx([2 * np.pi, 4 * np.pi, 6 * np.pi])
    assert levels(drawn(cells(arrays={"flight_time": cells().flight_time / 2}))) == []


def test_of_many_plate_periods_some_are_drawn():
    long = cells(arrays={"flight_time": np.array([[NAN, NAN], [4.0, NAN], [3.0, 200.0], [NAN, NAN]])})
    # The axis ends at 212 rad, after 33 periods: every fourth, from the first.
    assert levels(drawn(long)) == pytest.approx([2 * np.pi * n for n in range(1, 34, 4)])


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


def test_the_axes_are_named_and_the_fixed_values_stated():
    axes = drawn(cells(along="omega", fixed={"gamma": 2.25, "xi": 0.26}))
    assert axes.get_xlabel() == SYMBOLS["omega"]
    assert axes.get_ylabel().startswith("flight time")
    assert axes.get_title("left") == f"{SYMBOLS['gamma']} = 2.25,   {SYMBOLS['xi']} = 0.26"


def test_the_title_says_how_the_cells_were_computed():
    assert drawn(cells()).get_title("right") == "rigid contact, from rest"
    ramp = {"protocol": {"kind": "ramp", "axis": "gamma", "direction": "up"}}
    assert drawn(cells(every=2)).get_title("right") == "rigid contact, from rest, 1 cell in 2"
    thinned = drawn(cells(min_flight=0.5, every=1_000), **ramp)
    assert thinned.get_title("right") == (
        f"rigid contact, ramped along {SYMBOLS['gamma']}, flights above 0.5 rad, 1 cell in 1,000"
    )


def test_the_title_counts_the_cells_that_are_not_periodic():
    outcome = np.array([Outcome.UNRESOLVED, Outcome.DIVERGED, Outcome.SETTLING, Outcome.APERIODIC], np.uint8)
    lost = drawn(cells(arrays={"outcome": outcome})).get_title("right")
    assert lost == "rigid contact, from rest, 2 of 4 cells unresolved, 1 settling"
    labels = np.array([CHAOTIC, CHAOTIC, QUASI_PERIODIC, Outcome.PERIODIC], np.uint8)
    told = drawn(cells(arrays={LABEL.name: labels})).get_title("right")
    assert told == "rigid contact, from rest, 1 quasi-periodic, 2 chaotic"


def test_a_picture_says_what_is_missing():
    missing = cells(direction="up", arrays={"outcome": np.array([3, 0, 0, 3], np.uint8)})
    whole = cells(direction="down")
    assert "incomplete: 2 of 8 cells are not computed yet" in texts(drawn(missing, whole))
    assert [text for text in texts(drawn(whole)) if "incomplete" in text] == []
    assert "incomplete: being repaired" in texts(drawn(cells(repairing=True)))


# Density


def image(axes: Axes) -> np.ndarray:
    (overlay,) = [child for child in axes.child_axes if child.images]
    (shown,) = overlay.images
    assert isinstance(shown, AxesImage)
    assert shown.origin == "lower"
    assert overlay.get_position().bounds == pytest.approx(axes.get_position().bounds, abs=0.02)
    return np.asarray(shown.get_array())


def test_density_shades_the_bins_of_the_flights(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(bifurcation, "DENSE_POINTS", 2)
    monkeypatch.setattr(bifurcation, "COLUMNS_AND_ROWS", (30, 20))
    monkeypatch.setattr(bifurcation, "_dot", lambda _: 0.1)  # no dot is wider than a bin
    times = np.full((4, 64), NAN)
    times[1, :1], times[2, :64] = 4.0, 2.0
    flights = np.array([0, 1, 64, 0], np.int32)
    axes = drawn(cells(arrays={"flight_time": times, "flights": flights}))
    shades = image(axes)
    assert shades.shape == (20, 30, 4)
    top = axes.get_ylim()[1]
    lit = {(int(4.0 / top * 20), 10): 1, (int(2.0 / top * 20), 20): 64}
    assert {tuple(map(int, place)) for place in np.argwhere(shades[..., 3] > 0)} == set(lit)
    faint, opaque = (shades[place][3] for place in lit)
    assert faint == bifurcation.FAINTEST
    assert opaque == 1.0
    assert [tuple(shades[place][:3]) for place in lit] == [to_rgb("black")] * 2
    (handle,) = points(axes)
    assert (len(handle.get_xdata()), handle.get_label()) == (0, "rest")


def test_density_of_two_directions_has_the_colours_and_sizes_of_their_points(monkeypatch: pytest.MonkeyPatch):
    both = cells(direction="up"), cells(direction="down")
    dots = points(drawn(*both))
    monkeypatch.setattr(bifurcation, "DENSE_POINTS", 2)
    axes = drawn(*both)
    for handle, dot in zip(points(axes), dots, strict=True):
        assert handle.get_markersize() == dot.get_markersize()
        assert (handle.get_color(), handle.get_label()) == (dot.get_color(), dot.get_label())
    shades = [np.asarray(child.images[0].get_array()) for child in axes.child_axes if child.images]
    assert [tuple(shade[0, 0, :3]) for shade in shades] == [to_rgb(GREY), to_rgb(RED)]


def test_as_many_flights_as_are_drawn_as_points_are_no_density(monkeypatch: pytest.MonkeyPatch):
    for most, dense in ((3, False), (2, True)):
        monkeypatch.setattr(bifurcation, "DENSE_POINTS", most)
        assert any(child.images for child in drawn(cells()).child_axes) is dense


@pytest.mark.parametrize(
    ("few", "many", "shade"), [(3, 12, np.log(3) / np.log(12)), (1, 2, 0.0), (2, 2, 1.0), (1, 1, 0.0)]
)
def test_a_bin_with_some_flights_is_darker_than_one_with_one(
    few: int, many: int, shade: float, monkeypatch: pytest.MonkeyPatch
):
    """Black from the most flights of a bin on, or from two if no bin has so many."""
    monkeypatch.setattr(bifurcation, "DENSE_POINTS", 1)
    monkeypatch.setattr(bifurcation, "COLUMNS_AND_ROWS", (30, 20))
    monkeypatch.setattr(bifurcation, "_dot", lambda _: 0.1)
    times = np.full((4, 12), NAN)
    times[1, :few], times[2, :many] = 4.0, 2.0
    axes = drawn(cells(arrays={"flight_time": times, "flights": np.array([0, few, many, 0], np.int32)}))
    alpha = np.unique(image(axes)[..., 3])
    darkest = shade if few == many else 1.0
    expected = {0.0, *(bifurcation.FAINTEST + (1 - bifurcation.FAINTEST) * x for x in (shade, darkest))}
    assert alpha == pytest.approx(sorted(expected))


@pytest.mark.parametrize(("width", "covered"), [(1, [3]), (2, [3, 4]), (3, [2, 3, 4]), (4, [2, 3, 4, 5])])
def test_a_count_is_spread_over_the_width_of_a_dot(width: int, covered: list[int]):
    counts = np.zeros((8, 8), np.int64)
    counts[3, 3] = 7
    spread = bifurcation._widened(counts, width)
    expected = np.zeros((8, 8), np.int64)
    expected[np.ix_(covered, covered)] = 7
    np.testing.assert_array_equal(spread, expected)


def test_a_count_at_an_edge_does_not_come_back_at_the_other():
    counts = np.zeros((5, 5), np.int64)
    counts[0, 0], counts[4, 4] = 2, 9
    spread = bifurcation._widened(counts, 3)
    assert [spread[0, 4], spread[4, 0], spread[1, 1], spread[3, 3], spread[2, 2]] == [0, 0, 2, 9, 0]


def test_nothing_else_is_drawn():
    axes = drawn(cells())
    assert not [child for child in axes.collections if isinstance(child, LineCollection)]
    assert len(axes.lines) == 1 + len(levels(axes)) + len(onsets(axes))
