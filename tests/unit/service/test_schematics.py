"""What figure 1 draws, read back from its artists, and claims of captions on data made for them."""

import numpy as np
import pytest
import xarray
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle

from kernel.params import Outcome
from service.figures import schematics, sections
from service.figures.caption import Verdict


@pytest.fixture(scope="module")
def panels() -> list[Axes]:
    return schematics.draw().figure.axes


def masses(axes: Axes) -> list[tuple[float, float]]:
    """Lowest and highest point of every mass, from the lowest up."""
    circles = [patch for patch in axes.patches if isinstance(patch, Circle)]
    return sorted((patch.center[1] - patch.radius, patch.center[1] + patch.radius) for patch in circles)


def arrows(axes: Axes) -> list[tuple[float, float]]:
    """Heights of the tip and the other end of every arrow; the texts of annotations are empty."""
    return [(note.xy[1], note.xyann[1]) for note in axes.texts if hasattr(note, "xyann")]


def test_a_ball_has_one_mass_and_a_spring_two_above_the_plate(panels: list[Axes]):
    assert [len(masses(axes)) for axes in panels] == [1, 2]
    for axes in panels:
        (plate,) = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
        assert plate.get_y() + plate.get_height() == pytest.approx(schematics.PLATE)
        assert masses(axes)[0][0] > schematics.PLATE
        for low, high in masses(axes):
            assert high - low == pytest.approx(2 * schematics.RADIUS)


def test_the_plate_moves_both_ways_and_gravity_points_down(panels: list[Axes]):
    for axes in panels:
        below = [pair for pair in arrows(axes) if max(pair) < schematics.PLATE]
        (gravity,) = [pair for pair in arrows(axes) if min(pair) > schematics.PLATE]
        assert len(below) == 1
        assert gravity[0] < gravity[1]


def test_coil_and_damper_reach_from_mass_to_mass(panels: list[Axes]):
    axes = panels[1]
    (_, bottom), (top, _) = masses(axes)
    for left in (
        True,
        False,
    ):  # the coil is left of the middle, the damper right of it; ends lie behind masses
        lines = [line for line in axes.lines if (np.mean(line.get_xdata()) < 0) == left]
        heights = np.concatenate([line.get_ydata() for line in lines])
        assert bottom - 2 * schematics.RADIUS < heights.min() < bottom
        assert top < heights.max() < top + 2 * schematics.RADIUS


def test_the_coil_goes_up_and_turns_to_both_sides(panels: list[Axes]):
    coil = max(
        (line for line in panels[1].lines if np.mean(line.get_xdata()) < 0),
        key=lambda line: len(line.get_xdata()),
    )
    assert (np.diff(coil.get_ydata()) > 0).all()
    turns = np.asarray(coil.get_xdata()) - coil.get_xdata()[0]
    assert turns.max() == pytest.approx(-turns.min())
    assert coil.get_xdata()[0] == coil.get_xdata()[-1]


@pytest.mark.parametrize(("last", "verdict"), [(1.155, Verdict.AGREES), (1.2, Verdict.CONTRADICTS)])
def test_where_bouncing_ends_is_compared_with_the_threshold_of_every_spring(last: float, verdict: Verdict):
    omega = np.array([0.5, last, 1.5])
    label = np.array([Outcome.PERIODIC, Outcome.APERIODIC, Outcome.AT_REST])
    claim = sections._stops_at(xarray.Dataset({"label": ("omega", label)}, {"omega": omega}))
    assert claim.verdict is verdict
    assert f"bouncing ends at Ω = {last:.3f}" in claim.text
