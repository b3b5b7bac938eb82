"""The store: opens with plain xarray, reads back what was written, never returns damaged bytes as data."""

import json
import math
import os
import shutil
import threading
import warnings
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import count as count_from
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import zarr
from hypothesis import given
from hypothesis import strategies as st
from stores import checksum, is_sound
from zarr.errors import ZarrUserWarning

from kernel.params import KERNEL_VERSION, STATE_FIELDS, Outcome
from worker import schema, store
from worker.plan import Chunk, Plan, make_plan
from worker.schema import layout
from worker.spec import SweepSpec
from worker.spec.errors import SpecError
from worker.store import backend, cancel_flag, reader
from worker.store import chunks as stored
from worker.store import store as zarr_store


@pytest.fixture
def spec(small_spec) -> SweepSpec:
    return small_spec(protocol={"kind": "ramp", "axis": "gamma", "direction": "both"}, name="a label")


@pytest.fixture
def plan(spec) -> Plan:
    return make_plan(spec, chunk_shape=(1, 2, 4))


@pytest.fixture
def url(tmp_path, spec, plan) -> str:
    url = str(tmp_path / "sweep.zarr")
    store.create(url, layout(spec, plan.chunk_shape))
    return url


def record_of(spec: SweepSpec, chunk: Chunk, seed: int = 0) -> dict[str, np.ndarray]:
    """Numbers of the right kinds and shapes; no physics."""
    random = np.random.default_rng([seed, chunk.index])
    length = schema.sizes(spec)

    def some(array: schema.Array) -> np.ndarray:
        shape = (*chunk.shape, *(length[dim] for dim in array.extra_dims))
        return random.integers(1, 5, shape).astype(array.dtype)

    return {array.name: some(array) for array in schema.arrays(spec)}


def files(url: str) -> dict[str, bytes]:
    return {str(path.relative_to(url)): path.read_bytes() for path in Path(url).rglob("*") if path.is_file()}


# Reading with xarray


def test_opens_with_plain_xarray(url, spec):
    with xr.open_zarr(url) as dataset:
        assert dict(dataset.sizes) == {
            "direction": 2, "xi": 2, "omega": 3, "gamma": 10, "flight": 8, "state": len(STATE_FIELDS)
        }  # fmt: skip
        assert dataset["direction"].values.tolist() == ["up", "down"]
        for axis in ("gamma", "omega", "xi"):
            assert dataset[axis].values.tolist() == spec.axis_values(axis).tolist()
            assert dataset[axis].attrs["long_name"]
        assert dataset["flight_time"].dims == ("direction", "xi", "omega", "gamma", "flight")
        assert dataset["takeoff_phase"].dims == dataset["flight_time"].dims
        for name, dtype in (("flights", "i4"), ("outcome", "u1"), ("bounces", "i4"), ("periods", "i4")):
            assert dataset[name].dims == ("direction", "xi", "omega", "gamma")
            assert dataset[name].dtype == np.dtype(dtype)
        assert dataset["flight_time"].attrs["units"] == "rad"
        assert dataset["end_state"].attrs["fields"].split() == list(STATE_FIELDS)
        assert dataset["outcome"].attrs["flag_meanings"].split()[3] == "at_rest"


@pytest.mark.parametrize("name", ["gamma", "flight"])
def test_an_array_named_like_a_dimension_is_refused(spec, plan, name):
    whole = layout(spec, plan.chunk_shape)
    assert name in {*whole.chunk_sizes, *whole.extra_sizes}
    renamed = (whole.arrays[0]._replace(name=name), *whole.arrays[1:])
    with pytest.raises(ValueError, match=f"arrays named like dimensions: {name}"):
        replace(whole, arrays=renamed)


def test_slices_by_name(url, spec, plan):
    chunk = plan[0]
    record = record_of(spec, chunk)
    store.write_chunk(url, chunk, record)
    with xr.open_zarr(url) as dataset:
        cell = dataset.sel(direction="up", gamma=1.5, omega=0.5, xi=0.05, method=None)
        assert cell["flight_time"].values.tolist() == record["flight_time"][0, 0, 2].tolist()


def test_nothing_is_missing_but_outcomes(url):
    with xr.open_zarr(url) as dataset:
        assert np.all(dataset["outcome"] == Outcome.MISSING)
        assert np.all(np.isnan(dataset["flight_time"]))
        assert np.all(dataset["flights"] == 0)


