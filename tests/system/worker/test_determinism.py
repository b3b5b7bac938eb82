"""Same specification, same bytes: for any chunks and any executor, and after crashes."""

from pathlib import Path

import pytest
import xarray as xr
from chunks import computed, planned
from scripted import small
from stores import files

from worker.executors.base import Executor
from worker.sweep import SweepSpec

SWEEPS = {
    "from rest": {},
    "soft": {"model": {"kind": "soft", "penetration": 1e-2}, "gamma": [0.5, 1.5, 2.3], "xi": 0.26},
    "ramp both": {"protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"}},
    "ramp down": {"protocol": {"kind": "ramp", "axis": "omega", "direction": "down"}},
    "settling": {"omega": [0.808, 1.167, 1.288], "xi": [0.043, 0.352], "settle": "auto"},
}


@pytest.fixture(params=SWEEPS)
def spec(request) -> SweepSpec:
    return small(**SWEEPS[request.param])


@pytest.fixture
def expected(spec, tmp_path) -> dict[str, bytes]:
    """The values of a sweep computed as a single chunk."""
    return values(computed(tmp_path / "expected.zarr", spec, spec.shape[1:]))


def compute_with(executor: Executor, spec: SweepSpec, url: Path) -> Path:
    """Submit all chunks, line by line of the ramp: a chunk waits for its predecessor."""
    plan = planned(url, spec, (1, 1, 7))
    for wave in range(0, len(plan), plan.lines):
        futures = [executor.submit(spec, chunk, str(url)) for chunk in plan[wave : wave + plan.lines]]
        assert all(future.result(timeout=300).cells for future in futures)
    return url


def values(dataset: xr.Dataset) -> dict[str, bytes]:
    """The bytes of every stored array."""
    return {name: dataset[name].values.tobytes() for name in dataset.data_vars}


def test_inline_and_two_workers_write_the_same_files(spec, expected, tmp_path, inline, cluster):
    by_inline = compute_with(inline, spec, tmp_path / "inline.zarr")
    by_cluster = compute_with(cluster, spec, tmp_path / "cluster.zarr")
    assert files(by_inline) == files(by_cluster)
    assert values(xr.open_zarr(by_cluster)) == expected
