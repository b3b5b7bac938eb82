"""What the commands print and write: tables, CSV and JSON of results that are made up here."""

from typing import Any, cast

import numpy as np
import pytest
import xarray

from service.cli.output import (
    estimate_line,
    job_report,
    threshold_table,
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


# Thresholds of a sweep

SWEEP = {"gamma": {"start": 0.5, "stop": 2.0, "num": 4}, "omega": [0.5, 0.7], "xi": 0.26}


def thresholds(**attributes: Any) -> xarray.Dataset:
    columns = {
        "analytic": [0.6123456789, np.inf], "up": [0.75, NAN], "down": [NAN, 0.5123456789012],
        "predicted_jump": [NAN, 0.9], "predicted_down": [0.7123456789, NAN],
        "up_status": ["found", "missing"], "down_status": ["not ramped", "found"],
        "cause": ["fold (1,1)", "unresolved by the closed form"], "difference": ["", "another cycle"],
    }  # fmt: skip
    return xarray.Dataset(
        {name: ("omega", values) for name, values in columns.items()},
        {"omega": [0.5, 0.7], "xi": 0.26},
        {"complete": 1, "prediction": "rigid", **attributes},
    )


def test_thresholds_stand_in_columns_with_what_explains_them_below():
    found = thresholds()
    assert threshold_table(found, found, SWEEP).splitlines() == [
        "xi = 0.26, on the grid of gamma",
        "       OMEGA      EQ. 25          UP        DOWN   PREDICTED",
        "    0.500000    0.612346    0.750000           -    0.712346",
        "    0.700000         inf           ?    0.512346  unresolved",
        "?: the cell that decides is not computed yet",
        "-: the sweep is not ramped down",
        "PREDICTED: the lowest that bounces by the closed form, rigid",
        "omega 0.7: another cycle",
    ]
    found = thresholds(complete=0)
    last = threshold_table(found, found, SWEEP).splitlines()[-1]
    assert last == "the job is not done: thresholds may be missing"


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