def test_attributes_say_what_it_is(url, spec):
    attrs = store.read_attrs(url)
    assert SweepSpec.parse(attrs["spec"]) == spec
    assert attrs["job"] == spec.job_id(KERNEL_VERSION)
    assert attrs["kernel_version"] == KERNEL_VERSION
    assert attrs["model"] == "rigid"
    assert "time_steps" not in attrs
    assert attrs["title"] == "a label"
    assert attrs["Conventions"].startswith("CF-")


def test_attributes_are_texts_and_numbers(url):
    attrs = dict(zarr.open_group(url, mode="r").attrs)
    assert all(isinstance(value, str | int | float) for value in attrs.values())
    assert json.loads(attrs["spec"]) == store.read_attrs(url)["spec"]
    assert json.loads(attrs["chunk_shape"]) == list(store.chunk_shape(url))


def test_a_reader_without_text_finds_directions_as_numbers(url, spec):
    with xr.open_zarr(url) as dataset:
        code = dataset["direction_code"]
        assert (code.dims, code.dtype) == (("direction",), np.uint8)
        meanings = dict(
            zip(np.atleast_1d(code.attrs["flag_values"]), code.attrs["flag_meanings"].split(), strict=True)
        )
        assert [meanings[value] for value in code.values] == dataset.direction.values.tolist()
        assert "direction_code" in dataset.outcome.coords
    others = (name for name in zarr.open_group(url, mode="r") if name != "direction")
    types = {json.loads((Path(url) / name / "zarr.json").read_text())["data_type"] for name in others}
    assert types <= {"float64", "int32", "uint8"}  # of the specification's own


@pytest.mark.parametrize("scheme", ["verlet", "euler"])
def test_a_store_of_time_steps_states_their_limit(tmp_path, scheme):
    """The longest step of any cell, and the shortest that is unstable in one: the last is refused."""
    model = {"kind": "stepped", "scheme": scheme, "penetration": 0.05, "steps_per_contact": 200}
    axes = {"gamma": [1.0, 2.0], "omega": [0.1, 3.0], "xi": [0.1, 20.0]}
    spec = SweepSpec(**axes, model=model)
    store.create(str(tmp_path / "sweep.zarr"), layout(spec, make_plan(spec).chunk_shape))
    steps = store.read_attrs(str(tmp_path / "sweep.zarr"))["time_steps"]
    assert 0.0 < steps["longest_step"] < steps["stable_below"]
    fewest = steps["fewest_stable_steps_per_contact"]
    SweepSpec(**axes, model=model | {"steps_per_contact": fewest})
    if fewest > 1:
        with pytest.raises(SpecError, match=f"must be at least {fewest}, not {fewest - 1}"):
            SweepSpec(**axes, model=model | {"steps_per_contact": fewest - 1})


def test_attributes_of_the_creator_are_kept(tmp_path, spec, plan):
    url = str(tmp_path / "other.zarr")
    store.create(url, layout(spec, plan.chunk_shape), {"institution": "here"})
    assert store.read_attrs(url)["institution"] == "here"


def test_rest_stores_no_state_to_carry_on_from(tmp_path, small_spec):
    url = str(tmp_path / "rest.zarr")
    store.create(url, layout(small_spec(), make_plan(small_spec()).chunk_shape))
    with xr.open_zarr(url) as dataset:
        assert "end_state" not in dataset
        assert dataset["direction"].values.tolist() == ["rest"]


def test_metadata_is_consolidated_and_the_same_every_time(tmp_path, url, spec, plan):
    again = str(tmp_path / "again.zarr")
    store.create(again, layout(spec, plan.chunk_shape))
    assert files(again) == files(url)
    assert "consolidated_metadata" in json.loads((Path(url) / "zarr.json").read_text())


def test_consolidated_metadata_is_what_zarr_writes(tmp_path, url):
    other = str(tmp_path / "other.zarr")
    shutil.copytree(url, other)
    with pytest.warns(ZarrUserWarning):
        zarr.consolidate_metadata(other, zarr_format=3)
    assert files(other) == files(url)


# Creation


