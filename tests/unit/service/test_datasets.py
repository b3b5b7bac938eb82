"""Answers as Datasets: what is missing, unfinished or empty, on answers made for it."""

from typing import Any

import numpy as np
import pytest

from service.client import UnexpectedAnswer
from service.client.datasets import (
    MISSING_POINT,
    diagram_dataset,
    modes_dataset,
    multistability_dataset,
    orbits_dataset,
    threshold_dataset,
    thresholds_dataset,
    words_dataset,
)

JOB = "0" * 32


def nan_as_none(values: Any) -> Any:
    return [None if np.isnan(value) else value for value in np.asarray(values).ravel().tolist()]


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


def test_a_line_of_cells_has_flights_at_every_place():
    first, second = place(1, 0.75, flight_time=[5.0]), place(2, 0.25, flight_time=[1.0, 2.0])
    line = multistability_dataset(PLANE | {"cells": [[[first, second], [first], []]]}, JOB)
    assert line.flight_time.dims == ("omega", "gamma", "place", "flight")
    assert nan_as_none(line.flight_time) == [5.0, None, 1.0, 2.0, 5.0] + [None] * 7


def test_no_cells_are_no_answer():
    with pytest.raises(UnexpectedAnswer, match="not multistability"):
        multistability_dataset(PLANE | {"omega": [], "cells": [], "count": []}, JOB)


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


ENERGY = ("plate_contact", "plate_impact", "dashpot", "impact", "force", "impulse", "weight")


def test_one_branch_has_its_energy():
    branch = BRANCH | {"energy": {name: [1.0, 2.0] for name in ENERGY}}
    words = words_dataset(WORDS | {"branches": [branch]}, JOB)
    assert words.dashpot.values.tolist() == [[1.0, 2.0]]


def test_no_branches_are_empty():
    words = words_dataset(WORDS | {"branches": []}, JOB)
    assert words.sizes == {"branch": 0, "point": 0, "flight": 0, "event": 0, "cell": 0}
    orbits = orbits_dataset({"omega": 0.5, "xi": 0.05, "branches": [], "events": []})
    assert orbits.sizes == {"branch": 0, "point": 0, "event": 0}


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


SPRING: dict[str, Any] = {
    "omega": 0.5, "xi": 0.05, "threshold": 0.75, "jump": None, "down": 0.5, "cause": "fold (1,1)",
    "reason": None, "lifetime": {"delta": 1e-6, "periods": 100.0},
    "energy": dict.fromkeys(ENERGY, 1.5),
}  # fmt: skip


def test_the_thresholds_of_a_spring_that_there_are_and_are_not():
    some = thresholds_dataset(SPRING)
    assert [float(some[name]) for name in ("threshold", "down", "lifetime", "delta", "impact")] == [
        *(0.75, 0.5, 100.0, 1e-6, 1.5),
    ]
    assert np.isnan(some.jump)
    assert (some.cause.item(), some.reason.item()) == ("fold (1,1)", "")
    none = {"threshold": None, "down": None, "cause": None, "reason": "why", "lifetime": None, "energy": None}
    never = thresholds_dataset(SPRING | none)
    assert float(never.threshold) == np.inf
    assert all(np.isnan(never[name]) for name in ("down", "lifetime", "delta", *ENERGY))
    assert (never.cause.item(), never.reason.item()) == ("", "why")


LINE: dict[str, Any] = {
    "along": "gamma", "values": [1.0, 2.0], "fixed": {"omega": 0.5, "xi": 0.26}, "direction": "rest",
    "flight_time": [[], [5.0]], "takeoff_phase": [[], [1.0]], "flights": [0, 1], "outcome": [3, 1],
    "bounces": [0, 1], "periods": [0, 1], "min_flight": 0.0, "complete": True,
}  # fmt: skip


def test_a_diagram_has_what_its_sweep_has():
    plain = diagram_dataset(LINE, JOB, "mine")
    assert not {"label", "lyapunov", "computed"} & set(plain.variables)
    assert nan_as_none(plain.flight_time) == [None, 5.0]
    assert (plain.attrs["job"], plain.attrs["title"]) == (JOB, "bifurcation diagram: mine")
    told = diagram_dataset(
        LINE | {"label": [3, 1], "lyapunov": [[None], [-0.5]], "computed": [0, 1]}, JOB, ""
    )
    assert told.computed.values.tolist() == [0, 1]
    assert nan_as_none(told.lyapunov) == [None, -0.5]


def test_thresholds_and_maps_have_what_was_asked_for():
    asked = {name: [None] for name in ("analytic", "up", "down", "predicted_jump", "predicted_down")}
    texts = {name: [""] for name in ("up_status", "down_status", "cause", "difference")}
    given = {"omega": [0.5], "xi": 0.26, "prediction": "some", "complete": True, **asked, **texts}
    plain = threshold_dataset(given, JOB)
    assert "up_computed" not in plain
    assert "tolerance" not in plain.attrs
    told = threshold_dataset(given | {"up_computed": [True], "tolerance": 1e-3}, JOB)
    assert told.up_computed.values.tolist() == [True]
    assert told.attrs["tolerance"] == 1e-3
    counts = {name: [[1, 1]] for name in ("outcome", "bounces", "periods")}
    plane = {"omega": [0.5], "gamma": [1.0, 2.0], "xi": 0.26, "direction": "up", "min_flight": 0.0}
    plain = modes_dataset({**plane, **counts, "complete": True}, JOB)
    assert set(plain.data_vars) == {"outcome", "bounces", "periods"}
    assert "computed" not in plain.attrs
    adaptive = {"mask": [[1, 0]], "computed": 0.5, "label": [[1, 1]], "hysteresis": [[0, 2]]}
    told = modes_dataset({**plane, **counts, **adaptive, "complete": True}, JOB)
    assert told.computed.values.tolist() == [[1, 0]]
    assert told.attrs["computed"] == 0.5
    assert told.hysteresis.values.tolist() == [[0, 2]]
