"""What the commands print and write: tables, CSV and JSON of results that are made up here."""

import csv
import json
from io import StringIO
from typing import Any, cast

import numpy as np
import pytest
import xarray
from tables import for_each

from service.cli import orbits, results
from service.cli.output import (
    as_json,
    estimate_line,
    job_report,
    job_table,
    jobs_live,
    modes_csv,
    modes_json,
    threshold_table,
    threshold_view,
    trajectory_csv,
    trajectory_json,
)
from service.cli.tradeoff import report
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


def test_json_is_indented_and_shows_every_letter():
    assert as_json({"name": "ω"}) == '{\n  "name": "ω"\n}'


def test_a_table_of_jobs_has_one_line_for_each():
    heading, first, second = job_table([job(), job(state="queued", percent=0.0, name="")]).splitlines()
    assert heading.split() == ["ID", "STATE", "DONE", "CELLS", "NAME"]
    assert first == "0123456789abcdef0123456789abcdef  running     50%         24,000  ω sweep"
    assert second == "0123456789abcdef0123456789abcdef  queued       0%         24,000"


def test_jobs_that_are_watched_show_the_time_that_is_left():
    from rich.console import Console

    console = Console(width=120, file=StringIO(), record=True)
    console.print(jobs_live([job()]))
    heading, line = console.export_text().splitlines()
    assert heading.split() == ["ID", "STATE", "DONE", "CELLS", "LEFT", "NAME"]
    assert heading.startswith("ID")  # as wide as what is in it: a terminal may be narrow
    bar = "━" * 12
    assert line.split() == ["01234567", "running", bar, "50%", "24,000", "2", "min", "5", "s", "ω", "sweep"]
    for title, text in (("DONE", "50%"), ("CELLS", "24,000")):  # numbers end below the end of their title
        assert heading.index(title) + len(title) == line.index(text) + len(text)
    for title, text in (("ID", "01234567"), ("STATE", "running"), ("LEFT", "2 min"), ("NAME", "ω sweep")):
        assert heading.index(title) == line.index(text)


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


@for_each(
    ("tolerance", "number"),
    [(0.5, "0.512346"), (1e-4, "0.512346"), (1e-5, "0.5123457"), (3e-8, "0.5123456789"),
     (1e-12, "0.512345678901")],
)  # fmt: skip
def test_refined_thresholds_have_the_digits_of_their_tolerance(tolerance: float, number: str):
    found = thresholds(tolerance=tolerance)
    heading, titles, _, line, *_ = threshold_table(found, found, SWEEP).splitlines()
    assert heading == f"xi = 0.26, to {tolerance:g} in gamma"
    assert line.split()[3] == number
    assert len(titles) == len(line) == 5 * (len(number) - 2 + 6)


def test_thresholds_as_json_have_null_for_what_is_not_known():
    view = threshold_view(thresholds(tolerance=1e-3))
    assert json.loads(json.dumps(view, allow_nan=False)) == {
        "xi": 0.26, "omega": [0.5, 0.7], "analytic": [0.6123456789, None], "up": [0.75, None],
        "down": [None, 0.5123456789012], "predicted_jump": [None, 0.9],
        "predicted_down": [0.7123456789, None],
        "up_status": ["found", "missing"], "down_status": ["not ramped", "found"],
        "cause": ["fold (1,1)", "unresolved by the closed form"], "difference": ["", "another cycle"],
        "prediction": "rigid", "tolerance": 1e-3, "complete": True,
    }  # fmt: skip
    assert threshold_view(thresholds(complete=0))["tolerance"] is None
    assert threshold_view(thresholds(complete=0))["complete"] is False


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


def test_a_mode_map_as_json_has_the_axes_and_a_plane_for_each_variable():
    assert json.loads(modes_json(mode_map(hysteresis=[[0, 2]]))) == {
        "xi": 0.26, "direction": "up", "omega": [0.5], "gamma": [1.0, 1.5], "outcome": [[1, 3]],
        "bounces": [[2, 0]], "periods": [[4, 0]], "hysteresis": [[0, 2]], "min_flight": 0.05,
        "complete": False,
    }  # fmt: skip


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


# Attractors


def test_the_attractors_of_a_cell_are_a_line_each():
    columns = {
        "fraction": [0.75, 0.25], "longest_flight": [7.9559, 11.24674], "lifetime": [np.inf, 1234.5],
        "label": ["(3,4)", "aperiodic"],
    }  # fmt: skip
    numbers = {"undecided": 0.0625, "basin_entropy": 0.5, "boundary_entropy": NAN}
    cell = xarray.Dataset(
        {name: ("id", values) for name, values in columns.items()} | numbers, {"id": [1, 2]}
    )
    assert results._attractors(cell).splitlines() == [
        " ID     SHARE  LONGEST FLIGHT    LIFETIME  ATTRACTOR",
        "  1    0.7500       7.9559000           -  (3,4)",
        "  2    0.2500      11.2467400        1234  aperiodic",
        "undecided 0.0625, basin entropy 0.5000, boundary entropy nan",
    ]


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