def test_creation_raises_no_warning_while_other_threads_change_the_filters(tmp_path, spec, plan):
    """Warning filters belong to the process: a thread that leaves `catch_warnings` restores them for all."""
    stop = threading.Event()

    def change_filters() -> None:
        while not stop.is_set():
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                stop.wait(0.001)

    thread = threading.Thread(target=change_filters)
    thread.start()
    try:
        for number in range(20):
            store.create(str(tmp_path / f"{number}.zarr"), layout(spec, plan.chunk_shape))
    finally:
        stop.set()
        thread.join()


def test_the_root_is_written_once_all_else_is_there(tmp_path, spec, plan, monkeypatch):
    """A store whose root has the metadata of all arrays is complete."""
    named, real = [], os.replace
    monkeypatch.setattr(os, "replace", lambda *given: (real(*given), named.append(Path(given[1])))[0])
    url = tmp_path / "new.zarr"
    store.create(str(url), layout(spec, plan.chunk_shape))
    assert len(named) == len(set(named)) > 7
    assert named[-1] == url / "zarr.json"
    named.clear()
    for name in ("zarr.json", "outcome/zarr.json"):
        (url / name).unlink()
    assert store.repair_metadata(str(url), layout(spec, plan.chunk_shape))[-1] == "zarr.json"
    assert named == [url / "outcome" / "zarr.json", url / "zarr.json"]


def test_creating_it_again_changes_nothing(url, spec, plan):
    store.write_chunk(url, plan[0], record_of(spec, plan[0]))
    before = files(url)
    store.create(url, layout(spec, plan.chunk_shape))
    assert files(url) == before


def test_creation_that_was_interrupted_is_finished(url, spec, plan):
    before = files(url)
    root = Path(url) / "zarr.json"
    metadata = json.loads(root.read_text())
    del metadata["consolidated_metadata"]
    root.write_text(json.dumps(metadata))
    (Path(url) / "outcome" / "zarr.json").unlink()
    with pytest.raises(store.StoreMissing, match="was interrupted"):
        store.read_attrs(url)
    store.create(url, layout(spec, plan.chunk_shape))
    assert files(url) == before


def test_another_sweep_is_not_overwritten(url, small_spec, plan):
    with pytest.raises(store.StoreConflict, match="holds job"):
        store.create(url, layout(small_spec(settle=21), plan.chunk_shape))


def test_another_cut_is_not_overwritten(url, spec):
    with pytest.raises(store.StoreConflict, match=r"is cut into chunks of \[1, 2, 4\], not \[2, 3, 10\]"):
        store.create(url, layout(spec, make_plan(spec, chunk_shape=(2, 3, 10)).chunk_shape))
    store.create(url, layout(spec, make_plan(spec, chunk_shape=store.chunk_shape(url)).chunk_shape))


# Writing and reading


def test_every_chunk_reads_back_as_written(url, spec, plan):
    written = {chunk: record_of(spec, chunk) for chunk in plan}
    for chunk, record in written.items():
        store.write_chunk(url, chunk, record)
    for chunk, record in written.items():
        stored = store.read_chunk(url, chunk, record)
        assert all(np.array_equal(stored[name], record[name]) for name in record)


def test_reads_touch_any_part_of_the_grid(url, spec, plan):
    for chunk in plan:
        store.write_chunk(url, chunk, record_of(spec, chunk))
    with xr.open_zarr(url) as dataset:
        part = store.read_slice(url, ["flight_time", "outcome"], direction=1, omega=2, gamma=slice(3, 9))
        assert np.array_equal(part["flight_time"], dataset["flight_time"][1, :, 2, 3:9])
        assert np.array_equal(part["outcome"], dataset["outcome"][1, :, 2, 3:9])
        assert part["flight_time"].shape == (2, 6, 8)


@pytest.fixture(scope="module")
def full(tmp_path_factory, small_spec) -> tuple[str, dict[str, np.ndarray]]:
    """A store with every chunk written, and all of it as zarr reads it."""
    spec = small_spec(protocol={"kind": "ramp", "axis": "gamma", "direction": "both"})
    plan, url = make_plan(spec, chunk_shape=(2, 2, 4)), str(tmp_path_factory.mktemp("full") / "sweep.zarr")
    store.create(url, layout(spec, plan.chunk_shape))
    for chunk in plan:
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


@pytest.mark.parametrize("index", [10, -11])
def test_reads_outside_the_grid_are_refused(url, index):
    with pytest.raises(IndexError):
        store.read_slice(url, ["outcome"], gamma=index)


