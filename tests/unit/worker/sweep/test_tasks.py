"""One chunk: what is stored is what the kernel says of its cells, line by line, and nothing else."""

import errno
from unittest.mock import Mock

import numpy as np
import pytest
from chunks import cut_finely, planned, run_in_slices
from kernel_runs import Model, run_line
from scripted import small
from stores import files

from kernel.params import STATE_FIELDS, Cell, Outcome
from worker import store
from worker.study import ChunkOptions, ChunkPaused, Plan, PredecessorMissing
from worker.study.chunks import with_options
from worker.sweep import AXES, SweepSpec, task
from worker.sweep.plan import make_plan
from worker.sweep.task import run_chunk

RECORD = ("flight_time", "takeoff_phase", "flights", "outcome", "bounces", "periods")


def stored(tmp_path, spec: SweepSpec, shape=None) -> tuple[Plan, str]:
    url = str(tmp_path / "sweep.zarr")
    return planned(url, spec, shape), url


def naive_line(spec: SweepSpec, gamma, omega, xi, carry: bool):
    """The kernel called once for a whole line, without plan, chunk or store."""
    n = len(gamma)
    model = spec.model.model_dump()
    depth = model.get("penetration") or 1e-3
    if model.get("rest_length"):
        depth = 1e-4 * model["rest_length"] * omega**2 / gamma
    return run_line(
        gamma, omega, xi, model=Model[model["kind"].upper()],
        restitution=np.full(n, float(model["restitution"])),
        penetration=np.full(n, 1.0) * depth, adhesive=model.get("adhesive", True), carry=carry,
        settle=spec.window[0], observe=spec.observe, keep=spec.keep, micro_flight=spec.micro_flight,
        certify=spec.certifies, settle_until=spec.settles_until,
    )  # fmt: skip


def ramp(axis, direction):
    return {"kind": "ramp", "axis": axis, "direction": direction}


@pytest.mark.parametrize(
    "model",
    [
        {"kind": "rigid"},
        {"kind": "rigid", "restitution": 0.3},
        {"kind": "soft", "penetration": 1e-2},
        {"kind": "soft", "rest_length": 50.0, "adhesive": False},
    ],
    ids=["rigid", "rigid e", "soft", "soft rest length"],
)
def test_cells_from_rest_are_the_kernels(tmp_path, model):
    spec = small(model=model, gamma=[0.5, 1.5, 2.3, 3.6], micro_flight=1e-3)
    plan, url = stored(tmp_path, spec, (1, 2, 3))
    for chunk in plan:
        run_chunk(spec, chunk, url)
    found = store.read_slice(url, RECORD, direction=0)
    for place in np.ndindex(spec.shape[1:]):
        values = [np.array([spec.axis_values(axis)[i]]) for axis, i in zip(AXES, place, strict=True)]
        expected = naive_line(spec, *reversed(values), carry=False)
        for name in RECORD:
            assert np.array_equal(found[name][place], getattr(expected, name)[0], equal_nan=True), name


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("direction", ["up", "down"])
def test_ramp_carries_its_state_across_chunks(tmp_path, axis, direction):
    axes = {name: [0.4, 0.9] for name in AXES} | {axis: {"start": 0.2, "stop": 4.0, "num": 12}}
    spec = small(**axes, protocol=ramp(axis, direction))
    plan, url = stored(tmp_path, spec, tuple(5 if name == axis else 1 for name in AXES))
    for chunk in plan:
        run_chunk(spec, chunk, url)
    names = (*RECORD, "end_state")
    found = store.read_slice(url, names, direction=0)
    order = slice(None, None, -1 if direction == "down" else 1)
    beside = [name for name in AXES if name != axis]
    for place in np.ndindex(2, 2):
        fixed = {name: np.full(12, spec.axis_values(name)[i]) for name, i in zip(beside, place, strict=True)}
        values = fixed | {axis: spec.axis_values(axis)[order]}
        expected = naive_line(spec, values["gamma"], values["omega"], values["xi"], carry=True)
        where = tuple(slice(None) if name == axis else place[beside.index(name)] for name in AXES)
        for name in names:
            assert np.array_equal(found[name][where][order], getattr(expected, name), equal_nan=True), name


