"""A job's results as plots: what the artists hold is what the datasets hold."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import xarray
from fastapi.testclient import TestClient
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from served import computing

from service.client import BounceError, Client, Job
from service.client.accessor import (
    AXES,
    BLUE,
    DIFFER,
    FLIGHT,
    HATCH,
    OTHERS,
    PERIODS,
    RED,
    draw_modes,
)

RAMP: dict[str, Any] = {
    "gamma": {"start": 0.5, "stop": 1.5, "num": 21}, "omega": [0.6, 0.9, 1.2], "xi": 0.05,
    "protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"}, "model": {"kind": "rigid"},
    "settle": 60, "observe": 20, "keep": 4,
}  # fmt: skip


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    with computing(tmp_path_factory.mktemp("data")) as http:
        assert isinstance(http, TestClient)
        yield Client("http://localhost", http=http)


@pytest.fixture(scope="module")
def job(client: Client) -> Job:
    return client.submit(RAMP).wait(progress=False)


@pytest.fixture
def ax() -> Axes:
    return Figure().subplots()


def test_a_diagram_holds_every_flight(job: Job, ax: Axes):
    assert job.plot("diagram", ax=ax, omega=0.6, direction="down") is ax
    (dots,) = ax.lines
    diagram = job.diagram(omega=0.6, direction="down")
    x, y = (np.asarray(values) for values in dots.get_data())
    shown = np.isfinite(y)
    assert (
        np.sort(y[shown]).tolist()
        == np.sort(diagram.flight_time.values[~np.isnan(diagram.flight_time)]).tolist()
    )
    assert set(x[shown].tolist()) == set(diagram.gamma.values[diagram.flights.values > 0].tolist())
    assert to_hex(dots.get_color()) == BLUE
    assert ax.get_xlabel() == AXES["gamma"]
    assert "0.6" in ax.get_title()
    job.plot("diagram", ax=ax, omega=0.6, direction="up")
    assert to_hex(ax.lines[1].get_color()) == RED


def test_branches_are_solid_where_they_are_stable(job: Job, client: Client, ax: Axes):
    branches = client.orbits(0.6, 0.05, "1-1")
    job.plot("diagram", ax=ax, omega=0.6, direction="up", branches=branches)
    assert {line.get_linestyle() for line in ax.lines[1:]} == {"-", "--", ":"}
    stable = branches.stable.values.astype(bool) & (branches.admissible.values == 0)
    solid = [np.asarray(line.get_xdata()) for line in ax.lines[1:] if line.get_linestyle() == "-"]
    assert np.isfinite(solid).sum() == stable.sum() > 0


def test_a_map_has_the_colour_of_each_cell(job: Job, ax: Axes):
    job.plot(ax=ax, direction="down")
    modes = job.modes(direction="down")
    mesh, *_ = ax.collections  # the others are hatches
    values = np.asarray(mesh.get_array()).reshape(3, 21)
    colours = [to_hex(colour) for colour in mesh.cmap(mesh.norm(values)).reshape(-1, 4)]
    for outcome, periods, colour in zip(
        modes.outcome.values.ravel(), modes.periods.values.ravel(), colours, strict=True
    ):
        expected = {1: PERIODS[min(periods, 5) - 1], 3: OTHERS["at_rest"]}.get(int(outcome))
        assert expected is None or colour == expected
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert {"cycle of 1", "at rest"} <= set(names)


def test_thresholds_hold_what_is_computed_and_predicted(job: Job, ax: Axes):
    job.plot("threshold", ax=ax)
    drawn = {str(line.get_label()): np.asarray(line.get_ydata(), float) for line in ax.lines}
    thresholds = job.threshold()
    for label, name in {"Eq. 25": "analytic", "closed form, down": "predicted_down", "computed, up": "up",
                        "computed, down": "down"}.items():  # fmt: skip
        np.testing.assert_array_equal(drawn[label], thresholds[name].values)


def cells(**variables: Any) -> xarray.Dataset:
    """A map of one row of cells."""
    number = len(variables["periods"])
    plane = {name: (("omega", "gamma"), np.array([each])) for name, each in variables.items()}
    return xarray.Dataset(plane, {"omega": [0.5], "gamma": np.arange(float(number)), "xi": 0.05})


def drawn(modes: xarray.Dataset) -> tuple[Axes, list[str], list[str]]:
    """The axes of a map, the colour of each cell, and the legend."""
    ax = Figure().subplots()
    draw_modes(ax, modes)
    mesh = ax.collections[0]
    legend = ax.get_legend()
    assert legend is not None
    colours = mesh.cmap(mesh.norm(np.asarray(mesh.get_array()).ravel()))
    return ax, [to_hex(colour) for colour in colours], [text.get_text() for text in legend.get_texts()]


def test_what_is_drawn_by_default(job: Job, client: Client):
    assert job.plot().get_ylabel() == AXES["omega"]
    two = client.submit(RAMP | {"omega": [0.6, 0.7]}).wait(progress=False)
    assert two.plot().get_ylabel() == AXES["omega"]
    one = client.submit(RAMP | {"omega": 0.6, "gamma": 1.4, "protocol": {"kind": "rest"}})
    assert one.wait(progress=False).plot().get_xlabel() == AXES["gamma"]
    single = client.submit(RAMP | {"omega": 0.6}).wait(progress=False)
    assert single.plot(direction="down").get_ylabel() == "flight time (rad)"
    over_omega = client.submit(
        RAMP | {"gamma": 1.4, "protocol": {"kind": "rest"}, "omega": [0.6, 0.7, 0.8]}
    ).wait(progress=False)
    assert over_omega.plot().get_xlabel() == AXES["omega"]
    assert over_omega.plot(along="omega").get_xlabel() == AXES["omega"]
    assert job.plot("diagram", along="omega", gamma=1.5).get_xlabel() == AXES["omega"]
    assert job.plot(along="gamma", omega=0.6).get_ylabel() == FLIGHT
    assert len(job.plot("diagram", omega=0.6, ax=Figure().subplots()).lines) == 2
    with pytest.raises(BounceError, match="kind: must be one of diagram, modes, threshold"):
        job.plot("pie")  # type: ignore[arg-type]
    with pytest.raises(BounceError, match="are drawn in a diagram"):
        job.plot("modes", branches=client.orbits(0.6, 0.05, "1-1"))


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
