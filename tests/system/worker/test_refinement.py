"""Adaptive maps on two workers."""

from concurrent.futures import wait
from pathlib import Path
from typing import Any

import pytest
from stores import files

from worker import store
from worker.executors.base import Executor
from worker.plan import Plan, make_plan
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


def make(spec: SweepSpec, url: Path) -> Plan:
    plan = make_plan(spec, chunk_shape=TILE)
    store.create(str(url), layout(spec, plan.chunk_shape))
    return plan


@pytest.mark.parametrize("margin", [False, True])
def test_same_bytes_with_two_worker_processes(cluster: Executor, tmp_path, margin):
    spec = SweepSpec(**SPACE, refine={"by": "mode", "coarsest": 8, "margin": margin})
    here, url = tmp_path / "here.zarr", tmp_path / "executed.zarr"
    for chunk in make(spec, here):
        run_chunk(spec, chunk, str(here))
    futures = [cluster.submit(spec, chunk, str(url)) for chunk in reversed(make(spec, url))]
    wait(futures)
    assert all(future.result().cells for future in futures)
    assert files(url) == files(here)