def test_ramp_without_predecessor_is_refused_and_writes_nothing(tmp_path):
    spec = small(protocol=ramp("gamma", "up"))
    plan, url = stored(tmp_path, spec, (2, 3, 5))
    message = "chunk 1 continues chunk 0 of the ramp, which is not stored"
    with pytest.raises(PredecessorMissing, match=message):
        run_chunk(spec, plan[1], url)
    assert not store.read_slice(url, ["outcome"])["outcome"].any()
    run_chunk(spec, plan[0], url)
    run_chunk(spec, plan[1], url)
    assert store.read_slice(url, ["outcome"])["outcome"].all()


def test_after_a_diverged_cell_a_ramp_starts_from_rest():
    cell = {name: np.ones(2) for name in Cell._fields}
    end = cell | {
        "end_state": np.zeros((2, len(STATE_FIELDS))),
        "outcome": np.array([Outcome.DIVERGED, Outcome.PERIODIC]),
    }
    assert task._start_at(end, (0,)) is None
    assert task._start_at(end, (1,)).cell == Cell(1.0, 1.0, 1.0)


def test_chunk_that_cannot_be_stored_is_not_computed(tmp_path):
    """Computing it would take an hour."""
    spec = small(gamma=[2.0, 3.0], settle=10_000_000)
    with pytest.raises(store.StoreMissing, match="no store here"):
        run_chunk(spec, make_plan(spec, (1, 1, 12))[0], str(tmp_path / "nowhere.zarr"))
    _, url = stored(tmp_path, spec, (1, 3, 2))
    with pytest.raises(store.StoreConflict, match="spans xi 0 to 2, but chunks here are 1 long"):
        run_chunk(spec, make_plan(spec, chunk_shape=(2, 3, 2))[0], url)


def test_a_checkpoint_of_another_line_begins_anew(tmp_path, monkeypatch):
    cut_finely(monkeypatch, 100)
    spec = small(model={"kind": "soft"}, protocol=ramp("gamma", "up"), exponents=1)
    plan, url = stored(tmp_path, spec, (2, 3, 10))
    saved = {"done": 0}
    while saved["done"] < 2:
        with pytest.raises(ChunkPaused, match="paused after"), with_options(ChunkOptions(0.0)):
            run_chunk(spec, plan[0], url)
        saved = store.read_checkpoint(url, 0)
    assert not store.read_slice(url, ["outcome"])["outcome"].any()
    shorter = {name: array[..., :1] if array.ndim else array for name, array in saved.items()}
    store.write_checkpoint(url, 0, shorter)
    run_in_slices(spec, plan[0], url)
    _, whole = stored(tmp_path / "whole", spec, plan.chunk_shape)
    run_chunk(spec, plan[0], whole)
    assert files(url) == files(whole)


def test_a_chunk_whose_checkpoint_cannot_be_written_goes_on(tmp_path, monkeypatch, caplog):
    cut_finely(monkeypatch, 100)
    spec = small()
    plan, url = stored(tmp_path, spec)
    _, whole = stored(tmp_path / "whole", spec)
    full = Mock(side_effect=OSError(errno.ENOSPC, "No space left on device"))
    monkeypatch.setattr("worker.store.write_checkpoint", full)
    with with_options(ChunkOptions(0.0, begins=True)):
        run_chunk(spec, plan[0], url)
    run_chunk(spec, plan[0], whole)
    assert files(url) == files(whole)
    (warning,) = (record.getMessage() for record in caplog.records)  # it does not try again
    assert "chunk 0 cannot pause, its checkpoint cannot be written" in warning


def test_an_error_names_the_cells(tmp_path, monkeypatch):
    spec = small(gamma=[1.0, 2.0, 3.5], omega=0.5, xi=0.05)
    plan, url = stored(tmp_path, spec)
    monkeypatch.setattr(task, "line_run", None)
    with pytest.raises(TypeError) as caught:
        run_chunk(spec, plan[0], url)
    assert caught.value.__notes__ == ["in the cells gamma 1 to 3.5, omega 0.5 to 0.5, xi 0.05 to 0.05"]
