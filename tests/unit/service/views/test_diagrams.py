"""Diagrams made up by hand: their table, and what their picture draws, read back from its artists."""

from typing import Any

import numpy as np
import pytest
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from service import pictures
from service.views import diagram
from service.views.variables import variable
from worker.sweep import schema

NAN = np.nan
ROWS = {row.name: row for row in (*schema.RECORD, schema.OUTCOME)}


def cells(
    *, along: str = "gamma", gamma: Any = (0.5, 1.5, 2.5, 3.5), complete: bool = True, **arrays: Any
) -> xarray.Dataset:
    """Four cells: at rest, bouncing once, bouncing twice, and at rest."""
    times = [[NAN, NAN], [4.0, NAN], [3.0, 6.0], [NAN, NAN]]
    values = {"flight_time": times, "outcome": [3, 1, 2, 3], "bounces": [0, 1, 0, 0], "periods": [0, 1, 0, 0]}
    values |= arrays
    fixed = {"gamma": 2.0, "omega": 0.5, "xi": 0.26, "direction": "rest"}
    return xarray.Dataset(
        {name: variable((along,), array, ROWS[name]) for name, array in values.items()},
        {**fixed, along: np.asarray(gamma)},
        {"along": along, "complete": complete, "caption": "ramped along xi"},
    )  # fmt: skip


def both(up: xarray.Dataset, down: xarray.Dataset) -> xarray.Dataset:
    return xarray.concat(
        [up.assign_coords(direction="up"), down.assign_coords(direction="down")], "direction"
    )


def drawn(found: xarray.Dataset) -> Axes:
    figure = Figure(figsize=diagram.SIZE)
    diagram.draw(found, figure)
    figure.draw_without_rendering()
    return figure.axes[0]


def texts(axes: Axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


def test_strips_have_the_modes_of_both_ways_without_hidden_classes():
    found = both(cells(), cells(bounces=[0, 2, 0, 0])).assign_attrs(hide="aperiodic")
    axes = drawn(found)
    names = [[pictures.CLASS_NAMES[i] for i in strip.get_array().compressed()] for strip in axes.collections]
    assert names == [["at_rest", "1-equal", "at_rest"], ["at_rest", "1-more", "at_rest"]]
    entries = [text.get_text() for text in axes.get_legend().get_texts()]
    assert entries == ["ramp up", "ramp down", "(1, 1)", "(>1, 1)", "at rest"]


def test_many_flights_are_drawn_as_density(monkeypatch: pytest.MonkeyPatch):
    """A bin is drawn where flights are; one flight covers its bin alone."""
    monkeypatch.setattr(pictures, "DENSE_POINTS", 2)
    monkeypatch.setattr(pictures, "COLUMNS_AND_ROWS", (4, 4))
    monkeypatch.setattr(pictures, "dot_of", lambda number: 0.36)  # a pixel
    axes = drawn(cells())
    (line,) = (line for line in axes.lines if line.get_marker() == ".")
    assert len(line.get_xdata()) == 0
    image, _ = axes.collections
    # a bin of gamma for each value, of flights up to 6.36 rad
    assert np.argwhere(~np.ma.getmaskarray(image.get_array())).tolist() == [[1, 2], [2, 1], [3, 2]]


@pytest.mark.parametrize(
    ("values", "scale"),
    [([1, 2, 4, 8], "log"), ([1, 2, 3, 4], "linear"), ([0, 1, 10, 100], "linear"),
     ([1.0, 1.0 + 1e-9, 1.0 + 2e-9, 1.0 + 3e-9], "linear")],
)  # fmt: skip
def test_values_in_equal_ratios_have_a_logarithmic_axis(values: list[float], scale: str):
    axes = drawn(cells(gamma=np.array(values, float)))
    assert axes.get_xscale() == scale
    assert not any(label.get_text() for label in axes.get_xticklabels(minor=True))


@pytest.mark.parametrize("log", ["none", "x", "y", "xy"])
def test_axes_are_logarithmic_where_asked(log: str):
    axes = drawn(cells(gamma=[1.0, 2.0, 4.0, 8.0]).assign_attrs(log=log))
    assert (axes.get_xscale() == "log", axes.get_yscale() == "log") == ("x" in log, "y" in log)
    assert axes.get_ylim()[0] == (pytest.approx(axes.get_ylim()[1] / 1000) if "y" in log else 0.0)
    axes.figure.canvas.draw()


def test_ticks_of_a_narrow_logarithmic_axis_differ():
    axes = drawn(cells(gamma=2.3 + 1e-9 * np.arange(4)).assign_attrs(log="x"))
    axes.figure.canvas.draw()
    labels = [label.get_text() for label in axes.get_xticklabels()]
    assert len(set(labels)) == len(labels)


def test_a_picture_says_what_is_missing():
    missing = both(cells(outcome=[3, 0, 0, 3], complete=False), cells())
    assert "incomplete: 2 of 8 cells are not computed yet" in texts(drawn(missing))
    assert "incomplete: being repaired" in texts(drawn(cells(complete=False)))
    assert not any("incomplete" in text for text in texts(drawn(cells())))
