"""Adaptive maps on two workers."""

from concurrent.futures import wait
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from worker import schema, store
from worker.executors.base import Executor
from worker.plan import make_plan
from worker.schema import layout
from worker.spec import SweepSpec
from worker.tasks import run_chunk

#: A plane with the threshold, modes, chaos and tongues; rows and columns that no number of blocks fits.
SPACE: dict[str, Any] = {
    "omega": {"start": 0.35, "stop": 1.0, "num": 45},
    "gamma": {"start": 0.4, "stop": 3.4, "num": 52},
    "xi": 0.05,
    "model": {"kind": "rigid"},
    "settle": 60,
    "observe": 40,
    "keep": 8,
}

#: Tiles of it, in place of the default ones, which are larger than the plane.
TILE = (1, 17, 17)


def sweep(**changes: Any) -> SweepSpec:
    return SweepSpec(**SPACE | changes)


def adaptive(**refine: Any) -> SweepSpec:
    return sweep(refine={"by": "mode", "coarsest": 8} | refine)


def compute(spec: SweepSpec, url: Path, shape: tuple[int, ...] | None = TILE) -> dict[str, np.ndarray]:
    """The plane of a map, computed chunk by chunk in this process."""
    plan = make_plan(spec, chunk_shape=shape)
    store.create(str(url), layout(spec, plan.chunk_shape))
    for chunk in plan:
        run_chunk(spec, chunk, str(url))
    return plane(spec, url)


def plane(spec: SweepSpec, url: Path) -> dict[str, np.ndarray]:
    stored = store.read_slice(str(url), [array.name for array in schema.arrays(spec)], complete=True)
    return {name: array[0, 0] for name, array in stored.items()}


def files(url: Path) -> dict[str, bytes]:
    return {str(path.relative_to(url)): path.read_bytes() for path in url.rglob("*") if path.is_file()}


@pytest.mark.parametrize("margin", [False, True])
def test_same_bytes_with_two_worker_processes(cluster: Executor, tmp_path, margin):
    spec, url = adaptive(margin=margin), tmp_path / "executed.zarr"
    compute(spec, tmp_path / "here.zarr")
    plan = make_plan(spec, chunk_shape=TILE)
    store.create(str(url), layout(spec, plan.chunk_shape))
    futures = [cluster.submit(spec, chunk, str(url)) for chunk in reversed(plan)]
    wait(futures)
    assert all(future.result().cells for future in futures)
    assert files(url) == files(tmp_path / "here.zarr")
