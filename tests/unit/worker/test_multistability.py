"""Multistability: the attractors that drops find, followed along gamma, however the work is cut."""

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import paths
import pytest
import xarray

from kernel.branches.events import Kind, fold_events
from kernel.cell import rescale
from kernel.params import Outcome, empty_line
from worker import store, studies, tasks
from worker.basins import steps
from worker.basins.attractors import CYCLE_FLIGHTS
from worker.basins.multistability import (
    _ARRAYS,
    CYCLE,
    MAX_ATTRACTORS,
    MULTISTABILITY,
    NOT_STARTED,
    NOWHERE,
    Reached,
    _Cells,
    _further,
    _groups,
    _order,
    _reached,
    _reduced,
    _run_on,
    cell_cost,
    make_plan,
    run_chunk,
)
from worker.basins.schema import empty_record, sizes_of_attractors
from worker.basins.spec import MultistabilitySpec
from worker.basins.starts import starts_of
from worker.basins.steps import line_run
from worker.cost import cell_seconds, period_seconds
from worker.plan import TARGET_SECONDS
from worker.spec import SpecError
from worker.tasks import ChunkCancelled, ChunkPaused

GOLDEN = json.loads((paths.GOLDEN / "multistability.json").read_text())

SPEC: dict[str, Any] = {
    "gamma": [3.4, 3.6, 3.8], "omega": [0.5, 0.52], "xi": 0.26, "model": {"kind": "rigid"},
    "protocol": {"kind": "multistability"}, "settle": 300, "observe": 60,
}  # fmt: skip


def multistability(**fields: Any) -> MultistabilitySpec:
    protocol = {name: fields.pop(name) for name in ("plane", "rows", "columns", "height") if name in fields}
    return MultistabilitySpec.parse(SPEC | fields | {"protocol": SPEC["protocol"] | protocol})


def computed(
    url: str, spec: MultistabilitySpec, chunk_shape: tuple[int, ...] | None = None
) -> xarray.Dataset:
    plan = MULTISTABILITY.plan(spec, chunk_shape)
    store.create(url, MULTISTABILITY.variables(spec, plan.chunk_shape))
    for chunk in plan:
        report = run_chunk(spec, chunk, url)
        assert sum(report.outcomes) == report.cells == chunk.cells
    return xarray.open_zarr(url, chunks=None).load()


@pytest.mark.parametrize("reference", GOLDEN["maps"], ids=lambda reference: f"xi {reference['xi']}")
def test_shares_of_cells_with_several_attractors(tmp_path: Path, reference: dict[str, Any]):
    """Every fourth value of the maps of 40 by 40 cells; the reference is the share of the whole maps."""
    gamma, omega = (np.linspace(*reference[axis], 40)[::4].tolist() for axis in ("gamma", "omega"))
    spec = multistability(gamma=gamma, omega=omega, xi=reference["xi"], settle=800, observe=150)
    data = computed(str(tmp_path / "a.zarr"), spec).isel(xi=0)
    assert float((data.attractor_count >= 2).mean()) == pytest.approx(reference["share"], abs=0.02)
    rows = ["".join(map(str, row)) for row in data.attractor_count.values]
    assert rows == reference["counts"]
    assert float((data.fraction.sum("id") + data.undecided).max()) == pytest.approx(1.0)


def test_two_attractors_are_followed_where_a_ramp_has_hysteresis(tmp_path: Path):
    """Fig. 2 of the paper: (3,4) and (1,2) at gamma 3.6. The former grazes: its mode changes along gamma."""
    gamma = [3.56, 3.58, 3.6, 3.62, 3.64]
    data = computed(str(tmp_path / "a.zarr"), multistability(gamma=gamma, omega=0.5))
    line = data.isel(xi=0, omega=0)
    modes: dict[int, list[tuple[int, int]]] = {0: [], 1: []}
    at = {0: 0, 1: 1}
    for j in range(len(gamma)):
        cell = line.isel(gamma=j)
        assert int(cell.attractor_count) == 2
        for branch, k in at.items():
            modes[branch].append((int(cell.bounces[k]), int(cell.periods[k])))
            assert float(cell.fraction[k]) > 0.3
            reached = int(cell.next_up[k]) - 1
            if j + 1 < len(gamma):
                assert int(line.next_down[j + 1, reached]) == k + 1
                at[branch] = reached
            else:
                assert int(cell.next_up[k]) == -1
    assert modes == {0: [(0, 0), (3, 4), (3, 4), (4, 4), (2, 2)], 1: [(1, 2)] * 5}
    assert (line.next_down[0, :2] == -1).all()


