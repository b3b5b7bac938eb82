"""From the store to arrays: the right cells, no other chunks, and errors that name the parameter."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from chunks import compute
from matplotlib.figure import Figure
from pydantic import ValidationError
from scripted import small as spec
from studies import spec_of
from tables import for_each

from kernel.params import Outcome
from service.errors import InvalidRequest, TooLarge
from service.views import selection, shared
from service.views.diagram import DiagramQuery
from service.views.modes import OTHER_FLIGHTS, Hysteresis, compare
from service.views.registry import VIEWS, admit
from service.views.selection import Stored
from service.views.view import Estimate
from worker import store, studies
from worker.store import backend
from worker.sweep import SweepSpec


def computed(folder: Path, spec: SweepSpec) -> Stored:
    """A store of the sweep in chunks of few cells."""
    url = str(folder / "store.zarr")
    compute(url, spec, (1, 2, 5))
    return Stored(spec, url)


@for_each("kind", ("rest", "basin", "multistability", "orbits"))
def test_a_study_that_has_not_begun_is_read_as_fill_values(kind: str, tmp_path: Path):
    gamma = {} if kind == "orbits" else {"gamma": [1.0, 2.0], "model": {"kind": "rigid"}}
    spec = studies.parse(gamma | {"omega": [0.5, 0.6, 0.7], "xi": 0.1, "protocol": {"kind": kind}})
    layout = studies.study_of(spec).variables(spec, (1,) * len(spec.AXES))
    arrays = selection.read_stored(Stored(spec, str(tmp_path / "none.zarr")), layout.names, {})
    assert {name: array.shape for name, array in arrays.items()} == {
        each.name: layout.shape(each) for each in layout.arrays
    }


def test_a_page_of_a_ramp_along_omega_has_no_thresholds(tmp_path: Path):
    """They are those in gamma, of a sweep from rest or ramped along gamma."""
    cell: dict[str, Any] = {"gamma": 1.2, "omega": [0.5, 0.6], "xi": 0.1, "model": {"kind": "rigid"}}
    ramp = {"kind": "ramp", "axis": "omega", "direction": "up"}
    for protocol, number in (({"kind": "rest"}, 1), (ramp, 0)):
        study = Stored(SweepSpec(**cell, protocol=protocol), str(tmp_path / "none.zarr"))
        assert len(shared._thresholds(study)) == number


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Stored:
    return computed(tmp_path_factory.mktemp("sweep"), spec())


def diagram(sweep: Stored, max_points: int = 1_000_000, **fields: Any) -> xarray.Dataset:
    return answer("diagram", sweep, max_points, fields)


def modes(sweep: Stored, max_points: int = 1_000_000, **fields: Any) -> xarray.Dataset:
    return answer("modes", sweep, max_points, fields)


def answer(name: str, sweep: Stored, max_points: int, fields: dict[str, Any]) -> xarray.Dataset:
    view = VIEWS[name]
    query, _ = admit(view, sweep.spec, view.query(**fields), "json", max_points)
    return view.compute(sweep, query)


# Lines


@for_each(("values", "field", "rule"), [
    ({"omega": 1.01, "xi": 0.05}, "omega", "from 0.5 to 1.0, not 1.01"),
    ({"omega": 0.5}, "xi", "is required: the sweep has 2 values from 0.05 to 0.26"),
    ({"omega": 0.5, "xi": 0.05, "gamma": 1.0}, "gamma", "leave it out"),
    ({"omega": 0.5, "xi": 0.05, "direction": "up"}, "direction", "must be 'rest' in this sweep"),
    ({"omega": 0.5, "xi": 0.05, "start": 2.0, "stop": 1.0}, "start", "must not be above stop, which is 1"),
    ({"omega": 0.5, "xi": 0.05, "start": 99.0}, "start", "must not be above the axis, which ends at"),
])  # fmt: skip
def test_a_parameter_outside_the_grid_is_named(
    sweep: Stored, values: dict[str, float], field: str, rule: str
):
    with pytest.raises(InvalidRequest) as error:
        diagram(sweep, **values)
    assert [problem.field for problem in error.value.problems] == [field]
    assert rule in str(error.value)


def test_a_window_has_the_grid_values_at_its_ends():
    gamma = np.linspace(0.4, 1.2, 41)
    assert gamma[20] < 0.8  # by rounding
    for ends, cells in (({"start": 0.8, "stop": 1.0}, range(20, 31)), ({"start": 1.2}, range(40, 41))):
        assert selection.between(gamma, DiagramQuery(**ends), "start", "stop") == cells


def test_a_picture_is_what_is_shown(sweep: Stored):
    """Flights outside the window, and classes that are hidden, are left out; the axis has the window."""
    point, window = {"omega": 0.5, "xi": 0.26}, {"flight_start": 3.0, "flight_stop": 6.0}
    whole, shown = diagram(sweep, **point), diagram(sweep, **point, **window, hide="2-equal,aperiodic")
    times, of_two = whole.flight_time, (whole.outcome == 1) & (whole.bounces == 2) & (whole.periods == 2)
    kept = times.where((times >= 3) & (times <= 6) & ~of_two & (whole.outcome != Outcome.APERIODIC))
    assert 0 < kept.count() < times.count()
    np.testing.assert_array_equal(shown.flight_time, kept)
    figure = Figure()
    VIEWS["diagram"].draw(shown, figure)
    assert figure.axes[0].get_ylim() == (3.0, 6.0)
    legends = []
    for hide in (None, "at_rest"):
        plane = modes(sweep, xi=0.26, hide=hide)
        assert (Outcome.AT_REST in plane.outcome) == (hide is None)
        assert plane.attrs["complete"]
        VIEWS["modes"].draw(plane, figure := Figure())
        legends.append({text.get_text() for text in figure.axes[0].get_legend().get_texts()})
    assert legends[0] - legends[1] == {"at rest"}
    ends = {"omega_start": 0.6, "omega_stop": 0.8, "gamma_start": 0.2, "gamma_stop": 1.5}
    found = answer("threshold", sweep, 1000, {"xi": 0.26, "predict": "none", **ends})
    assert found.omega.values.tolist() == [0.7]
    VIEWS["threshold"].draw(found, figure := Figure())
    assert figure.axes[0].get_ylim() == (0.2, 1.5)
    with pytest.raises(ValidationError, match=r"must be among 1-fewer, .* not 'rest'"):
        modes(sweep, xi=0.26, hide="at_rest,rest")


def test_flights_that_do_not_count_are_missing_in_their_place(sweep: Stored):
    """All of a cell count where all are short."""
    point = {"omega": 1.0, "xi": 0.05}
    whole, line = (diagram(sweep, min_flight=shortest, **point) for shortest in (0, 3))
    longer = whole.flight_time > 3
    shown = np.isfinite(whole.flight_time) & (longer | ~longer.any("flight"))
    for name in ("flight_time", "takeoff_phase"):
        np.testing.assert_array_equal(line[name], whole[name].where(shown))
    np.testing.assert_array_equal(line.flights, whole.flights)
    assert 0 < shown.sum() < np.isfinite(whole.flight_time).sum()
    plane = modes(sweep, min_flight=3, xi=0.05).sel(omega=1.0)
    np.testing.assert_array_equal(plane.bounces, line.bounces)
    assert (line.bounces != whole.bounces).any()


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Every file of a store that is read, by its name within the store."""
    seen: list[str] = []
    real = backend.read_key

    def counted(url: str, key: str) -> bytes | None:
        seen.append(key)
        return real(url, key)

    monkeypatch.setattr(backend, "read_key", counted)
    return seen


