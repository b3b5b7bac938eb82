"""A job's results as plots: what is drawn by default, and hatches."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from studies import spec_of
from tables import for_each

from service.client import BounceError, Client, Job
from service.client.measured import element, measured
from service.pictures import AXES, DIFFER, FLIGHT, HATCH

RAMP = spec_of((0.5, 1.5, 21), [0.6, 0.9, 1.2], 0.05, ramp="both", window=(60, 20, 4))


@pytest.fixture(scope="module")
def job(python_client: Client) -> Job:
    return python_client.submit(RAMP).wait(progress=False)


@pytest.fixture
def ax() -> Axes:
    return Figure().subplots()


def test_what_is_drawn_by_default(job: Job, python_client: Client):
    assert job.plot().get_ylabel() == AXES["omega"]
    two = python_client.submit(RAMP | {"omega": [0.6, 0.7]}).wait(progress=False)
    assert two.plot().get_ylabel() == AXES["omega"]
    one = python_client.submit(RAMP | {"omega": 0.6, "gamma": 1.4, "protocol": {"kind": "rest"}})
    assert one.wait(progress=False).plot().get_xlabel() == AXES["gamma"]
    single = python_client.submit(RAMP | {"omega": 0.6}).wait(progress=False)
    assert single.plot(direction="down").get_ylabel() == "flight time (rad)"
    over_omega = python_client.submit(
        RAMP | {"gamma": 1.4, "protocol": {"kind": "rest"}, "omega": [0.6, 0.7, 0.8]}
    ).wait(progress=False)
    assert over_omega.plot().get_xlabel() == AXES["omega"]
    assert over_omega.plot(along="omega").get_xlabel() == AXES["omega"]
    assert job.plot("diagram", along="omega", gamma=1.5).get_xlabel() == AXES["omega"]
    assert job.plot(along="gamma", omega=0.6).get_ylabel() == job.plot(omega=0.6).get_ylabel() == FLIGHT
    measured = {"gamma": [1.5], "flight_time": [3.0]}
    assert job.plot(data=measured, omega=0.6).get_ylabel() == FLIGHT
    both = job.plot("diagram", omega=0.6, ax=Figure().subplots())
    assert both.get_legend_handles_labels()[1] == ["ramp up", "ramp down"]
    branches = job.plot("diagram", omega=0.6, branches=True, progress=True, ax=Figure().subplots())
    assert branches.get_legend_handles_labels()[1][2:] == ["stable cycle", "unstable cycle"]
    with pytest.raises(BounceError, match="kind: must be one of diagram, modes, threshold, orbits, "):
        job.plot("pie")  # type: ignore[arg-type]
    with pytest.raises(BounceError, match="are drawn in a diagram"):
        job.plot("modes", branches=python_client.orbits(0.6, 0.05, "1-1"))


def test_a_map_is_hatched_where_up_and_down_differ(job: Job, ax: Axes):
    differ = job.modes(hysteresis=True).hysteresis.values > 0
    assert differ.any()
    assert not differ.all()
    job.plot("modes", ax=ax)
    cells, hatched = ax.collections
    assert cells.get_hatch() is None
    assert hatched.get_hatch() == HATCH
    shown = hatched.get_array()
    assert np.array_equal(~np.ma.getmaskarray(shown).reshape(differ.shape), differ)
    legend = ax.get_legend()
    assert legend is not None
    assert legend.get_texts()[-1].get_text() == DIFFER
    plain = Figure().subplots()
    job.plot("modes", ax=plain, hysteresis=False)
    assert len(plain.collections) == 1


def test_a_return_map_has_each_flight_over_the_one_before(job: Job, ax: Axes):
    job.plot("return", gamma=1.4, omega=0.6, direction="down", ax=ax)
    flights = job.diagram(omega=0.6, direction="down").flight_time.sel(gamma=1.4).values
    pairs = np.stack([flights[:-1], flights[1:]])
    np.testing.assert_array_equal(ax.lines[0].get_data(), pairs[:, np.isfinite(pairs).all(axis=0)])
    for gamma, rule in ((None, "gamma: is required"), (9.0, "gamma: must not be above the axis")):
        with pytest.raises(BounceError, match=rule):
            job.plot("return", gamma=gamma, omega=0.6)


def test_exponents_are_drawn_along_the_axis(python_client: Client, ax: Axes):
    spec = RAMP | {"omega": 0.6, "protocol": {"kind": "rest"}, "exponents": 1}
    job = python_client.submit(spec).wait(progress=False)
    job.plot("exponents", ax=ax)
    stored = job.diagram().lyapunov.values[:, 0]
    stored = np.where(np.isfinite(stored), stored, np.nan)
    assert any(np.array_equal(line.get_ydata(), stored, equal_nan=True) for line in ax.lines)
    with pytest.raises(BounceError, match="exponents: the sweep has none"):
        python_client.submit(RAMP | {"omega": 0.6}).wait(progress=False).plot("exponents")


# Measured points


def residuals(ax: Axes) -> np.ndarray[Any, Any]:
    """What is drawn in the axes below."""
    return np.asarray(ax.child_axes[-1].lines[-1].get_ydata())  # type: ignore[attr-defined]


def test_measured_flights_have_residuals_to_the_nearest(job: Job, ax: Axes, tmp_path: Path):
    """In ms of a plate of 25 Hz; a point beyond the axis has none."""
    flights = job.diagram(omega=0.6, direction="down").flight_time
    gamma, offset = [1.0, 1.21, 1.5, 2.0], np.array([0.02, -0.03, 0.01, 0.0])
    times = [float(flights.sel(gamma=each, method="nearest")[0]) for each in gamma] + offset
    rows = [f"{g},{time / (2 * math.pi * 0.025)},0.1" for g, time in zip(gamma, times, strict=True)]
    file = tmp_path / "measured.csv"
    file.write_text("\n".join(["# of our own", "gamma,flight_time_ms,error", *rows]))
    job.plot("diagram", omega=0.6, direction="down", data=file, frequency=25.0, ax=ax)
    np.testing.assert_allclose(residuals(ax), [*offset[:3], np.nan], atol=1e-9)
    (bars,) = ax.child_axes[-1].collections  # type: ignore[attr-defined]
    lengths = np.ptp(bars.get_segments(), axis=1)
    np.testing.assert_allclose(lengths, [[0.0, 2 * 0.1 * 2 * math.pi * 0.025]] * 3, atol=1e-9)
    assert ax.child_axes[-1].get_title("right") == "3 of 4 points: median 0.02, largest 0.03"  # type: ignore[attr-defined]


def test_the_axes_have_room_for_measured_flights_unless_a_window_is_asked_for(job: Job):
    data = {"gamma": [1.0, 2.0], "flight_time": [50.0, 90.0]}  # the second is beyond the axis
    ax = job.plot("diagram", omega=0.6, data=data, ax=Figure().subplots())
    assert ax.get_ylim() == pytest.approx((0.0, 53.0))
    ax = job.plot("diagram", omega=0.6, data=data, flight_stop=9.0, log="y", ax=Figure().subplots())
    assert (ax.get_ylim()[1], ax.get_yscale()) == (9.0, "log")


def test_measured_thresholds_have_residuals_to_the_nearest_of_the_sweep(job: Job, ax: Axes):
    found = job.threshold(progress=False).sel(omega=0.6)
    at, closed = float(found.down), float(found.analytic)
    gamma = [at + 0.01, at, closed]  # the second is elsewhere
    job.plot("threshold", data={"omega": [0.6] * 3, "xi": [math.nan, 0.9, math.nan], "gamma": gamma}, ax=ax)
    from_closed = min((closed - float(found.up), closed - at), key=abs)
    assert abs(from_closed) > 1e-3
    np.testing.assert_allclose(residuals(ax), [0.01, from_closed], atol=1e-9)
    above = {"omega": [0.6], "gamma": [9.0]}
    for window, top in (({}, 9.0), ({"gamma_stop": 2.0}, 2.0)):
        ax = job.plot("threshold", data=above, ax=Figure().subplots(), **window)
        assert ax.get_ylim()[1] == pytest.approx(top, rel=0.1)


def test_a_csv_file_has_no_cells_beyond_its_columns(tmp_path: Path):
    """A comma at the end of each line is none; with decimal commas other numbers would be read.

    A row without both values is no point: it has no residual, as on the page.
    """
    file = tmp_path / "measured.csv"
    for comma in ("", ","):
        file.write_text(f"omega,gamma,flight_time{comma}\n0.6,1.5,4.2,\n0.6,2.0,n/a,\n0.6,3.0,na,\n0.6,,,\n")
        points = measured(file, "gamma", "flight_time", {"omega": 0.6})
        np.testing.assert_array_equal(points, [[1.5], [4.2], [math.nan]])
    assert '"value": "flight_time"' in element(file)  # thresholds have columns of these names too
    for text, rule in (
        ("gamma,flight_time\n1,4\n1,5,4,2\n", r"more cells than there are columns.* \(line 3\); commas"),
        ('gamma,flight_time\n1,"4\n', "than there are columns, or an open quote; commas"),
        ("gamma,flight_time\n1,5,4,2\n", "data: a row has more cells than there are columns"),
        ("gamma,flight_time,gamma\n1,4,1\n", "data: gamma.1 is no column here"),
        ("gamma,flight_time_ms,frequency\n1,4,0\n", "frequency of row 1 must be a number above 0, not '0'"),
    ):
        file.write_text(text)
        with pytest.raises(BounceError, match=rule):
            measured(file, "gamma", "flight_time", {})


@for_each(("data", "rule"), [
    ({"gamma": [1.0]}, "data: needs the column flight_time or flight_time_ms; it has gamma"),
    ({"flight_time": [1.0]}, "data: needs the column gamma; it has flight_time"),
    ({"gamma": [1.0], "flight_time": ["long"]}, "of row 1 must be a number of 0 or more, not 'long'"),
    ({"gamma": [1.0], "flight_time": [True]}, "of row 1 must be a number of 0 or more, not 'True'"),
    ({"gamma": [1.0], "flight_time": [2.0], "frequency": [-1]}, "frequency of row 1 must be a number"),
    ({"gamma": [1.0], "flight_time": [2.0], "error": [-1.0]}, "error of row 1 must be a number of 0 or more"),
    ({"gamma": [1.0], "flight_time_ms": [9.0]}, "data: flight_time_ms needs the plate's frequency in Hz"),
    ({"gamma": [1.0], "speed": [9.0]}, "data: speed is no column here; these are gamma, omega, xi"),
    ({"gamma": [1.0], "omega": [0.7], "flight_time": [2.0]}, "data: no point is at omega = 0.6, xi = 0.05"),
    (Path(__file__).parents[4] / "docs/page.png", "is empty or no text (UTF-8) of columns with commas"),
])  # fmt: skip
def test_data_that_is_no_table_of_points_is_refused(job: Job, data: Any, rule: str):
    with pytest.raises(BounceError) as caught:
        job.plot("diagram", omega=0.6, direction="down", data=data, ax=Figure().subplots())
    assert rule in str(caught.value)


@for_each(("data", "rule"), [
    ({"gamma": [1.0], "flight_time_ms": [9.0]}, "data: flight_time_ms needs the plate's frequency in Hz"),
    ({"flight_time": [1.0]}, "data: needs the column gamma; it has flight_time"),
    ({"gamma": [1.0]}, "data: needs the column omega; it has gamma"),
    ({"gamma": [math.nan], "flight_time": [1.0]}, "data: no row has gamma and flight_time"),
    ({"gamma": [], "flight_time": []}, "data: no row has gamma and flight_time"),
    (3, "data: must be a CSV file, or a table or mapping of columns of one length, not 3"),
])  # fmt: skip
def test_points_that_no_page_can_draw_are_not_shared(data: Any, rule: str):
    with pytest.raises(BounceError) as caught:
        element(data)
    assert rule in str(caught.value)