def test_a_cycle_ends_within_one_step_of_its_fold(tmp_path: Path):
    """(1,1) at omega 0.6, xi 0.05 begins in a fold at gamma 0.5532, beside rest."""
    events = fold_events(0.6, 0.05, 1, 1.0)
    folds = events.gamma[(events.kind == Kind.FOLD) & (events.admissible == 0)]
    gamma = np.linspace(0.5, 0.62, 13)
    spec = multistability(gamma=gamma.tolist(), omega=0.6, xi=0.05, settle=1500)
    line = computed(str(tmp_path / "a.zarr"), spec).isel(xi=0, omega=0)
    bouncing = np.array([(line.bounces[j] == 1).any() for j in range(len(gamma))])
    first = int(np.argmax(bouncing))
    assert bouncing[first:].all()
    assert gamma[first - 1] < folds.min() <= gamma[first]
    cell = line.isel(gamma=first)
    bounce, rest = (
        int(np.argmax(cell.attractor_outcome.values == o)) for o in (Outcome.PERIODIC, Outcome.AT_REST)
    )
    assert int(cell.next_down[bounce]) == int(cell.next_down[rest]) != 0
    below = line.isel(gamma=first - 1)
    assert int(below.attractor_outcome[int(cell.next_down[bounce]) - 1]) == Outcome.AT_REST


def test_what_drops_reach_runs_on_and_is_stored_as_it_is_after_a_second_window(tmp_path: Path):
    spec = multistability(gamma=[1.5], omega=0.5, rows=1, columns=1, height=3.0, settle=12, observe=8)
    stored = computed(str(tmp_path / "a.zarr"), spec).isel(xi=0, omega=0, gamma=0, id=0)
    cell = tuple(np.array([value]) for value in (1.5, 0.5, 0.26))
    window = {"settle": spec.settle, "observe": spec.observe, "settle_until": spec.until}
    states = starts_of(spec, 1.0, 1.0, 0.0)
    for is_last in (False, True):
        run = line_run(spec, cell, states, keep=CYCLE_FLIGHTS, **window)
        assert run.advance()
        [end] = _reached(_reduced(run.line, spec.micro_flight, spec.keep))
        states = end.state[None]
        assert (stored.attractor_state.values == end.state).all() == is_last


def test_an_attractor_that_no_drop_reaches_is_found_by_following(tmp_path: Path):
    """One drop a cell reaches one attractor; the neighbours' attractors seed the others."""
    spec = multistability(gamma=[3.5, 3.6, 3.7, 3.8], omega=0.5, rows=1, columns=1, height=3.0)
    line = computed(str(tmp_path / "a.zarr"), spec).isel(xi=0, omega=0)
    assert (line.fraction.isel(id=0) == 1.0).all()
    followed = line.isel(gamma=1)
    assert int(followed.attractor_count) == 2
    assert float(followed.fraction[1]) == 0.0
    modes = {(int(followed.bounces[k]), int(followed.periods[k])) for k in range(2)}
    assert modes == {(3, 4), (1, 2)}


def test_what_no_drop_has_found_is_stored_as_it_is_after_a_second_window(tmp_path: Path):
    spec = multistability(gamma=[3.5, 3.6], omega=0.5, rows=1, columns=1, height=9.0, settle=20, observe=40)
    line = computed(str(tmp_path / "a.zarr"), spec).isel(xi=0, omega=0)
    assert int(line.next_up[0, 0]) == 2
    assert float(line.fraction[1, 1]) == 0.0  # no drop has found it
    state = line.attractor_state.values[0, 0].copy()
    rescale(state, 3.5, 1.0, 3.6, 1.0)
    cell = tuple(np.array([value]) for value in (3.6, 0.5, 0.26))
    window = {"settle": spec.settle, "observe": spec.observe, "settle_until": spec.until}
    for is_last in (False, True):
        run = line_run(spec, cell, state[None], keep=CYCLE_FLIGHTS, **window)
        assert run.advance()
        state = run.line.end_state[0].copy()
        assert (line.attractor_state.values[1, 1] == state).all() == is_last


