"""What figure 1 draws, read back from its artists, and claims of captions on data made for them."""

import pytest
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle

from service.figures import schematics


@pytest.fixture(scope="module")
def panels() -> list[Axes]:
    return schematics.draw().figure.axes


def masses(axes: Axes) -> list[tuple[float, float]]:
    """Lowest and highest point of every mass, from the lowest up."""
    circles = [patch for patch in axes.patches if isinstance(patch, Circle)]
    return sorted((patch.center[1] - patch.radius, patch.center[1] + patch.radius) for patch in circles)


def test_a_ball_has_one_mass_and_a_spring_two_above_the_plate(panels: list[Axes]):
    assert [len(masses(axes)) for axes in panels] == [1, 2]
    for axes in panels:
        (plate,) = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
        assert plate.get_y() + plate.get_height() == pytest.approx(schematics.PLATE)
        assert masses(axes)[0][0] > schematics.PLATE
        for low, high in masses(axes):
            assert high - low == pytest.approx(2 * schematics.RADIUS)