def test_what_a_chunk_without_outcomes_holds_is_not_read(url, spec, plan):
    """Its writer is not done: outcomes come last."""
    store.write_chunk(url, plan[0], record_of(spec, plan[0]))
    (Path(url) / "outcome" / "c.0.0.0.0").unlink()
    cells = store.read_chunk(url, plan[0], ["outcome", "flights", "flight_time"])
    assert not cells["outcome"].any()
    assert not cells["flights"].any()
    assert np.isnan(cells["flight_time"]).all()


def test_coordinates(url, spec):
    coordinates = store.read_coordinates(url)
    assert coordinates["direction"].tolist() == ["up", "down"]
    assert coordinates["gamma"].tolist() == spec.axis_values("gamma").tolist()


def test_same_record_gives_the_same_bytes(url, spec, plan):
    record = record_of(spec, plan[1])
    first = store.write_chunk(url, plan[1], record)
    before = files(url)
    assert store.write_chunk(url, plan[1], record) == first
    assert first.checksum == checksum(url, layout(spec, plan.chunk_shape), plan[1])
    assert files(url) == before
    assert store.write_chunk(url, plan[1], record_of(spec, plan[1], seed=1)) != first


def test_chunk_of_fill_values_is_written_all_the_same(url, spec, plan):
    """zarr leaves such chunks out by default, and their checksum with them."""
    record = {
        array.name: np.full_like(record_of(spec, plan[0])[array.name], array.fill)
        for array in schema.arrays(spec)
    }
    before = set(files(url))
    store.write_chunk(url, plan[0], record)
    assert len(set(files(url)) - before) == len(record)


def test_a_chunk_can_be_checked_before_it_is_computed(url, spec, plan, tmp_path):
    for chunk in plan:
        store.check_chunk(url, chunk, schema.arrays(spec))
    shifted = replace(plan[0], gamma=(2, 6))
    for wrong in (shifted, replace(plan[0], gamma=(2, 4)), replace(plan[0], omega=(0, 1))):
        with pytest.raises(store.StoreConflict, match="but chunks here are"):
            store.check_chunk(url, wrong, schema.arrays(spec))
    with pytest.raises(store.StoreMissing):
        store.check_chunk(str(tmp_path / "none.zarr"), plan[0], schema.arrays(spec))


def test_chunk_that_is_not_the_stores_own_is_refused(url, spec):
    chunk = make_plan(spec, chunk_shape=(1, 2, 5))[0]
    with pytest.raises(store.StoreConflict, match="spans gamma 0 to 5, but chunks here are 4 long"):
        store.write_chunk(url, chunk, record_of(spec, chunk))


def test_concurrent_writers_of_different_chunks_lose_nothing(url, spec, plan):
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda chunk: store.write_chunk(url, chunk, record_of(spec, chunk)), plan))
    for chunk in plan:
        expected = record_of(spec, chunk)
        stored = store.read_chunk(url, chunk, expected)
        assert all(np.array_equal(stored[name], expected[name]) for name in expected)


# Damage


def stored_files(url: str, chunk: Chunk) -> list[Path]:
    coords = f"{chunk.direction}.{chunk.xi[0]}.{chunk.omega[0] // 2}.{chunk.gamma[0] // 4}"
    paths = [*Path(url).glob(f"*/c.{coords}"), *Path(url).glob(f"*/c.{coords}.0")]
    return sorted(path for path in paths if path.is_file())


def flip(path: Path, seed: int) -> None:
    content = bytearray(path.read_bytes())
    content[seed % len(content)] ^= 1 << seed % 8
    path.write_bytes(content)


def cut(path: Path, seed: int) -> None:
    path.write_bytes(path.read_bytes()[: seed % path.stat().st_size])


def delete(path: Path, seed: int) -> None:
    path.unlink()


@pytest.mark.parametrize("damage", [flip, cut, delete])
def test_any_damage_to_a_chunk_is_noticed(url, spec, plan, damage):
    chunk = plan[2]
    record = record_of(spec, chunk)
    good, cut_as = store.write_chunk(url, chunk, record), layout(spec, plan.chunk_shape)
    names = stored_files(url, chunk)
    assert len(names) == len(record)
    for number, path in enumerate(names * 6):
        kept = path.read_bytes()
        damage(path, 7 * number + 1)
        assert not is_sound(url, cut_as, chunk, good.checksum)
        path.write_bytes(kept)
    assert is_sound(url, cut_as, chunk, good.checksum)


