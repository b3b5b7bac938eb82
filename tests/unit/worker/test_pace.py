"""The sample of a study that tells its pace."""

from typing import Any

import numpy as np
import pytest
from studies import spec_of

from kernel.params import LANES
from worker import pace as module
from worker import store
from worker.basins.plan import REPRESENTATIVES
from worker.pace import BYTE_SECONDS, MOST, NEIGHBOURS, SHORT, pace
from worker.studies import parse, run_task, study_of
from worker.sweep.plan import CHUNK_SECONDS, cell_seconds
from worker.sweep.task import to_end
from worker.work import compile_for

GRID = spec_of((0.5, 6.0, 400), (0.3, 1.5, 60), 0.1, settle=20, observe=20)
RAMP = {"kind": "ramp", "axis": "gamma", "direction": "up"}
DROPS = {"kind": "basin", "rows": 40, "columns": 40}


@pytest.fixture
def sampled(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The lines computed for samples."""
    lines: list[Any] = []
    monkeypatch.setattr(module, "to_end", lambda run: lines.append(run) or to_end(run))
    return lines


def study(**fields: Any) -> Any:
    return parse(GRID | {"model": {"kind": "rigid"}} | fields)


@pytest.fixture(scope="module", autouse=True)
def compiled() -> None:
    """There is no sample before."""
    compile_for(study())


@pytest.mark.parametrize("direction", ["up", "down"])
def test_a_ramp_is_sampled_by_neighbours_on_as_many_lines_as_are_side_by_side(direction, sampled):
    spec = study(protocol=RAMP | {"direction": direction})
    assert pace(spec) > 0.0
    run = sampled[0]
    lines = run._gamma.reshape(LANES, -1, min(NEIGHBOURS, MOST // LANES))
    step = np.diff(spec.axis_values("gamma"))[0]
    np.testing.assert_allclose(np.diff(lines), step if direction == "up" else -step)
    assert len({*run._omega}) > 1
    assert all(np.isin(values, spec.axis_values(name)).all() for name, values in
               (("gamma", run._gamma), ("omega", run._omega), ("xi", run._xi)))  # fmt: skip


def test_a_sample_has_cells_of_the_whole_sweep_and_starts_of_the_plane(sampled):
    assert pace(study(gamma=2.0, omega=0.5, protocol=DROPS)) > 0.0
    starts = sampled.copy()
    assert pace(study()) > 0.0
    cells = sampled[-1]
    assert len(cells.line.outcome) == MOST
    assert np.ptp(cells._gamma) > 5.0
    assert len({tuple(state) for run in starts for state in run._states}) > MOST / 4


def test_representatives_of_a_sampled_basin_settle_for_a_part_of_their_time(sampled):
    spec = study(gamma=[2.0, 3.0], omega=0.5, settle=400, protocol=DROPS)
    assert pace(spec) > 0.0
    assert {float(run._gamma[0]) for run in sampled} == {2.0, 3.0}
    lengths = {run._window.settle: len(run._gamma) for run in reversed(sampled)}
    assert lengths[SHORT] <= REPRESENTATIVES < lengths[400] < DROPS["rows"] * DROPS["columns"] / 4


def test_samples_are_repeated_until_they_take_long_as_few_cells_may_take_most_of_the_time(monkeypatch):
    spec, took = study(keep=1), iter([0.001, 0.05, 0.06, 9.0])
    monkeypatch.setattr(module, "_timed", lambda runs: (next(took), 0.037 / cell_seconds(spec)))
    assert pace(spec) == pytest.approx(1.0, rel=0.05)


def test_cells_that_take_next_to_nothing_are_stored_all_the_same(monkeypatch):
    monkeypatch.setattr(module, "_timed", lambda runs: (1e-9, 100))
    spec = study(keep=64)
    plan = study_of(spec).plan(spec)
    cost = study_of(spec).estimate(spec, plan)
    storing = CHUNK_SECONDS * len(plan) + BYTE_SECONDS * cost.bytes
    assert cost.at(pace(spec)).core_seconds == pytest.approx(storing, rel=0.01)


def test_blocks_are_no_larger_than_tiles_of_many_flights():
    spec = study(gamma=GRID["gamma"] | {"num": 300}, omega=GRID["omega"] | {"num": 300},
                 keep=1000, refine={"by": "mode", "coarsest": 128})  # fmt: skip
    blocks = module._Blocks(spec, np.random.default_rng(1))
    assert blocks._shape == study_of(spec).plan(spec).chunk_shape[1:]
    assert max(blocks._shape) < 40


def test_there_is_no_sample_of_slow_cells_of_other_studies_and_before_kernels_are_compiled(monkeypatch):
    slow = study(model={"kind": "stepped", "penetration": 1e-4, "steps_per_contact": 100})
    cycles = parse({"omega": 0.5, "xi": 0.1, "protocol": {"kind": "orbits"}})
    assert [pace(spec) for spec in (slow, cycles, study(model={"kind": "auto"}))] == [None] * 3
    monkeypatch.setattr(module, "is_compiled", lambda spec: False)
    assert pace(study()) is None


def test_blocks_of_a_map_have_the_share_of_its_cells_that_is_computed(tmp_path):
    spec = study(gamma=np.linspace(0.5, 6.0, 129).tolist(), omega=np.linspace(0.3, 1.5, 129).tolist(),
                 settle=100, observe=60, refine={"by": "mode"})  # fmt: skip
    plan = study_of(spec).plan(spec)
    store.create(f"{tmp_path}/map", study_of(spec).variables(spec, plan.chunk_shape))
    computed = sum(run_task(spec, chunk, f"{tmp_path}/map").computed for chunk in plan)
    random, shares = np.random.default_rng(1), []
    for _ in range(12):
        blocks = module._Blocks(spec, random)
        for run in blocks.runs():
            to_end(run)
        shares.append(blocks.share)
    assert np.mean(shares) == pytest.approx(computed / 129**2, rel=0.1)


def test_a_sample_of_a_map_tells_its_whole_cost():
    spec = study(refine={"by": "mode"})
    by_table = study_of(spec).estimate(spec, study_of(spec).plan(spec))
    cost = by_table.at(0.5)
    assert cost.core_seconds == cost.least_core_seconds == 0.5 * by_table.core_seconds
    assert (cost.basis, by_table.at(None)) == ("measured", by_table)
