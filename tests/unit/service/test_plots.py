"""A job's results as plots: what the artists hold is what the datasets hold."""

import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import xarray
from fastapi.testclient import TestClient
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from served import computing

from kernel.labels import LABELS
from service.client import BounceError, Client, Job
from service.client.plots import (
    AXES,
    BLUE,
    DIFFER,
    FLIGHT,
    HATCH,
    OTHERS,
    PERIODS,
    RED,
    draw_branches,
    draw_diagram,
    draw_modes,
    draw_thresholds,
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
    job.plot("diagram", ax=ax, omega=0.6, branches=branches)
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


def test_a_map_tells_periods_and_labels_apart():
    periodic, others = LABELS.index("periodic"), [name for name in OTHERS if name in LABELS]
    label = [*[periodic] * 6, *(LABELS.index(name) for name in others)]
    periods = [1, 2, 3, 4, 5, 9, *[0] * len(others)]
    outcome = [periodic] * len(label)
    ax, colours, legend = drawn(cells(label=label, outcome=outcome, periods=periods))
    assert colours == [*PERIODS, PERIODS[-1], *(OTHERS[name] for name in others)]
    assert legend[:5] == ["cycle of 1", "cycle of 2", "cycle of 3", "cycle of 4", "longer cycle"]
    assert legend[5:] == [name.replace("_", " ") for name in others]
    assert (ax.get_xlabel(), ax.get_ylabel()) == (AXES["gamma"], AXES["omega"])
    assert ax.get_title() == r"$\xi$ = 0.05, periods of the plate in a cycle"
    legend_box = ax.get_legend().get_bbox_to_anchor().transformed(ax.transAxes.inverted())
    assert (legend_box.x0, legend_box.y0) == pytest.approx((1.01, 1.0))
    # Without labels, by the outcome.
    _, colours, legend = drawn(cells(outcome=outcome, periods=periods))
    assert colours[6:] == [PERIODS[0]] * len(others)


@pytest.mark.parametrize(("hysteresis", "hatched"), [((0, 0), False), ((0, 1), True), ((2, 0), True)])
def test_cells_of_any_difference_are_hatched(hysteresis: tuple[int, int], hatched: bool):
    ax, _, legend = drawn(cells(outcome=[1, 1], periods=[1, 1], hysteresis=hysteresis))
    assert len(ax.collections) == (2 if hatched else 1)
    assert (DIFFER in legend) is hatched
    if hatched:
        masked = np.ma.getmaskarray(ax.collections[1].get_array()).ravel().tolist()
        assert masked == [value == 0 for value in hysteresis]


def test_thresholds_are_named_and_those_there_are_not_are_left_out(ax: Axes):
    nothing = np.array([np.nan, np.nan])
    values = {"analytic": [0.5, 0.6], "predicted_down": [0.4, 0.5], "up": [0.5, np.nan], "down": nothing}
    draw_thresholds(
        ax, xarray.Dataset({n: ("omega", v) for n, v in values.items()}, {"omega": [0.5, 0.6], "xi": 0.05})
    )
    names = ["Eq. 25", "closed form, down", "computed, up"]
    assert [str(line.get_label()) for line in ax.lines] == names
    legend = ax.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == names
    labels = (ax.get_xlabel(), ax.get_ylabel(), ax.get_title())
    assert labels == (AXES["omega"], r"threshold $\Gamma$", r"$\xi$ = 0.05")


def test_cycles_are_drawn_by_what_they_are(ax: Axes):
    grid, gamma = ("branch", "point"), [1.0, 2.0, 3.0, 4.0]
    values = {"gamma": gamma, "flight_time": gamma, "stable": [1, 0, 1, 0], "admissible": [0, 0, 1, 4]}
    draw_branches(ax, xarray.Dataset({name: (grid, np.array([each])) for name, each in values.items()}))
    shown = {
        line.get_linestyle(): [x for x in np.asarray(line.get_xdata()).tolist() if np.isfinite(x)]
        for line in ax.lines
    }
    assert shown == {"-": [1.0], "--": [2.0], ":": [3.0, 4.0]}


@pytest.mark.parametrize(("direction", "label"), [("rest", "from rest"), ("up", "ramp up")])
def test_a_diagram_names_what_is_fixed_and_the_way(ax: Axes, direction: str, label: str):
    times = np.array([[5.0, np.nan], [4.0, 6.0]])
    fixed = {"omega": 0.5, "xi": 0.05, "direction": direction}
    diagram = xarray.Dataset({"flight_time": (("gamma", "flight"), times)}, {"gamma": [1.0, 2.0], **fixed})
    draw_diagram(ax, diagram)
    (dots,) = ax.lines
    np.testing.assert_array_equal(dots.get_xydata(), [[1, 5], [1, np.nan], [2, 4], [2, 6]])
    assert dots.get_label() == label
    labels = (ax.get_xlabel(), ax.get_ylabel(), ax.get_title())
    assert labels == (AXES["gamma"], FLIGHT, r"$\Omega$ = 0.5, $\xi$ = 0.05")


def test_axes_are_those_of_the_caller_of_pyplot_or_new(job: Job, ax: Axes, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delitem(sys.modules, "matplotlib.pyplot", raising=False)
    made = job.plot("threshold")
    assert made.figure is not ax.figure
    pyplot = ModuleType("matplotlib.pyplot")
    pyplot.gca = lambda: ax  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", pyplot)
    assert job.plot("threshold") is ax
    assert len(ax.lines) == len(made.lines) > 0


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
    assert len(job.plot("diagram", omega=0.6, ax=Figure().subplots()).lines) == 1
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
