"""What a bifurcation diagram's picture draws, read back from its artists."""

from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from service.results.diagram import Diagram

from kernel.threshold import threshold
from service.render import bifurcation
from service.render.style import BLUE
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


def onsets(axes: Axes) -> list[float]:
    """Positions of the vertical lines."""
    return [line.get_xdata()[0] for line in axes.lines if list(line.get_ydata()) == [0, 1]]


def texts(axes: Axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        ([1.0, 2.0, 4.0, 8.0], "log"),
        ([1.0, 2.0, 3.0, 4.0], "linear"),
        ([1.0, 1.0 + 1e-9, 1.0 + 2e-9, 1.0 + 3e-9], "linear"),
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


# Density