@pytest.mark.parametrize(
    ("columns", "undecided", "outcome"), [(1, 1.0, Outcome.UNRESOLVED), (2, 0.5, Outcome.PERIODIC)]
)
def test_drops_that_still_settle_are_undecided(
    tmp_path: Path, columns: int, undecided: float, outcome: Outcome
):
    """Without a single attractor the cell is unresolved."""
    spec = multistability(
        gamma=[2.3], omega=0.5, rows=1, columns=columns, settle=3, observe=10, settle_until=23
    )
    cell = computed(str(tmp_path / "a.zarr"), spec).isel(xi=0, omega=0, gamma=0)
    assert (float(cell.undecided), int(cell.outcome)) == (undecided, outcome)
    assert int(cell.attractor_count) == columns - 1


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    data = computed(str(tmp_path_factory.mktemp("whole") / "a.zarr"), multistability())
    return {name: data[name].values.tobytes() for name in data.data_vars}


def test_lines_in_one_chunk_or_in_several_are_the_same_bytes(tmp_path: Path, whole: dict[str, bytes]):
    for i, shape in enumerate(((1, 1, 3), (1, 2, 3))):
        data = computed(str(tmp_path / f"{i}.zarr"), multistability(), shape)
        for name, content in whole.items():
            assert data[name].values.tobytes() == content, (name, shape)


def test_a_chunk_that_pauses_again_and_again_gives_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: dict[str, bytes]
):
    monkeypatch.setattr(tasks, "FIRST_STEPS", 16_411)
    monkeypatch.setattr(tasks, "LOOK_SECONDS", (0.0, 1e9))  # the same parts on any machine
    spec, url = multistability(), str(tmp_path / "paused.zarr")
    plan = MULTISTABILITY.plan(spec, (1, 2, 3))
    store.create(url, MULTISTABILITY.variables(spec, plan.chunk_shape))
    done: list[int] = []
    for attempt in itertools.count():
        assert attempt < 5000
        try:
            run_chunk(spec, plan[0], url, 0.0)
            break
        except ChunkPaused:
            kept = store.read_checkpoint(url, plan[0].index)
            assert kept is not None
            done.append(int(kept["steps_done"]))
    assert attempt > 4
    assert done == sorted(done)
    assert done[-1] > 2  # what is done is not computed again
    data = xarray.open_zarr(url, chunks=None).load()
    for name, content in whole.items():
        assert data[name].values.tobytes() == content, name


def test_a_chunk_without_a_store_is_not_begun(tmp_path: Path):
    spec = multistability()
    with pytest.raises(store.StoreMissing):
        run_chunk(spec, MULTISTABILITY.plan(spec)[0], str(tmp_path / "none.zarr"), 0.0)
    assert not any(tmp_path.iterdir())


def test_a_chunk_that_the_store_does_not_have_is_not_computed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    spec, url = multistability(), str(tmp_path / "a.zarr")
    store.create(url, MULTISTABILITY.variables(spec, (1, 1, 3)))
    monkeypatch.setattr(steps, "LineRun", None)
    with pytest.raises(store.StoreConflict, match="spans omega 0 to 2, but chunks here are 1 long"):
        run_chunk(spec, MULTISTABILITY.plan(spec, (1, 2, 3))[0], url)


def test_a_cancelled_chunk_writes_nothing(tmp_path: Path):
    spec, url = multistability(), str(tmp_path / "a.zarr")
    plan = MULTISTABILITY.plan(spec)
    store.create(url, MULTISTABILITY.variables(spec, plan.chunk_shape))
    store.set_cancelled(url)
    with pytest.raises(ChunkCancelled):
        run_chunk(spec, plan[0], url)
    assert (xarray.open_zarr(url, chunks=None).outcome.values == Outcome.MISSING).all()


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"rows": 64, "columns": 32}, "protocol.rows: must be at most 32 with 32 columns"),
        ({"plane": "contact"}, "protocol.plane: must be 'drop'"),
        ({"model": {"kind": "auto"}}, "model.kind: must be 'soft'"),
        ({"exponents": 1}, "exponents: is not a field here"),
    ],
)
def test_broken_rules_are_named(changes: dict[str, Any], rule: str):
    with pytest.raises(SpecError) as caught:
        multistability(**changes)
    assert rule in str(caught.value)


