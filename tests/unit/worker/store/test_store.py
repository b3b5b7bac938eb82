"""The store: opens with plain xarray, reads back what was written, never returns damaged bytes as data."""

import json
import os
import re
import shutil
from dataclasses import replace
from functools import partial
from itertools import count as count_from
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import zarr
from chunks import planned
from hypothesis import given
from hypothesis import strategies as st
from scripted import small
from stores import files
from tables import for_each

from worker import store
from worker.store import backend, reader
from worker.store import store as stored
from worker.study import Array, Chunk, Plan
from worker.study import layout as cutting
from worker.sweep import SweepSpec, schema
from worker.sweep.plan import make_plan
from worker.sweep.schema import layout


@pytest.fixture
def spec() -> SweepSpec:
    return small(protocol={"kind": "ramp", "axis": "gamma", "direction": "both"}, name="a label")


@pytest.fixture
def plan(tmp_path, spec) -> Plan:
    return planned(tmp_path / "sweep.zarr", spec, (1, 2, 4))


@pytest.fixture
def url(tmp_path, plan) -> str:
    return str(tmp_path / "sweep.zarr")


def record_of(spec: SweepSpec, chunk: Chunk, seed: int = 0) -> dict[str, np.ndarray]:
    """Numbers of the right kinds and shapes; no physics."""
    random = np.random.default_rng([seed, chunk.index])
    length = schema.sizes(spec)

    def some(array: Array) -> np.ndarray:
        shape = (*chunk.shape, *(length[dim] for dim in array.extra_dims))
        return random.integers(1, 5, shape).astype(array.dtype)

    return {array.name: some(array) for array in schema.arrays(spec)}


def test_a_store_of_time_steps_states_their_limit(tmp_path):
    """The longest step of any cell, and the shortest that is unstable in one."""
    spec = SweepSpec(gamma=[1.0, 2.0], omega=[0.1, 3.0], xi=[0.1, 20.0], model={"kind": "stepped"})
    planned(tmp_path / "steps.zarr", spec)
    steps = store.read_attrs(str(tmp_path / "steps.zarr"))["time_steps"]
    assert 0.0 < steps["longest_step"] < steps["stable_below"]


def test_another_sweep_or_another_cut_is_not_overwritten(url, spec, plan):
    with pytest.raises(store.StoreConflict, match="holds job"):
        store.create(url, layout(small(settle=21), plan.chunk_shape))
    with pytest.raises(store.StoreConflict, match=r"is cut into chunks of \[1, 2, 4\], not \[2, 3, 10\]"):
        store.create(url, layout(spec, make_plan(spec, chunk_shape=(2, 3, 10)).chunk_shape))


def test_a_file_in_the_place_of_a_store_gives_way(url, spec, plan):
    intact = files(url)
    shutil.rmtree(url)
    Path(url).write_text("no store")
    store.create(url, layout(spec, plan.chunk_shape))
    assert files(url) == intact


@pytest.fixture(scope="module")
def full(tmp_path_factory) -> tuple[str, dict[str, np.ndarray]]:
    """A store with every chunk written, and all of it as zarr reads it."""
    spec = small(protocol={"kind": "ramp", "axis": "gamma", "direction": "both"})
    url = str(tmp_path_factory.mktemp("full") / "sweep.zarr")
    for chunk in planned(url, spec, (2, 2, 4)):
        store.write_chunk(url, chunk, record_of(spec, chunk))
    with xr.open_zarr(url) as dataset:
        return url, {name: dataset[name].values for name in ("end_state", "bounces")}


def indices(length: int) -> st.SearchStrategy[int | slice]:
    """Indices along an axis: an integer, also negative, or a slice with a step, also an empty one."""
    ends = st.none() | st.integers(-length - 1, length + 1)
    return st.integers(-length, length - 1) | st.builds(
        slice, ends, ends, st.none() | st.integers(1, length + 1)
    )


@given(st.tuples(*map(indices, (2, 2, 3, 10))))
def test_any_part_reads_as_zarr_reads_it(full, where):
    url, whole = full
    axes = dict(zip(("direction", "xi", "omega", "gamma"), where, strict=True))
    for name, array in store.read_slice(url, list(whole), **axes).items():
        np.testing.assert_array_equal(array, whole[name][where])
        assert array.dtype == whole[name].dtype


