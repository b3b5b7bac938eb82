"""What the commands print and write: tables, CSV and JSON of results that are made up here."""

import json
from typing import Any, cast

import numpy as np
import pytest
import xarray

from service.cli import results
from service.cli.output import (
    estimate_line,
    job_report,
    modes_csv,
    trajectory_csv,
    trajectory_json,
)
from service.client import Job
from service.client.models import Estimate

NAN = np.nan


# Jobs


def job(**changes: Any) -> Job:
    """A running job; `changes` of its progress, or of itself."""
    progress = {
        "chunks_done": 1_500, "chunks_total": 3_000, "cells_done": 12_000, "cells_total": 24_000,
        "cells_settling": 0, "percent": 50.0, "eta_seconds": 125.0,
    }  # fmt: skip
    view = {"id": "0123456789abcdef" * 2, "name": "ω sweep", "state": "running", "error": None}
    view |= {name: value for name, value in changes.items() if name not in progress}
    progress |= {name: value for name, value in changes.items() if name in progress}
    return Job.from_view(cast(Any, None), {**view, "progress": progress})


def test_the_report_of_a_job_has_a_line_for_everything_that_is_known():
    lines = job_report(job(owner="ana", created="2026-01-01T00:00:00Z", cells_settling=7)).splitlines()
    assert lines == [
        "id        0123456789abcdef0123456789abcdef",
        "name      ω sweep",
        "state     running",
        "progress  50% (12,000 of 24,000 cells, 1,500 of 3,000 chunks), 2 min 5 s left",
        "settling  7 of 12,000 cells were still settling: give them more time with settle_until "
        "(plate periods)",
        "owner     ana",
        "created   2026-01-01T00:00:00Z",
    ]


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({}, "1,200 cells in 30 chunks, 2.5 MB before compression, about 6 s on 2 workers (12 core-seconds, "
             "from the table of costs; the kernel is compiled first, unless the cache has it)"),
        (
            {"basis": "measured", "core_seconds": 2_050.0, "bytes": 1_040_000_000,
             "longest_core_seconds": 345_600.0},
            "1,200 cells in 30 chunks, 1 GB before compression, about 17 min on 2 workers "
            "(2,050 core-seconds, from recent jobs; 2 days if every cell settled until settle_until)",
        ),
        (
            {"computed_cells": (300, 1_100), "least_core_seconds": 3.0, "basis": "measured", "chunks": 1},
            "1,200 cells, of which about 300 to 1,100 are computed, in 1 chunk, at most 2.5 MB before "
            "compression, about 3 s to 12 s on 2 workers (12 core-seconds, from recent jobs)",
        ),
        (
            {"workers": 0, "core_seconds": 0.5, "basis": "measured"},
            "1,200 cells in 30 chunks, 2.5 MB before compression, about 1 s on one core "
            "(0.5 core-seconds, from recent jobs)",
        ),
    ],
)  # fmt: skip
def test_an_estimate_is_one_line(changes: dict[str, Any], line: str):
    fields = {
        "cells": 1_200,
        "chunks": 30,
        "bytes": 2_500_000,
        "core_seconds": 12.0,
        "basis": "table",
        "workers": 2,
    }
    estimate = Estimate(**{**fields, "longest_core_seconds": None, **changes})
    assert estimate_line(estimate) == line


# Cells and samples


def mode_map(**more: Any) -> xarray.Dataset:
    planes = {"outcome": [[1, 3]], "bounces": [[2, 0]], "periods": [[4, 0]], **more}
    found = xarray.Dataset(
        {name: (("omega", "gamma"), plane) for name, plane in planes.items()},
        {"omega": [0.5], "gamma": [1.0, 1.5], "xi": 0.26, "direction": "up"},
        {"complete": 0, "min_flight": 0.05},
    )
    found.outcome.attrs["flag_meanings"] = "missing periodic aperiodic at_rest"
    if "hysteresis" in found:
        found.hysteresis.attrs["flag_meanings"] = "none mode flights"
    return found


def test_a_mode_map_is_a_row_for_each_cell():
    assert modes_csv(mode_map()) == (
        b"omega,gamma,outcome,bounces,periods\n0.5,1.0,periodic,2,4\n0.5,1.5,at_rest,0,0\n"
    )
    assert modes_csv(mode_map(hysteresis=[[0, 2]])) == (
        b"omega,gamma,outcome,bounces,periods,hysteresis\n"
        b"0.5,1.0,periodic,2,4,none\n0.5,1.5,at_rest,0,0,flights\n"
    )


def test_a_motion_is_a_row_for_each_sample():
    samples = {
        "plate": [0.0, 1.0], "z1": [2.0, NAN], "z2": [1.0, NAN], "force": [0.5, NAN],
        "in_flight": [True, False],
    }  # fmt: skip
    flights = {"takeoff": [7.0], "takeoff_phase": [0.75], "flight_time": [4.5]}
    motion = xarray.Dataset(
        {name: ("phase", values) for name, values in samples.items()}
        | {name: ("flight", values) for name, values in flights.items()},
        {"phase": [0.0, 0.1]},
        {"complete": 1, "rest_length": 1e4},
    )
    assert trajectory_csv(motion).decode().splitlines() == [
        "phase,plate,z1,z2,force,in_flight", "0.0,0.0,2.0,1.0,0.5,1.0", "0.1,1.0,nan,nan,nan,0.0"
    ]  # fmt: skip
    assert json.loads(trajectory_json(motion)) == {
        "rest_length": 1e4, "complete": True, "phase": [0.0, 0.1], "plate": [0.0, 1.0], "z1": [2.0, None],
        "z2": [1.0, None], "force": [0.5, None], "in_flight": [True, False], "flights": flights,
    }  # fmt: skip


def test_the_attractors_over_a_grid_are_a_line_each():
    plane = xarray.Dataset(
        {
            "cells": ("attractor", [10, 2]), "attractor_label": ("attractor", ["(1,2)", "rest"]),
            "kind": ("event", ["mode", "birth", "mode", "mode", "death", "death"]),
        },
        {"attractor": [1, 2]},
        {"several": 0.25, "several_by_drops": 0.125},
    )  # fmt: skip
    assert results._over_a_grid(plane).splitlines() == [
        "  ID    CELLS  MOSTLY",
        "   1       10  (1,2)",
        "   2        2  rest",
        "cells with two attractors or more: 0.2500, reached by drops 0.1250",
        "births 1, deaths 2, changes of mode 3",
    ]


# Cycles in closed form


def branches() -> xarray.Dataset:
    """Two branches of two flights, of which the second has one point."""
    return xarray.Dataset(
        {
            "gamma": (("branch", "point"), [[1.0, 1.5], [2.0, NAN]]),
            "flight_time": (("branch", "point", "flight"), [[[4.0, 5.0], [4.5, 5.5]],
                                                            [[6.0, NAN], [NAN, NAN]]]),
            "multiplier": (("branch", "point"), [[0.5 + 0.25j, -1.0 + 0j], [2j, NAN]]),
            "event_kind": ("event", ["fold", "neimark-sacker"]),
            "event_bounces": ("event", [1, 2]), "event_periods": ("event", [1, 10]),
            "event_gamma": ("event", [0.5532445929, 12.0]), "event_omega": ("event", [0.6, 0.6]),
            "event_xi": ("event", [0.05, 0.05]), "event_flight_time": ("event", [4.5, 10.25]),
            "event_admissible": ("event", [0, 2]),
        },
        {"word": ("branch", ["s", "ss"]), "omega": 0.6},
    )  # fmt: skip


# Cost and accuracy
