"""The figures that there are, their parameters, and how captions sort claims."""

from collections.abc import Sequence

import numpy as np
import pytest
import steps
from tables import for_each

from service.client import BounceError
from service.figures import catalogue
from service.figures.drawing import Caption, compared, left_open
from service.figures.onsets import minima


@for_each("which", ["10", "0", "-1", "one", "ALL", ""])
def test_an_unknown_figure_names_those_there_are(which: str):
    with pytest.raises(BounceError, match=r"choose one of: 1, 2, 3, 4, 5, 6, 7, 8, 9, all"):
        catalogue.figures(which)


@for_each(("values", "indices"), [
    ([3, 1, 2, 0, 3], [1, 3]),
    ([3, 1, 1.01, 0, 3], [3]),  # too shallow on one side
    ([1, 2, 3], []),
    ([3, 1, 1, 2], [2]),
    ([3, 1, 2, np.nan], [1]),  # the grid does not hold the last threshold
])  # fmt: skip
def test_minima_have_a_minimal_depth(values: Sequence[float], indices: list[int]):
    assert minima(np.array(values, float), 0.5) == indices


def test_plain_time_steps_scatter_the_flights_that_located_ones_repeat():
    """The figure of docs/accuracy.md, from three of its cells."""
    figure, off = steps.draw(num=3)
    figure.draw_without_rendering()
    assert off["verlet", "located"].max() < 0.01
    assert off["verlet", "plain"].max() > 0.1
    assert off["euler", "plain"].min() > 1.0


def test_caption_sorts_claims():
    claims = (
        compared(True, "one"),
        compared(np.bool_(False), "two"),
        left_open("three"),
        compared(True, "four"),
    )
    sorted_ = ["Fig. 5. A line.", "Agrees: one; four.", "Contradicts: two.", "Left open by the paper: three."]
    assert str(Caption(5, "A line.", claims)) == "\n".join(sorted_)
    assert str(Caption(5, "A line.", ())) == "Fig. 5. A line."