def test_lines_along_gamma_are_not_cut():
    with pytest.raises(ValueError, match="must span the 3 values of gamma, not 2"):
        MULTISTABILITY.plan(multistability(), (1, 1, 2))


def test_the_specification_is_read_back_and_has_its_study():
    spec = multistability(rows=3)
    assert studies.parse(spec.as_submitted()) == spec
    assert studies.study_of(spec) is MULTISTABILITY


def test_cost_grows_with_the_drops_and_the_cells():
    def seconds(**fields: Any) -> float:
        spec = multistability(**fields)
        return MULTISTABILITY.estimate(spec, MULTISTABILITY.plan(spec)).core_seconds

    assert seconds(rows=8) > 1.5 * seconds()
    assert seconds(omega=[0.5, 0.52, 0.54, 0.56]) == pytest.approx(2.0 * seconds())


def test_cost_is_that_of_every_run():
    """Half of the drops run on, a dozen attractors are followed; each run may last until settle_until."""
    spec = multistability(rows=3, columns=5, settle_until=2000)
    plan = MULTISTABILITY.plan(spec, (1, 1, 3))
    cost = MULTISTABILITY.estimate(spec, plan)
    runs = 1.5 * 15 + 12
    assert cell_cost(spec) == pytest.approx(runs * cell_seconds(spec.sweep()))
    assert (cost.cells, cost.chunks) == (6, 2)
    assert cost.core_seconds == pytest.approx(6 * runs * cell_seconds(spec.sweep()))
    assert cost.longest_core_seconds == pytest.approx(6 * runs * period_seconds(spec.sweep()) * 2000)
    whole = MULTISTABILITY.estimate(spec, MULTISTABILITY.plan(spec, (1, 2, 3)))
    assert whole.longest_core_seconds == cost.longest_core_seconds
    sizes = sizes_of_attractors(spec, MAX_ATTRACTORS)
    record = empty_record(MULTISTABILITY.plan(spec, (1, 2, 3))[0], _ARRAYS, sizes)
    assert cost.bytes == sum(array.nbytes for array in record.values())


def test_a_chunk_is_as_many_lines_as_take_a_second():
    spec = multistability(
        gamma=[3.4, 3.5], omega=np.linspace(0.4, 0.6, 300).tolist(), rows=1, columns=1, settle=900
    )
    lines = TARGET_SECONDS / (2 * cell_cost(spec))
    assert 1 < lines < 300
    assert make_plan(spec).chunk_shape == (1, int(lines), 2)
    costly = multistability(xi=[0.1, 0.26], rows=32, columns=32, settle=3000)
    assert make_plan(costly).chunk_shape == (1, 1, 3)
    assert make_plan(multistability(rows=1, columns=1, settle=0, observe=1)).chunk_shape == (1, 2, 3)


# Parts


def reached(outcome: Outcome, *flights: float, bounces: int = 1, state: float = 0.0) -> Reached:
    cycle = np.full(CYCLE, np.nan)
    cycle[: len(flights)] = flights
    longest = max(flights, default=0.0)
    return Reached(outcome, bounces, bounces, cycle, longest, np.full(6, state), np.zeros(16), np.zeros(16))


CYCLE_A, CYCLE_B = reached(Outcome.PERIODIC, 2.0, 1.0), reached(Outcome.PERIODIC, 3.0)
CHAOS, REST = reached(Outcome.APERIODIC, bounces=0), reached(Outcome.AT_REST, bounces=0)
SETTLING = reached(Outcome.SETTLING, bounces=0)


def test_runs_end_on_one_attractor_if_modes_and_flights_are_the_same():
    assert CYCLE_A.same(CYCLE_A)
    assert CYCLE_A.same(reached(Outcome.PERIODIC, 2.0 + 0.9e-4, 1.0 - 0.9e-4))
    assert not CYCLE_A.same(reached(Outcome.PERIODIC, 2.0, 1.0 - 1.1e-4))
    assert not CYCLE_A.same(reached(Outcome.PERIODIC, 2.0, 1.0, bounces=2))
    assert not CHAOS.same(REST)
    decided = {outcome for outcome in Outcome if reached(outcome).decided}
    assert decided == {Outcome.PERIODIC, Outcome.APERIODIC, Outcome.AT_REST}


