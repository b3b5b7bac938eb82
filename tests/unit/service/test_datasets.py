"""Answers as Datasets: what is missing, unfinished or empty, on answers made for it."""

from typing import Any

import numpy as np
import pytest

from service.client import UnexpectedAnswer
from service.client.datasets import (
    MISSING_POINT,
    basin_dataset,
    multistability_dataset,
    words_dataset,
)

JOB = "0" * 32


def nan_as_none(values: Any) -> Any:
    return [None if np.isnan(value) else value for value in np.asarray(values).ravel().tolist()]


ATTRACTOR: dict[str, Any] = {
    "id": 7, "fraction": 0.75, "longest_flight": 5.0, "lifetime": None, "outcome": 1, "bounces": 1,
    "periods": 1, "label": "(1,1)", "flight_time": [5.0], "takeoff_phase": [1.0], "lyapunov": [-0.5],
}  # fmt: skip
BASIN: dict[str, Any] = {
    "plane": "drop", "attractors": [ATTRACTOR], "map": [[7, 7, 0]], "rows": [0.5], "columns": [0.0, 1.0, 2.0],
    "gamma": 1.2, "omega": 0.5, "xi": 0.26, "undecided": 0.25, "basin_entropy": None,
    "boundary_entropy": None, "complete": True,
}  # fmt: skip


def test_a_basin_with_one_attractor():
    basin = basin_dataset(BASIN, JOB)
    assert basin.lyapunov.dims == ("id", "exponent")
    assert basin.lyapunov.values.tolist() == [[-0.5]]
    assert basin.lifetime.values.tolist() == [np.inf]
    assert (basin.row.attrs["units"], basin.column.attrs["units"]) == ("plate amplitudes", "rad")
    aperiodic = BASIN | {"attractors": [ATTRACTOR | {"lifetime": 12.5, "lyapunov": None}], "plane": "contact"}
    basin = basin_dataset(aperiodic, JOB)
    assert "lyapunov" not in basin
    assert basin.lifetime.values.tolist() == [12.5]
    assert basin.row.attrs["long_name"].startswith("elongation")
    assert basin.column.attrs["long_name"].startswith("velocity")


def place(id: int, fraction: float, **more: Any) -> dict[str, Any]:
    return {"id": id, "label": f"({id},1)", "fraction": fraction, "longest_flight": 5.0, **more}


PLANE: dict[str, Any] = {
    "omega": [0.5], "gamma": [1.0, 1.2, 1.4], "xi": 0.26, "count": [[2, 1, None]],
    "cells": [[[place(1, 0.75), place(2, 0.25)], [place(1, 1.0)], []]],
    "attractors": [{"id": 1, "label": "(1,1)", "cells": 2}, {"id": 2, "label": "(2,1)", "cells": 1}],
    "events": [
        {"kind": "death", "attractor": 2, "omega": 0.5, "gamma_below": 1.0, "gamma_above": 1.2,
         "below": "(2,1)", "above": None, "leads_to": None},
    ],
    "several": 0.5, "several_by_drops": None, "complete": False,
}  # fmt: skip


def test_cells_with_fewer_attractors_are_filled():
    plane = multistability_dataset(PLANE, JOB)
    assert plane["count"].values.tolist() == [[2, 1, -1]]
    assert plane.id.values.tolist() == [[[1, 2], [1, 0], [0, 0]]]
    assert plane.label.values.tolist() == [[["(1,1)", "(2,1)"], ["(1,1)", ""], ["", ""]]]
    assert nan_as_none(plane.fraction) == [0.75, 0.25, 1.0, None, None, None]
    assert "flight_time" not in plane
    assert plane.cells.values.tolist() == [2, 1]
    assert plane.attractor.values.tolist() == [1, 2]
    assert (plane.leads_to.values.tolist(), plane.above.values.tolist()) == ([0], [""])
    assert plane.event_attractor.values.tolist() == [2]
    assert (plane.attrs["several"], plane.attrs["complete"]) == (0.5, 0)
    assert np.isnan(plane.attrs["several_by_drops"])


BRANCH: dict[str, Any] = {
    "bounces": 1, "periods": 1, "word": "s", "gamma": [1.0, 2.0], "flight_time": [[4.0], [5.0]],
    "takeoff_phase": [[0.5], [0.25]], "impact_velocity": [[-1.0], [-2.0]],
    "multipliers": [[[0.5, 0.25], [0.5, -0.25]], [[2.0, 0.0], [0.125, 0.0]]], "stable": [True, False],
    "admissible": [0, 4],
}  # fmt: skip
SHORT = BRANCH | {
    "gamma": [3.0], "flight_time": [[6.0]], "takeoff_phase": [[0.0]], "impact_velocity": [[-3.0]],
    "multipliers": [], "stable": [True], "admissible": [1],
}  # fmt: skip
WORDS: dict[str, Any] = {
    "omega": 0.5, "xi": 0.05, "direction": "up", "branches": [BRANCH, SHORT], "events": [], "skipped": [],
    "complete": True,
}  # fmt: skip


def test_points_beyond_the_end_of_a_branch_are_told_apart():
    words = words_dataset(WORDS, JOB)
    assert words.points.values.tolist() == [2, 1]
    assert words.stable.values.tolist() == [[True, False], [True, False]]
    assert words.admissible.values.tolist() == [[0, 4], [1, MISSING_POINT]]
    assert words.multiplier.values[0].tolist() == [0.5 + 0.25j, 2.0]
    assert words.other_multiplier.values[0].tolist() == [0.5 - 0.25j, 0.125]
    assert np.isnan(words.multiplier.values[1]).all()
    assert nan_as_none(words.flight_time) == [4.0, 5.0, 6.0, None]
    assert "plate_contact" not in words


def test_a_short_answer_that_asks_for_much_memory_is_refused():
    huge = BRANCH | {"bounces": 10**10}
    uneven = BRANCH | {"gamma": [1.0] * 11_000}
    cells = [[[place(1, 1.0)] * 11_000] + [[]] * 11_000]
    for read in (
        lambda: words_dataset(WORDS | {"branches": [huge]}, JOB),
        lambda: words_dataset(WORDS | {"branches": [uneven] + [SHORT] * 11_000}, JOB),
        lambda: multistability_dataset(PLANE | {"cells": cells}, JOB),
    ):
        with pytest.raises(UnexpectedAnswer, match="values; at most 100,000,000 are read"):
            read()
