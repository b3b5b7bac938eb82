"""What the commands print of jobs and estimates that are made up here."""

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import xarray
from click.testing import CliRunner

from service.cli.main import main
from service.cli.options import _message
from service.cli.output import estimate_line, job_report
from service.cli.views import table
from service.client import Job
from service.client.models import Estimate

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
    return Job(cast(Any, None), {**view, "progress": progress})


def test_the_report_of_a_job_has_a_line_for_everything_that_is_known():
    known = {"owner": "ana", "created": "2026-01-01T00:00:00Z", "choice": {"reason": "rigid: the cheapest"}}
    lines = job_report(job(cells_settling=7, **known)).splitlines()
    assert lines == [
        "id        0123456789abcdef0123456789abcdef",
        "name      ω sweep",
        "state     running",
        "progress  50% (12,000 of 24,000 cells, 1,500 of 3,000 chunks), 2 min 5 s left",
        "settling  7 of 12,000 cells still settling: with settle auto, a larger until gives them time",
        "model     rigid: the cheapest",
        "owner     ana",
        "created   2026-01-01T00:00:00Z",
    ]


@pytest.mark.parametrize(("changes", "line"), [
    ({}, "1,200 cells in 30 chunks, 2.5 MB before compression, about 6 s on 2 workers "
         "(12.0 core-seconds, from the table of costs; the kernel is compiled first, "
         "unless the cache has it)"),
    (
        {"basis": "measured", "core_seconds": 2_050.0, "bytes": 1_040_000_000,
         "longest_core_seconds": 345_600.0},
        "1,200 cells in 30 chunks, 1.0 GB before compression, about 17 min 5 s on 2 workers "
        "(2,050.0 core-seconds, from a sample of the study; up to 48 h 0 min if every cell were a "
        "slow one)",
    ),
    (
        {"computed_cells": (300, 1_100), "least_core_seconds": 3.0, "basis": "measured", "chunks": 1},
        "1,200 cells, of which about 300 to 1,100 are computed, in 1 chunk, at most 2.5 MB before "
        "compression, about 3 s to 12 s on 2 workers (12.0 core-seconds, from a sample of the study)",
    ),
    (
        {"workers": 0, "core_seconds": 0.5, "basis": "measured"},
        "1,200 cells in 30 chunks, 2.5 MB before compression, about 1 s on one core "
        "(0.5 core-seconds, from a sample of the study)",
    ),
])  # fmt: skip
def test_an_estimate_is_one_line(changes: dict[str, Any], line: str):
    fields: dict[str, Any] = {
        "cells": 1_200, "chunks": 30, "bytes": 2_500_000, "core_seconds": 12.0, "basis": "table",
        "workers": 2, "longest_core_seconds": None,
    }  # fmt: skip
    estimate = Estimate(**fields | changes)
    assert estimate_line(estimate) == line


def test_a_table_fits_the_terminal():
    """Texts of one value and long ones stand below it; then numbers have fewer digits."""
    columns: dict[str, Any] = {f"value_{i}": ("omega", np.array([0.123456789123, np.pi])) for i in range(7)}
    for name, texts in (("status", "found found"), ("cause", "fold flip"), ("why", f"no {'b' * 41}")):
        columns[name] = ("omega", texts.split())
    lines = table(xarray.Dataset(columns, {"omega": [0.5, 0.6]}), ["value_0"]).splitlines()
    assert max(map(len, lines)) <= 100
    assert lines[0].split() == ["omega", *(f"value_{i}" for i in range(7)), "cause"]
    assert lines[2].split()[1] == "3.14159265"
    assert lines[3:] == ["status  found", "omega 0.5: no", f"omega 0.6: {'b' * 41}"]


def test_a_table_tells_the_values_of_a_fine_axis_apart():
    flights = (("gamma", "flight"), np.full((2, 30), 1.0))
    result = xarray.Dataset({"flight_time": flights}, {"gamma": [2.3, 2.30000000005]})
    rows = [line.split()[0] for line in table(result, ["flight_time"]).splitlines()[1:]]
    assert set(rows) == {"2.3", "2.30000000005"}


def test_a_table_of_flights_has_their_exponents_and_one_without_rows_says_none():
    cells = {
        "flight_time": (("omega", "flight"), [[1.0, np.nan]]),
        "lyapunov": (("omega", "exponent"), [[0.1, -2]]),
    }
    result = xarray.Dataset(cells, {"omega": [0.5]})
    head, row = table(result, ["flight_time"]).splitlines()
    assert head.split() == ["omega", "flight", "flight_time", "lyapunov_1", "lyapunov_2"]
    assert row.split() == ["0.5", "0", "1", "0.1", "-2"]
    assert table(result.isel(omega=[]), ["flight_time"]).endswith(": none")


def test_text_in_place_of_a_number_is_told_so():
    for command in (["diagram", "ID", "--omega", "0,6"], ["trajectory", "--gamma", "0,6"]):
        assert "'0,6' is not a valid number." in CliRunner().invoke(main, command).output


def test_an_error_of_renaming_names_the_target(tmp_path: Path):
    results, target = tmp_path / "results", tmp_path / "target"
    results.mkdir()
    target.touch()
    with pytest.raises(NotADirectoryError) as raised:
        results.rename(target)
    assert _message(raised.value) == f"{target}: Not a directory"