def test_chunk_of_fill_values_is_written_all_the_same(url, spec, plan):
    """zarr leaves such chunks out by default, and their checksum with them."""
    record = {
        array.name: np.full_like(record_of(spec, plan[0])[array.name], array.fill)
        for array in schema.arrays(spec)
    }
    before = set(files(url))
    store.write_chunk(url, plan[0], record)
    assert len(set(files(url)) - before) == len(record)


def test_a_chunk_that_is_not_the_stores_own_is_refused_before_it_is_computed(url, spec, plan, tmp_path):
    for chunk in plan:
        store.check_chunk(url, chunk, schema.arrays(spec))
    xi, omega, _ = plan[0].spans
    shifted = replace(plan[0], spans=(xi, omega, (2, 6)))
    for spans in ((xi, omega, (2, 6)), (xi, omega, (2, 4)), (xi, (0, 1), plan[0].spans[2])):
        wrong = replace(plan[0], spans=spans)
        with pytest.raises(store.StoreConflict, match="but chunks here are"):
            store.check_chunk(url, wrong, schema.arrays(spec))
    with pytest.raises(store.StoreConflict, match="spans gamma 2 to 6, but chunks here are 4 long"):
        store.write_chunk(url, shifted, record_of(spec, shifted))
    with pytest.raises(store.StoreMissing):
        store.check_chunk(str(tmp_path / "none.zarr"), plan[0], schema.arrays(spec))


def flip(path: Path, seed: int) -> None:
    content = bytearray(path.read_bytes())
    content[seed % len(content)] ^= 1 << seed % 8
    path.write_bytes(content)


def cut(path: Path, seed: int) -> None:
    path.write_bytes(path.read_bytes()[: seed % path.stat().st_size])


def delete(path: Path, seed: int) -> None:
    path.unlink()


def test_of_a_complete_store_every_file_must_be_there(url, spec, plan):
    """And where there are outcomes, every other file: they come last, so without them nothing is read."""
    names = ["flights", "flight_time", "outcome"]
    for chunk in plan[:2]:
        store.write_chunk(url, chunk, record_of(spec, chunk))
    Path(url, "outcome", "c.0.0.0.0").unlink()
    Path(url, "flights", "c.0.0.1.0").unlink()
    for chunk, complete, missing in (
        (plan[0], True, "outcome/c.0.0.0.0"),
        (plan[1], False, "flights/c.0.0.1.0"),
    ):
        with pytest.raises(store.StoreDamaged, match=rf"{re.escape(missing)}: is missing$"):
            store.read_chunk(url, chunk, names, complete=complete)
    cells = store.read_chunk(url, plan[0], names)
    assert not cells["outcome"].any()
    assert not cells["flights"].any()
    assert np.isnan(cells["flight_time"]).all()


@pytest.mark.parametrize("content", [b"", b"{}", b"[1]", b'{"consolidated_metadata": 3}'])
def test_nothing_is_read_with_damaged_metadata(url, content):
    (Path(url) / "zarr.json").write_bytes(content)
    with pytest.raises(store.StoreError):
        store.read_attrs(url)
    with pytest.raises(store.StoreError):
        store.read_slice(url, ["outcome"])


def test_a_store_that_is_not_finished_or_has_no_outcomes_is_said(url):
    root = Path(url) / "zarr.json"
    document = json.loads(root.read_text())
    del document["consolidated_metadata"]["metadata"]["outcome"]
    root.write_text(json.dumps(document))
    with pytest.raises(store.StoreDamaged, match="no outcomes in it"):
        store.read_slice(url, ["flights"])
    root.write_text(json.dumps(document | {"consolidated_metadata": None}))
    with pytest.raises(store.StoreMissing, match="creation was interrupted"):
        store.read_slice(url, ["flights"])
    root.unlink()
    for read in (store.read_attrs, lambda url: store.read_slice(url, ["flights"])):
        with pytest.raises(store.StoreMissing, match="no store here"):
            read(url)


def test_bytes_are_those_that_zarr_writes_with_a_seal_behind(url, spec, plan):
    """The last chunk along every axis is not whole."""
    for chunk in plan:
        store.write_chunk(url, chunk, record_of(spec, chunk))
    before = files(url)
    group = zarr.open_group(url, mode="r+")
    for chunk in plan:
        for name, values in record_of(spec, chunk).items():
            array = group[name].with_config({"write_empty_chunks": True})
            array[chunk.slices] = values[None]
    assert files(url) == {
        key: content[:-24] if "/c." in key and "_code" not in key else content
        for key, content in before.items()
    }


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), OSError(5, "Input/output error")])
def test_a_chunk_that_cannot_be_written_leaves_nothing(url, spec, plan, monkeypatch, error):
    before, real, count = files(url), os.fsync, count_from(0)

    def fsync(descriptor: int) -> None:
        if next(count) == 3:
            raise error
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(OSError, match=error.strerror):
        store.write_chunk(url, plan[0], record_of(spec, plan[0]))
    assert files(url) == before