@pytest.mark.parametrize("damage", [flip, cut])
def test_damaged_bytes_are_never_read_as_data(url, spec, plan, damage):
    chunk = plan[2]
    record = record_of(spec, chunk)
    store.write_chunk(url, chunk, record)
    for path in stored_files(url, chunk):
        damage(path, path.stat().st_size // 2)
    for name in record:
        with pytest.raises(store.StoreDamaged, match="cannot be decoded"):
            store.read_chunk(url, chunk, [name])


def test_damaged_chunk_can_be_written_anew(url, spec, plan):
    chunk = plan[2]
    good = store.write_chunk(url, chunk, record_of(spec, chunk))
    for path in stored_files(url, chunk):
        cut(path, 9)
    assert store.write_chunk(url, chunk, record_of(spec, chunk)) == good


@pytest.mark.parametrize("content", [b"", b"{}", b"[1]", b'{"zarr_format": 3}'])
def test_damaged_metadata_is_said(url, content):
    (Path(url) / "zarr.json").write_bytes(content)
    with pytest.raises(store.StoreError):
        store.read_attrs(url)


def test_no_store_is_said(tmp_path):
    nowhere = str(tmp_path / "nowhere.zarr")
    with pytest.raises(store.StoreMissing, match="no store here"):
        store.read_attrs(nowhere)
    assert not Path(nowhere).exists()


def test_of_a_bucket_the_form_of_a_store_is_remembered_for_a_moment(url, monkeypatch):
    reads, read = [], zarr_store.forms_of
    monkeypatch.setattr(zarr_store, "forms_of", lambda root: reads.append(root) or read(root))
    for number in (1, 2):
        assert reader.OUTCOME in zarr_store._forms(url)
        assert len(reads) == number
    monkeypatch.setattr(zarr_store, "in_bucket", lambda _: True)
    for _ in range(3):
        assert reader.OUTCOME in zarr_store._forms(url)
        assert len(reads) == 3
    monkeypatch.setattr(zarr_store, "REMEMBERED_SECONDS", -1.0)
    assert reader.OUTCOME in zarr_store._forms(url)
    assert len(reads) == 4


def test_only_folders_and_buckets_can_hold_a_store(spec, plan):
    with pytest.raises(store.StoreError, match="only folders and s3://"):
        store.create("gs://bucket/sweep.zarr", layout(spec, plan.chunk_shape))


def test_leftovers_of_killed_writers_are_swept(url, spec, plan):
    store.write_chunk(url, plan[0], record_of(spec, plan[0]))
    before = files(url)
    for name in (".partial/0.partial", ".checkpoint-0.0.partial"):
        (Path(url) / name).write_bytes(b"half")
    assert store.sweep_leftovers(url) == 2
    assert store.sweep_leftovers(url) == 0
    assert files(url) == before


@pytest.mark.parametrize("missing", ["outcome", "flights"])
def test_of_a_complete_store_every_file_must_be_there(url, spec, plan, missing):
    """And where there are outcomes, every other file."""
    for chunk in plan[:2]:
        store.write_chunk(url, chunk, record_of(spec, chunk))
    Path(url, missing, "c.0.0.0.0").unlink()
    names = ["flights", "outcome"]
    for complete in (True, False):
        if missing == "outcome" and not complete:
            assert not store.read_chunk(url, plan[0], names)["outcome"].any()
            continue
        with pytest.raises(store.StoreDamaged, match=rf"{missing}/c\.0\.0\.0\.0: is missing$") as caught:
            store.read_chunk(url, plan[0], names, complete=complete)
        assert caught.value.chunks == ((0, 0, 0, 0),)
    assert store.read_chunk(url, plan[1], names, complete=True)["outcome"].all()


def test_a_dimension_that_is_not_there_is_named(url):
    with pytest.raises(IndexError, match=r"^there is no dimension phase; there are direction, xi, omega, g"):
        store.read_slice(url, ["outcome"], phase=0)


@pytest.mark.parametrize("content", [b"", b"{}", b"[1]", b"null", b'{"consolidated_metadata": 3}'])
def test_cells_are_not_read_with_damaged_metadata(url, content):
    (Path(url) / "zarr.json").write_bytes(content)
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
    with pytest.raises(store.StoreMissing, match="no store here"):
        store.read_slice(url, ["flights"])


# The cancel flag


def test_cancel_flag_is_no_part_of_the_store(url):
    before = files(url)
    assert not store.is_cancelled(url)
    store.set_cancelled(url)
    store.set_cancelled(url)
    assert store.is_cancelled(url)
    assert files(url) == before
    store.clear_cancelled(url)
    store.clear_cancelled(url)
    assert not store.is_cancelled(url)


def test_cancel_flag_before_there_is_a_store(tmp_path, spec, plan):
    url = str(tmp_path / "stores" / "later.zarr")
    store.set_cancelled(url)
    store.create(url, layout(spec, plan.chunk_shape))
    assert store.is_cancelled(url)


def test_in_a_bucket_a_flag_that_is_not_set_is_remembered_for_a_moment(monkeypatch):
    flags, asked = set(), []
    monkeypatch.setattr(cancel_flag, "_unset", {})
    monkeypatch.setattr(cancel_flag, "MOST_REMEMBERED", 2)
    monkeypatch.setattr(cancel_flag, "REMEMBERED_SECONDS", 600.0)
    monkeypatch.setattr(backend, "put_flag", flags.add)
    monkeypatch.setattr(backend, "has_flag", lambda url: asked.append(url) or url in flags)
    first, second, third = (f"s3://bucket/{name}.zarr" for name in "abc")
    for url in (first, second, first, second):
        assert store.is_cancelled(url) is False
    assert asked == [f"{first}.cancelled", f"{second}.cancelled"]
    store.set_cancelled(first)  # by this process, which need not wait
    for _ in range(2):
        assert store.is_cancelled(first) is True
    assert len(asked) == 4
    assert store.is_cancelled(third) is False
    assert list(cancel_flag._unset) == [second, third]
    monkeypatch.setattr(cancel_flag, "REMEMBERED_SECONDS", -1.0)
    assert store.is_cancelled(third) is False
    assert asked[4:] == [f"{third}.cancelled"] * 2
    assert list(cancel_flag._unset) == [third]  # no more than two are remembered


# How chunks are stored


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


def test_a_chunk_takes_few_operations(url, spec, plan, monkeypatch):
    """One sync and one renaming per array; no folder is made, and nothing is half-written in its place."""
    calls: list[str] = []
    for name in ("fsync", "mkdir", "replace", "rename"):
        real = getattr(os, name)
        monkeypatch.setattr(
            os,
            name,
            lambda *given, _real=real, _name=name, **more: (calls.append(_name), _real(*given, **more))[1],
        )
    store.write_chunk(url, plan[0], record_of(spec, plan[0]))
    assert Counter(calls) == {"fsync": 7, "replace": 7}
    assert not list((Path(url) / ".partial").iterdir())


def test_the_names_of_chunks_are_synced_together(url, spec, plan, monkeypatch):
    store.write_chunk(url, plan[0], record_of(spec, plan[0]))
    synced: list[str] = []
    real = os.fsync

    def fsync(descriptor: int) -> None:
        synced.append(str(Path(f"/proc/self/fd/{descriptor}").readlink()))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    stored_layout = layout(spec, plan.chunk_shape)
    store.sync_folders(url, stored_layout)
    assert sorted(synced) == sorted(str(Path(url, array.name)) for array in stored_layout.arrays)
    store.sync_folders(f"{url}.removed", stored_layout)


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


def test_a_store_that_is_removed_meanwhile_is_not_made_again(url, spec, plan, monkeypatch):
    real = stored.write_keys

    def removed(*given: Any, **more: Any) -> None:
        shutil.rmtree(url)
        real(*given, **more)

    monkeypatch.setattr(zarr_store, "write_keys", removed)
    with pytest.raises(store.StoreMissing):
        store.write_chunk(url, plan[0], record_of(spec, plan[0]))
    assert not Path(url).exists()


def test_sizes_tell_of_missing_and_cut_chunks(url, spec, plan):
    cut_as = layout(spec, plan.chunk_shape)
    written = {chunk: store.write_chunk(url, chunk, record_of(spec, chunk)) for chunk in plan[:4]}
    stored_files(url, plan[1])[2].unlink()
    cut(stored_files(url, plan[2])[3], 5)
    sizes = store.stored_sizes(url, cut_as)
    assert sizes is not None
    found = {chunk.index: int(sizes[cut_as.coords(chunk.slices)]) for chunk in plan}
    expected = {chunk.index: size.bytes for chunk, size in written.items()}
    assert (found[0], found[3]) == (expected[0], expected[3])
    assert found[1] == -1
    assert 0 < found[2] < expected[2]
    assert all(found[chunk.index] == -1 for chunk in plan[4:])


def test_a_chunk_without_any_bytes_is_there(url, spec, plan):
    cut_as = layout(spec, plan.chunk_shape)
    size = store.write_chunk(url, plan[0], record_of(spec, plan[0])).bytes
    [file] = Path(url).glob("outcome/c.0.0.0.0")
    left = size - file.stat().st_size
    file.write_bytes(b"")
    sizes = store.stored_sizes(url, cut_as)
    assert sizes.shape == (2, 2, 2, 3)
    assert sizes[0, 0, 0, 0] == left
    assert sizes.sum() == left - (sizes.size - 1)


def test_a_long_listing_pauses_in_between(url, spec, plan, monkeypatch):
    for chunk in plan[:4]:
        store.write_chunk(url, chunk, record_of(spec, chunk))
    monkeypatch.setattr(stored, "_LISTED", 2)
    pauses = []
    cut_as = layout(spec, plan.chunk_shape)
    store.stored_sizes(url, cut_as, lambda: pauses.append(1))
    assert len(pauses) == 3 * len(cut_as.arrays)  # four chunks and zarr.json


def test_what_is_discarded_is_gone_and_outcomes_first(url, spec, plan, monkeypatch):
    for chunk in plan[:2]:
        store.write_chunk(url, chunk, record_of(spec, chunk))
    removed, real = [], stored.delete
    monkeypatch.setattr(stored, "delete", lambda url, key: (removed.append(key), real(url, key)))
    store.discard(url, layout(spec, plan.chunk_shape), plan[0])
    assert removed[0] == "outcome/c.0.0.0.0"
    assert stored_files(url, plan[0]) == []
    assert len(stored_files(url, plan[1])) == len(schema.RECORD) + 2


@pytest.fixture
def synced(monkeypatch) -> list[str]:
    """The files and folders that are synced."""
    paths: list[str] = []
    real = os.fsync

    def fsync(descriptor: int) -> None:
        paths.append(str(Path(f"/proc/self/fd/{descriptor}").readlink()))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    return paths


def test_a_store_is_on_the_disk_once_it_is_created(tmp_path, spec, plan, synced):
    url = tmp_path / "new.zarr"
    store.create(str(url), layout(spec, plan.chunk_shape))
    made = {str(path) for path in url.rglob("*") if path.name != ".partial"}
    assert made <= {str(url), str(tmp_path), *synced}
    assert {str(url), str(tmp_path)} <= set(synced)
    assert [path for path in synced if not path.startswith(str(tmp_path))] == []


def test_no_file_stays_open(url, spec, plan):
    store.write_chunk(url, plan[0], record_of(spec, plan[0]))
    stored.threads()  # its threads are there
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(5):
        store.write_chunk(url, plan[0], record_of(spec, plan[0]))
        store.sync_folders(url, layout(spec, plan.chunk_shape))
        stored.fsync_files(url, ["zarr.json"])
    assert len(list(Path("/proc/self/fd").iterdir())) < before + 20


def test_a_chunk_that_cannot_be_renamed_leaves_no_partial_file(url, spec, plan, monkeypatch):
    real, count = os.replace, count_from(0)

    def replace_(source: Any, target: Any, **more: Any) -> None:
        if next(count) == 2:
            raise OSError(5, "Input/output error")
        real(source, target, **more)

    monkeypatch.setattr(os, "replace", replace_)
    with pytest.raises(OSError, match="Input/output error"):
        store.write_chunk(url, plan[0], record_of(spec, plan[0]))
    assert not list((Path(url) / ".partial").iterdir())
    assert len(stored_files(url, plan[0])) == 2
    assert not store.read_chunk(url, plan[0], ["outcome"])["outcome"].any()


def test_a_listing_pauses_in_every_array_and_ends_where_a_pause_raises(url, spec, plan):
    cut_as = layout(spec, plan.chunk_shape)
    pauses = []
    store.stored_sizes(url, cut_as, lambda: pauses.append(1))
    assert len(pauses) == len(cut_as.arrays)

    def stop() -> None:
        raise InterruptedError

    with pytest.raises(InterruptedError):
        store.stored_sizes(url, cut_as, stop)


def test_nothing_that_is_stored_waits_behind_what_is_verified(url, spec, plan, monkeypatch):
    """The disk hangs for each of more chunks than are read at once."""
    cut_as, stuck = layout(spec, plan.chunk_shape), [plan[number] for number in range(12)]
    answers = threading.Event()
    monkeypatch.setattr(stored, "read_key", lambda *_: answers.wait(30) and None)
    verified: list[Chunk] = []
    verifying = threading.Thread(
        target=lambda: verified.extend(store.find_corrupt(url, cut_as, [(chunk, "") for chunk in stuck]))
    )
    verifying.start()
    try:
        with ThreadPoolExecutor() as writing:
            written = writing.submit(store.write_chunk, url, plan[12], record_of(spec, plan[12]))
            assert written.result(30).bytes > 0
            assert verifying.is_alive()
    finally:
        answers.set()
        verifying.join(30)
    assert verified == stuck


@pytest.fixture
def sharded(tmp_path, spec, monkeypatch) -> tuple[str, Plan]:
    """A store whose chunks are shards of 2 × 2 × 2 inner chunks at least."""
    monkeypatch.setattr(schema, "SHARD_BYTES", 2000)
    monkeypatch.setattr(schema, "INNER_BYTES", 2000)
    plan, url = make_plan(spec, chunk_shape=(2, 2, 8)), str(tmp_path / "sharded.zarr")
    store.create(url, layout(spec, plan.chunk_shape))
    for chunk in plan:
        store.write_chunk(url, chunk, record_of(spec, chunk))
    return url, plan


def test_shards_hold_the_same_values_in_as_many_files_as_chunks(sharded, spec):
    url, plan = sharded
    [codec] = json.loads((Path(url) / "flights" / "zarr.json").read_text())["codecs"]
    assert codec["name"] == "sharding_indexed"
    assert len(list(Path(url).glob("*/c.*"))) == 7 * len(plan)
    with xr.open_zarr(url, chunks=None) as dataset:
        for chunk in plan:
            for name, values in record_of(spec, chunk).items():
                np.testing.assert_array_equal(dataset[name].values[chunk.slices][0], values)
                np.testing.assert_array_equal(store.read_chunk(url, chunk, [name])[name], values)


def test_a_shard_at_the_end_of_the_grid_has_no_parts_beyond_it(sharded):
    url, plan = sharded
    (last,) = (chunk for chunk in plan if (*chunk.omega, *chunk.gamma, chunk.direction) == (2, 3, 8, 10, 1))
    lengths = [span.stop - span.start for span in last.slices]
    sharded_arrays = {name: form for name, form in zarr_store._forms(url).items() if form.sharded}
    assert "flights" in sharded_arrays
    for name, form in sharded_arrays.items():
        within = [*lengths, *form.chunks[len(lengths) :]]
        parts = math.prod(-(-n // size) for n, size in zip(within, form.inner, strict=True))
        content = (Path(url) / name / f"c.1.0.1.1{'.0' * (len(form.dims) - 4)}").read_bytes()
        offsets = np.frombuffer(content[-form.index_bytes : -4], "<u8")[::2]
        assert np.count_nonzero(offsets != 2**64 - 1) == parts < len(offsets), name


def test_any_part_of_a_shard_reads_as_zarr_reads_it(sharded):
    url, _ = sharded
    random = np.random.default_rng(1)
    with xr.open_zarr(url, chunks=None) as dataset:
        for _ in range(20):
            where = {"direction": int(random.integers(2)), "gamma": slice(*sorted(random.integers(0, 11, 2)))}
            where |= {"omega": int(random.integers(3)), "xi": slice(None, None, int(random.integers(1, 3)))}
            for name, values in store.read_slice(url, ["outcome", "flight_time", "flights"], **where).items():
                np.testing.assert_array_equal(values, dataset[name].isel(where).values)


def test_of_a_shard_only_the_parts_that_are_needed_are_read(sharded, monkeypatch):
    url, _ = sharded
    taken = []
    real = backend.read_parts
    monkeypatch.setattr(reader, "read_parts", lambda *given: taken.append(real(*given)) or taken[-1])
    store.read_slice(url, ["flight_time"], direction=0, xi=0, omega=0, gamma=0)
    whole = (Path(url) / "flight_time" / "c.0.0.0.0.0").stat().st_size
    assert 0 < sum(len(part) for parts in taken for part in parts or []) < whole / 2


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