def test_only_the_chunks_that_a_line_touches_are_read(sweep: Stored, reads: list[str]):
    diagram(sweep, omega=0.7, xi=0.26)
    chunks = {key for key in reads if key.startswith("flight_time/c.")}
    assert chunks == {f"flight_time/c.0.1.0.{gamma}.0" for gamma in (0, 1)}
    reads.clear()
    diagram(sweep, along="omega", gamma=0.5, xi=0.05)
    chunks = {key for key in reads if key.startswith("flight_time/c.")}
    assert chunks == {f"flight_time/c.0.0.{omega}.0.0" for omega in (0, 1)}


@for_each(("max_points", "every"), [(80, 1), (79, 2), (40, 2), (39, 3), (8, 10), (7, None)])
def test_a_refusal_names_the_thinning_that_fits(sweep: Stored, max_points: int, every: int | None):
    """Ten values of gamma of eight flights: the least `every` that fits, and one less is refused."""
    point = {"omega": 0.5, "xi": 0.05}
    assert Estimate({"gamma": 10, "flight": 8}, thinned=("gamma",)).fitting(max_points) == every
    if every is None:
        with pytest.raises(TooLarge, match=r"the limit is \d+: open the store itself, which has no"):
            diagram(sweep, max_points, **point)
        return
    assert diagram(sweep, max_points, every=every, **point).attrs["every"] == every
    if every > 1:
        with pytest.raises(TooLarge, match=f"every={every} fits"):
            diagram(sweep, max_points, every=every - 1, **point)


# Planes


#: Around the fold of Omega = 0.6 and, at larger Gamma, the flights that leap on the way up.
BOTH_WAYS = spec_of((0.5, 1.2, 15), [0.58, 0.6, 0.62], 0.05, window=(60, 20, 6), ramp="both", exponents=0)


