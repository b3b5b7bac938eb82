"""`dataset.bounce`: flights as a table, and plots of results that are Datasets already."""

import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure
from tables import for_each

from bouncing_spring import BounceError, Ramp, Range, Rigid, SweepSpec
from service.local import run

SPEC = SweepSpec(
    gamma=Range(start=0.4, stop=1.2, num=9), omega=(0.56, 0.6), xi=0.05, model=Rigid(),
    protocol=Ramp(axis="gamma", direction="both"), settle=40, observe=20,
)  # fmt: skip


@pytest.fixture(scope="module")
def sweep() -> xarray.Dataset:
    return run(SPEC, progress=False)


def test_a_row_per_flight(sweep: xarray.Dataset):
    table = sweep.bounce.to_dataframe()
    assert list(table.columns) == [
        "gamma", "omega", "xi", "direction", "flight", "flight_time", "takeoff_phase", "outcome", "bounces",
        "periods",
    ]  # fmt: skip
    assert len(table) == int(np.isfinite(sweep.flight_time).sum()) == int(sweep.flights.clip(max=64).sum())
    one = table[(table.gamma == 1.2) & (table.omega == 0.6) & (table.direction == "down")]
    cell = sweep.sel(gamma=1.2, omega=0.6, xi=0.05, direction="down")
    assert one.flight.tolist() == list(range(len(one)))
    np.testing.assert_array_equal(one.flight_time, cell.flight_time[: len(one)])
    np.testing.assert_array_equal(one.takeoff_phase, cell.takeoff_phase[: len(one)])
    assert set(one.bounces) == {int(cell.bounces)}
    assert set(table.outcome) <= {"periodic", "aperiodic", "settling"}


def test_a_line_of_a_sweep_is_a_diagram(sweep: xarray.Dataset):
    ax = sweep.bounce.plot(omega=0.61, direction="down", ax=Figure().subplots())
    drawn = ax.lines[0].get_xydata()
    line = sweep.sel(omega=0.6, direction="down").squeeze("xi")
    times = line.flight_time.values
    np.testing.assert_array_equal(drawn[:, 1], times[np.isfinite(times)])
    assert r"$\Omega$ = 0.6" in ax.get_title()


def test_a_notebook_shows_a_plot(sweep: xarray.Dataset, monkeypatch: pytest.MonkeyPatch):
    from matplotlib import pyplot

    pyplot.close("all")  # those that other tests left
    monkeypatch.delitem(sys.modules, "matplotlib.pyplot")
    sweep.bounce.plot(omega=0.6)
    assert not pyplot.get_fignums()
    monkeypatch.setitem(sys.modules, "ipykernel", ModuleType("ipykernel"))
    drawn = [sweep.bounce.plot(omega=omega) for omega in (0.6, 0.7)]
    assert [axes.figure for axes in drawn] == [pyplot.figure(number) for number in pyplot.get_fignums()]
    assert sweep.bounce.plot(omega=0.6, ax=drawn[0]) is drawn[0]
    pyplot.close("all")


def test_a_plane_of_a_sweep_is_a_map(sweep: xarray.Dataset):
    """By modes, also where cells have margins of stability."""
    certified = sweep.assign(multiplier=0.5 * sweep.outcome)
    ax = certified.bounce.plot(direction="up", ax=Figure().subplots())
    assert "(bounces, plate periods) of a cycle" in ax.get_title()
    (mesh,) = ax.collections
    assert mesh.get_array().shape == (2, 9)


def test_branches_are_drawn_over_a_line_if_they_are_given(sweep: xarray.Dataset):
    grid = ("branch", "point")
    values = {"gamma": [[0.6, 1.0]], "flight_time": [[1.0, 2.0]], "stable": [[1, 1]], "violations": [[0, 0]]}
    arrays = {name: (grid, np.array(each)) for name, each in values.items()}
    branches = xarray.Dataset(arrays, {"omega": 0.6, "xi": 0.05}, {"model": "rigid"})
    line = sweep.sel(omega=0.6, direction="down").squeeze("xi")
    plain, over = (line.bounce.plot(ax=Figure().subplots(), branches=each) for each in (None, branches))
    assert len(over.lines) == len(plain.lines) + 3
    with pytest.raises(BounceError, match=r"branches: are of omega 0\.7, the diagram of 0\.6"):
        line.bounce.plot(ax=Figure().subplots(), branches=branches.assign_coords(omega=0.7))
    with pytest.raises(BounceError, match="branches: are along omega, the diagram along gamma"):
        line.bounce.plot(ax=Figure().subplots(), branches=branches.assign_attrs(along="omega"))
    for kind, given in ((sweep.sel(direction="down"), branches), (branches, branches), (line, True)):
        with pytest.raises(BounceError, match="branches: are a Dataset of orbits, drawn over a diagram"):
            kind.bounce.plot(ax=Figure().subplots(), branches=given)
    with pytest.raises(BounceError, match="data: is drawn over a diagram or thresholds"):
        branches.bounce.plot(ax=Figure().subplots(), data={"gamma": [0.6], "flight_time": [1.0]})


@for_each(("where", "message"), [
    ({}, r"select of direction \(2 values\), omega \(2 values\), gamma \(9 values\)"),
    ({"direction": "sideways"}, "direction must be one of up, down, not 'sideways'"),
    ({"speed": 1.0}, "speed is no axis"),
    ({"omega": 0.6, "direction": "up", "xi": 0.05, "gamma": 1.0}, "select of $"),
])  # fmt: skip
def test_what_to_select_is_said(sweep: xarray.Dataset, where: dict[str, Any], message: str):
    with pytest.raises(BounceError, match=message):
        sweep.bounce.plot(**where)


def test_a_study_without_directions_is_refused():
    basin = {"kind": "basin", "rows": 1, "columns": 2}
    cell = {"gamma": [2.3, 3.6], "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"}, "settle": 40}
    study = run({**cell, "protocol": basin}, progress=False)
    for line in (study, study.isel(xi=0, omega=0, id=0)):
        for method in (line.bounce.to_dataframe, line.bounce.plot):
            with pytest.raises(BounceError, match="is of a diagram"):
                method()