@pytest.mark.parametrize("step", ["place", "delete"])
def test_a_chunk_of_which_one_file_is_there_or_gone_reads_as_missing(url, spec, plan, monkeypatch, step):
    """Outcomes are written last and removed first."""
    record, real, count = record_of(spec, plan[0]), getattr(backend, step), count_from(0)
    if step == "delete":
        store.write_chunk(url, plan[0], record)

    def one(*given: Any) -> None:
        if next(count) == 1:
            raise OSError(5, "Input/output error")
        real(*given)

    monkeypatch.setattr(backend, step, one)
    write, cut = partial(store.write_chunk, url, plan[0], record), layout(spec, plan.chunk_shape)
    with pytest.raises(OSError, match="Input/output error"):
        (write if step == "place" else partial(store.discard, url, cut, plan[0]))()
    assert not store.read_chunk(url, plan[0], ["outcome"])["outcome"].any()


def test_a_store_that_is_removed_meanwhile_is_not_made_again(url, spec, plan, monkeypatch):
    real = stored.write_keys

    def removed(*given: Any, **more: Any) -> None:
        shutil.rmtree(url)
        real(*given, **more)

    monkeypatch.setattr(stored, "write_keys", removed)
    with pytest.raises(store.StoreMissing):
        store.write_chunk(url, plan[0], record_of(spec, plan[0]))
    assert not Path(url).exists()


@pytest.fixture
def sharded(tmp_path, spec, monkeypatch) -> tuple[str, Plan]:
    """A store whose larger arrays have shards of 2 × 2 × 2 inner chunks."""
    for name, size in (("WHOLE_BYTES", 1000), ("INNER_BYTES", 300)):
        monkeypatch.setattr(cutting, name, size)
    url = str(tmp_path / "sharded.zarr")
    plan = planned(url, spec, (2, 2, 8))
    for chunk in plan:
        store.write_chunk(url, chunk, record_of(spec, chunk))
    return url, plan


@for_each(("where", "decoded", "ranges"), [
    ({"xi": 0, "omega": 0, "gamma": 0}, 1, 2),  # the index, then the part
    ({"xi": 1, "omega": 1, "gamma": slice(0, 8)}, 2, 2),
    ({"xi": 1, "gamma": slice(0, 8), "omega": slice(0, 2)}, 4, 0),  # half: the whole file
])  # fmt: skip
def test_of_a_shard_only_the_parts_that_are_needed_are_read(sharded, monkeypatch, where, decoded, ranges):
    url, _ = sharded
    calls = []
    for module, name in ((reader, "decode"), (backend, "read_parts")):
        real = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *given, real=real: calls.append(given) or real(*given))
    store.read_slice(url, ["flight_time"], direction=0, **where)
    assert [len(given[0].dims) for given in calls if given[0] != url].count(5) == decoded
    assert len([given for given in calls if given[0] == url]) == ranges


def test_a_damaged_part_is_noticed_by_those_who_need_it(sharded):
    url, _ = sharded
    flip(Path(url) / "flight_time" / "c.0.0.0.0.0", 60)
    with pytest.raises(store.StoreDamaged, match="cannot be decoded"):
        store.read_slice(url, ["flight_time"], direction=0, xi=0, omega=0, gamma=0)
    store.read_slice(url, ["flight_time"], direction=0, xi=1, omega=0, gamma=0)


@pytest.mark.parametrize("damage", [flip, cut, delete])
def test_damage_to_a_shard_is_noticed(sharded, spec, damage):
    url, plan = sharded
    for number, path in enumerate(sorted(Path(url).glob("*/c.0.0.0.0*")) * 3):
        kept = path.read_bytes()
        damage(path, len(kept) - 1 - 5 * number)
        with pytest.raises(store.StoreDamaged) as caught:
            store.read_chunk(url, plan[0], [array.name for array in schema.arrays(spec)], complete=True)
        assert caught.value.chunks == ((0, 0, 0, 0),)
        path.write_bytes(kept)