@pytest.fixture(scope="module")
def both_ways(tmp_path_factory: pytest.TempPathFactory) -> Stored:
    return computed(tmp_path_factory.mktemp("both"), SweepSpec(**BOTH_WAYS))


def cycle(cell: dict[str, Any]) -> list[float]:
    """Sorted flights of the last cycle of one cell."""
    times = [time for time in cell["flight_time"].tolist() if math.isfinite(time)]
    longer = [time for time in times if time > 0.05] or times
    return sorted(longer[len(longer) - int(cell["bounces"]) :])


def test_hysteresis_is_where_up_and_down_end_on_different_cycles(both_ways: Stored):
    names = ("flight_time", "outcome", "bounces", "periods")
    up, down = (store.read_slice(both_ways.url, names, direction=i, xi=0) for i in (0, 1))
    expected = np.zeros((3, 15), int)
    for place in np.ndindex(3, 15):
        cells = [{name: arrays[name][place] for name in names} for arrays in (up, down)]
        pair = [tuple(int(cell[name]) for name in names[1:]) for cell in cells]
        if Outcome.SETTLING in (pair[0][0], pair[1][0]):
            continue
        if pair[0] != pair[1]:
            expected[place] = Hysteresis.MODE
        elif pair[0][0] == Outcome.PERIODIC and any(
            abs(a - b) > OTHER_FLIGHTS for a, b in zip(*map(cycle, cells), strict=True)
        ):
            expected[place] = Hysteresis.FLIGHTS
    for direction in ("up", "down"):
        found = modes(both_ways, direction=direction, hysteresis=True)
        assert found.hysteresis.values.tolist() == expected.tolist()
        assert found.attrs["complete"]
    assert set(expected.ravel().tolist()) == {0, 1, 2}
    ends = {"gamma_start": 0.6, "gamma_stop": 1.0, "omega_start": 0.59, "omega_stop": 0.7}
    window = modes(both_ways, direction="up", hysteresis=True, **ends)
    columns = [i for i, gamma in enumerate(both_ways.spec.axis_values("gamma")) if 0.6 <= gamma <= 1.0]
    assert window.hysteresis.values.tolist() == expected[1:][:, columns].tolist()


def test_parts_of_a_cycle_are_no_hysteresis():
    cells = {"outcome": np.array([1, 1]), "bounces": np.array([2, 3]), "periods": np.array([2, 3])}
    up, down = (
        cells | {"flight_time": np.array([times, times]), "flights": np.array([9, 9], np.int32)}
        for times in ([3.0, 4.0], [4.0, 5.0])
    )
    assert compare(up, down, 0.05).tolist() == [Hysteresis.FLIGHTS, Hysteresis.NONE]


def test_the_margin_of_stability_is_that_of_certified_cells(tmp_path: Path):
    axes = {"gamma": [0.5, 1.5, 2.3, 5.0], "omega": [0.5, 0.6], "xi": 0.26, "settle": "auto", "observe": 100}
    sweep = computed(tmp_path / "auto", spec(**axes))
    found, plain = modes(sweep, color="multiplier"), modes(sweep)
    assert set(found) - set(plain) == {"multiplier", "multiplier_angle", "flight_error"}
    certified = np.isfinite(found.multiplier.values)
    assert certified.tolist() == (found.outcome.values == Outcome.PERIODIC).tolist()
    assert certified[:, 1].all()
    assert (found.multiplier.values[certified] < 1.0).all()
    assert (found.flight_error.values[certified] < 1e-9).all()
    line = diagram(sweep, omega=0.5)
    assert line.multiplier.values.tolist() == pytest.approx(found.multiplier.values[0].tolist(), nan_ok=True)
    left = modes(sweep, color="multiplier", hide="multiplier-0.2")
    shown = ~(found.multiplier < 0.2)
    assert 0 < shown.sum() < shown.size
    np.testing.assert_array_equal(left.outcome, found.outcome.where(shown, Outcome.MISSING))
    fixed = computed(tmp_path / "fixed", spec(**axes | {"settle": 20}))
    with pytest.raises(InvalidRequest, match="color: must be 'mode': this sweep certifies no cells"):
        modes(fixed, color="multiplier")


def test_hysteresis_of_one_direction_is_refused(tmp_path: Path):
    up = BOTH_WAYS["protocol"] | {"direction": "up"}
    with pytest.raises(InvalidRequest, match="ramped up only"):
        modes(Stored(SweepSpec(**BOTH_WAYS | {"protocol": up}), str(tmp_path / "none")), hysteresis=True)