def test_the_first_start_on_each_cycle_and_every_aperiodic_one_run_on():
    ends = [CYCLE_A, REST, CHAOS, CYCLE_A, CYCLE_B, SETTLING, CHAOS, REST]
    assert _groups(ends) == [[0, 3], [1, 7], [2, 6], [4]]
    assert _further(ends) == [0, 2, 4, 6]
    later = {0: CYCLE_B, 2: CYCLE_A, 4: SETTLING, 6: SETTLING}
    _run_on(ends, later)
    assert ends == [CYCLE_B, REST, CYCLE_A, CYCLE_B, CYCLE_B, SETTLING, SETTLING, REST]


def test_attractors_of_as_many_drops_are_in_the_order_of_modes_and_longest_flights():
    double = reached(Outcome.PERIODIC, 9.0, bounces=2)
    assert sorted([REST, double, CYCLE_A, CHAOS, CYCLE_B], key=_order) == [
        CYCLE_B,
        CYCLE_A,
        double,
        CHAOS,
        REST,
    ]


def test_of_a_run_its_cycle_and_its_last_flights_are_kept():
    line = empty_line(3, 40)
    line.flight_time[0], line.takeoff_phase[0] = np.arange(40) + 1.0, np.arange(40) + 100.0
    line.flight_time[1, :3], line.takeoff_phase[1, :3] = [2.0, 5.0, 0.01], [1.0, 2.0, 3.0]
    line.outcome[:] = Outcome.PERIODIC, Outcome.APERIODIC, Outcome.AT_REST
    line.bounces[:], line.periods[:] = [34, 7, 7], [3, 7, 7]
    line.end_state[:] = np.arange(3)[:, None]
    cycle, chaos, rest = _reached(_reduced(line, 0.05, 4))
    assert (cycle.outcome, cycle.bounces, cycle.periods, cycle.longest_flight) == (1, 34, 3, 40.0)
    assert cycle.cycle.tolist() == np.arange(40.0, 8.0, -1.0).tolist()  # the longest 32
    assert (cycle.flight_time.tolist(), cycle.takeoff_phase.tolist()) == (
        [37, 38, 39, 40],
        [136, 137, 138, 139],
    )
    assert (chaos.bounces, chaos.periods, chaos.longest_flight) == (0, 0, 5.0)
    np.testing.assert_array_equal(chaos.flight_time, [2.0, 5.0, np.nan, np.nan])
    np.testing.assert_array_equal(chaos.takeoff_phase, [1.0, 2.0, np.nan, np.nan])
    assert np.isnan([*chaos.cycle, *rest.cycle, *rest.flight_time]).all()
    assert (rest.bounces, rest.periods, rest.longest_flight) == (0, 0, 0.0)
    assert [end.state[0] for end in (cycle, chaos, rest)] == [0, 1, 2]


def test_attractors_beyond_those_stored_are_counted_and_not_followed():
    spec = multistability()
    record = empty_record(make_plan(spec, (1, 2, 3))[0], _ARRAYS, sizes_of_attractors(spec, MAX_ATTRACTORS))
    record["cycle"] = np.full((1, 2, 3, MAX_ATTRACTORS, CYCLE), np.nan)
    cells = _Cells(record)
    found = [reached(Outcome.PERIODIC, 1.0 + i, state=i) for i in range(MAX_ATTRACTORS + 1)]
    numbers = [cells.add(1, 2, end, 0.5) for end in found]
    assert numbers == [*range(1, MAX_ATTRACTORS + 1), NOWHERE]
    assert record["attractor_count"].ravel().tolist() == [0, 0, 0, 0, 0, MAX_ATTRACTORS + 1]
    known = cells.known(1, 2)
    assert len(known) == MAX_ATTRACTORS
    assert all(
        end.same(other) and end.state[0] == other.state[0] for end, other in zip(known, found, strict=False)
    )
    assert cells.known(0, 2) == []
    assert record["fraction"][0, 1, 2].tolist() == [0.5] * MAX_ATTRACTORS
    for name in ("next_up", "next_down"):
        assert cells.waiting(name, 2) == [(1, k) for k in range(MAX_ATTRACTORS)]
        assert cells.waiting(name, 1) == []
        record[name][0, 1, 2, 0] = NOWHERE
        assert cells.waiting(name, 2) == [(1, k) for k in range(1, MAX_ATTRACTORS)]
        assert (record[name][0, 1, 2, 1:] == NOT_STARTED).all()