def spring(**changes: Any) -> xarray.Dataset:
    values = {
        "threshold": 0.25, "jump": NAN, "down": 0.2, "cause": "fold (1,1)", "reason": "", "lifetime": 3485.4,
        "delta": 1e-6,
    }  # fmt: skip
    return xarray.Dataset({**values, **changes}, {"omega": 0.6, "xi": 0.05})


def test_the_thresholds_of_a_spring_are_a_line_each():
    assert orbits.threshold_text(spring()).splitlines() == [
        "omega 0.6, xi 0.05: rigid contact without restitution",
        "rest ends on the way up     0.250000000  Eq. 25",
        "flights leap on the way up            -",
        "nothing bounces below       0.200000000  fold (1,1)",
        "1e-06 below the fold bouncing lives 3,485 periods",
    ]
    for cause in ("unresolved", "not searched"):
        undecided = spring(down=NAN, lifetime=NAN, cause=cause, reason="the branch ends")
        assert orbits.threshold_text(undecided).splitlines()[3:] == [
            f"nothing bounces below                 -  {cause}", f"{cause}: the branch ends"
        ]  # fmt: skip


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


def test_every_point_of_a_branch_is_a_row(tmp_path: Any):
    orbits._write(branches(), "branch", "csv", str(tmp_path / "a.csv"))
    rows = list(csv.reader(StringIO((tmp_path / "a.csv").read_text())))
    assert rows == [
        ["branch", "word", "gamma", "flight_time_1", "flight_time_2", "multiplier_re", "multiplier_im"],
        ["0", "s", "1.0", "4.0", "5.0", "0.5", "0.25"],
        ["0", "s", "1.5", "4.5", "5.5", "-1.0", "0.0"],
        ["1", "ss", "2.0", "6.0", "nan", "0.0", "2.0"],
    ]


def test_events_are_printed_in_columns(capsys: pytest.CaptureFixture[str]):
    orbits._write(branches(), "branch", None, None)
    assert capsys.readouterr().out.splitlines() == [
        "EVENT           MODE    GAMMA          OMEGA         XI            FLIGHT TIME    ADMISSIBLE",
        "fold            (1,1)   0.5532445929   0.6000000000  0.0500000000  4.5000000000   yes",
        "neimark-sacker  (2,10)  12.0000000000  0.6000000000  0.0500000000  10.2500000000  no",
    ]


def test_a_dataset_as_plain_values_has_null_and_two_parts_of_complex_numbers():
    plain = orbits.plain(branches())
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    assert plain["gamma"] == [[1.0, 1.5], [2.0, None]]
    assert plain["multiplier"] == [[[0.5, 0.25], [-1.0, 0.0]], [[0.0, 2.0], [None, 0.0]]]
    assert (plain["omega"], plain["event_periods"]) == (0.6, [1, 10])


# Cost and accuracy


def measurement(**changes: Any) -> dict[str, Any]:
    return {
        "purpose": "adhesive", "model": "soft", "penetration": 0.001, "adhesive": True,
        "steps_per_contact": None, "scheme": None, "locked_only": False, "cost": 2.3288, "cost_most": 4.3395,
        "error": 0.0, "error_95": 0.0, "agree": 1.0, **changes,
    }  # fmt: skip


def test_the_table_of_models_has_a_part_for_each_reference():
    rows = [
        measurement(),
        measurement(model="stepped", steps_per_contact=20, scheme="verlet", error=4.07e-4, error_95=0.0142,
                    agree=0.914, cost=131.003, cost_most=131.9),
        measurement(model="soft", adhesive=False, purpose="nonadhesive", error=1.0, error_95=0.5),
        measurement(model="rigid", purpose="nonadhesive", penetration=None, adhesive=None, cost=None,
                    cost_most=None, error=None, error_95=None),
        measurement(model="ball", purpose="nonadhesive", penetration=None, locked_only=True, error=0.0),
        measurement(model="ball", purpose="nonadhesive", penetration=None, error=0.0),
    ]  # fmt: skip
    references = {"adhesive": "exact soft contact", "nonadhesive": "hard plate"}
    heading = " " * 36 + "        µs    max µs     error       95%      mode"
    expected = [
        "Errors relative to the exact soft contact", heading,
        "                     soft, d = 0.001      2.33      4.34     exact     exact      100%",
        "        stepped 20 verlet, d = 0.001       131       132   4.1e-04   1.4e-02       91%",
        "",
        "Errors relative to the hard plate", heading,
        "        soft, d = 0.001, nonadhesive      2.33      4.34   1.0e+00   5.0e-01      100%",
        "                               rigid   refused   refused         -         -      100%",
        "     ball, e = f(xi), locked dashpot      2.33      4.34   0.0e+00   0.0e+00      100%",
        "                     ball, e = f(xi)      2.33      4.34   0.0e+00   0.0e+00      100%",
        "",
    ]  # fmt: skip
    text = report({
        "rows": rows, "references": references, "cells": 80, "periods": 300, "micro_flight": 0.05,
        "advice": "Take rigid.",
    }).splitlines()  # fmt: skip
    assert text[: len(expected)] == expected
    assert text[-2:] == ["", "Take rigid."]
    assert "share of all 80 cells" in text[-3]
    assert "300 periods from rest, flights over 0.05 rad" in text[-3]
