"""Same specification, same bytes: for any chunks and any executor, and after crashes."""

from concurrent.futures import wait
from pathlib import Path

import pytest
import xarray as xr
from stores import files

from worker import store
from worker.executors.base import Executor
from worker.executors.inline import Inline
from worker.study import Plan
from worker.sweep import SweepSpec
from worker.sweep.plan import make_plan
from worker.sweep.schema import layout
from worker.sweep.task import run_chunk

SWEEPS = {
    "from rest": {},
    "soft": {"model": {"kind": "soft", "penetration": 1e-2}, "gamma": [0.5, 1.5, 2.3], "xi": 0.26},
    "ramp both": {"protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"}},
    "ramp down": {"protocol": {"kind": "ramp", "axis": "omega", "direction": "down"}},
    "settling": {"omega": [0.808, 1.167, 1.288], "xi": [0.043, 0.352], "settle": "auto"},
}


@pytest.fixture(params=SWEEPS)
def spec(request, small_spec) -> SweepSpec:
    return small_spec(**SWEEPS[request.param])


@pytest.fixture
def expected(spec, tmp_path) -> dict[str, bytes]:
    """The values of a sweep computed as a single chunk."""
    return values(compute(spec, tmp_path / "expected.zarr", shape=spec.shape[1:]))


def make(spec: SweepSpec, url: Path, shape=None) -> Plan:
    plan = make_plan(spec, chunk_shape=shape)
    store.create(str(url), layout(spec, plan.chunk_shape))
    return plan


def compute(spec: SweepSpec, url: Path, shape=None) -> Path:
    for chunk in make(spec, url, shape):
        run_chunk(spec, chunk, str(url))
    return url


def compute_with(executor: Executor, spec: SweepSpec, url: Path, shape=None) -> Path:
    """Submit all chunks, line by line of the ramp: a chunk waits for its predecessor."""
    plan = make(spec, url, shape)
    for wave in range(0, len(plan), plan.lines):
        futures = [executor.submit(spec, chunk, str(url)) for chunk in plan[wave : wave + plan.lines]]
        wait(futures)
        assert all(future.result().cells for future in futures)
    return url


def values(url: Path) -> dict[str, bytes]:
    """The bytes of every stored array."""
    with xr.open_zarr(url) as dataset:
        return {name: dataset[name].values.tobytes() for name in dataset.data_vars}


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 2, 3)])
def test_chunk_shapes_change_no_number(spec, expected, tmp_path, shape):
    assert values(compute(spec, tmp_path / "cut.zarr", shape)) == expected


def test_inline_and_two_workers_write_the_same_files(spec, expected, tmp_path, cluster):
    inline = Inline()
    by_inline = compute_with(inline, spec, tmp_path / "inline.zarr", (1, 1, 7))
    inline.close()
    by_cluster = compute_with(cluster, spec, tmp_path / "cluster.zarr", (1, 1, 7))
    assert files(by_inline) == files(by_cluster)
    assert values(by_cluster) == expected
