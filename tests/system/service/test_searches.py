"""Searches for cycles below the rule, asked for by the client."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from served import computing
from studies import spec_of

from service.client import Client
from service.pictures import draw_thresholds

RAMP = spec_of([0.7, 0.9], 0.52, 0.02, "both", (60, 20, 4))


@pytest.fixture
def client(tmp_path: Path) -> Iterator[Client]:
    with computing(tmp_path) as http:
        yield Client("http://localhost", http=http)


def test_a_grid_of_springs_is_searched(client: Client):
    """Each spring as alone. At 0.5395 and 0.032 it is a cycle below the rule."""
    how: dict[str, Any] = {"search": True, "effort": 0, "progress": False}
    grid = client.thresholds("0.5395:0.6217:2", "0.032,0.05", **how)
    assert (grid.down.dims, grid.down.shape) == (("xi", "omega"), (2, 2))
    assert grid.cause.values[0, 0] == "fold of word ss (2,2)"
    assert float(grid.down[0, 0]) == pytest.approx(0.8051293821, abs=1e-9)
    assert grid.cause.values[1].tolist() == ["fold (1,1)"] * 2
    assert set(grid.status.values.flat) == {"searched"}
    assert np.unique(grid.missed) == [pytest.approx(0.0295, abs=1e-4)]
    alone = client.threshold(0.6217, 0.05, **how)
    for name in grid.data_vars:
        assert str(grid[name].values[1, 1]) == str(alone[name].values)


def test_a_damping_that_was_not_searched_is_said_to_be(client: Client):
    """In the answer of a spring, and in the picture and the answer of a sweep, with cells too."""
    spring = client.threshold(0.52, 0.02)
    assert spring.cause.item() == "not searched"
    assert np.isnan([spring.down, spring.lifetime, spring.impact]).all()
    assert "from xi = 0.04 on" in spring.reason.item()
    assert "Eq. 25, Gamma = 0.843762" in spring.reason.item()
    job = client.submit(RAMP).wait(progress=False)
    for predict in ("some", "all", "cells"):
        found = job.threshold(predict=predict, progress=False)
        assert found.cause.values.tolist() == ["not searched"]
        assert "Eq. 25, Gamma = 0.843762" in found.reason.item()
        assert np.isnan(found.predicted_down.values).all()
    ax = Figure().subplots()
    draw_thresholds(ax, found)
    assert "closed form, not searched: 1 of 1" in [str(line.get_label()) for line in ax.lines]
    found = job.threshold(predict="search", progress=False)
    assert found.cause.values.tolist() == ["fold of word zsss (4,3), searched"]
    assert found.predicted_down.values == pytest.approx(0.7925441522, abs=1e-9)
    ax = Figure().subplots()
    draw_thresholds(ax, found)
    (marks,) = (line for line in ax.lines if line.get_label() == "searched, down")
    assert list(marks.get_ydata()) == found.predicted_down.values.tolist()
