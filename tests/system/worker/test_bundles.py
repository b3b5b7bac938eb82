"""Bundles on a cluster."""

import asyncio
import pickle
import subprocess
import sys
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from worker import store
from worker.executors.bundles import Bundles, Call
from worker.executors.dask import Dask
from worker.plan import make_plan
from worker.spec import SweepSpec
from worker.studies import study_of
from worker.tasks import run_chunk


def small_spec(**more: Any) -> SweepSpec:
    fields = {"gamma": [1.2, 2.5, 3.1], "omega": 0.5, "xi": [0.05, 0.26], "model": {"kind": "rigid"}}
    return SweepSpec(**(fields | {"settle": 10, "observe": 5, "keep": 4} | more))


class Recording:
    """A client that notes what is submitted, one entry for each message."""

    def __init__(self) -> None:
        self.messages: list[tuple[list[Any], dict[str, Any]]] = []  # what its tasks return, and options

    def map(self, function: Any, calls: Any, **options: Any) -> list[str]:
        results = [function(call) for call in calls]
        if "bad" in results:
            raise ValueError("not this one")
        self.messages.append((results, options))
        return [f"future of {result}" for result in results]


def submit(calls: list[Call], client: Recording | None = None) -> tuple[Recording, list[Any]]:
    client, bundles = client or Recording(), Bundles()

    async def run() -> tuple[Recording, list[Any]]:
        adding = [bundles.add(client, call) for call in calls]
        return client, await asyncio.gather(*adding, return_exceptions=True)

    return asyncio.run(run())


def test_scheduler_and_worker_need_nothing_of_this_project_until_a_task_runs():
    class Sending(Recording):
        def map(self, function: Any, calls: Any, **_: Any) -> list[bytes]:
            return [pickle.dumps((function, call)) for call in calls]

    _, [sent] = submit([Call((run_chunk, 3), 0.0)], Sending())
    code = (
        "import pickle, sys; function, call = pickle.loads(sys.stdin.buffer.read()); "
        "print('worker' in sys.modules); sys.modules['worker'] = None; function(call)"
    )
    done = subprocess.run([sys.executable, "-c", code], input=sent, capture_output=True, check=False)
    assert done.stdout == b"False\n"
    assert b"ModuleNotFoundError" in done.stderr


@pytest.fixture
def long_spec() -> SweepSpec:
    return small_spec(gamma=[round(1.0 + i / 1000, 6) for i in range(1000)])


def stored(spec: Any, folder: Path) -> str:
    url = str(folder / "sweep.zarr")
    store.create(url, study_of(spec).variables(spec, study_of(spec).plan(spec).chunk_shape))
    return url


def test_a_cluster_computes_what_was_sent_once(cluster: Dask, long_spec: SweepSpec, tmp_path: Path):
    url, plan = stored(long_spec, tmp_path), make_plan(long_spec)
    flying: list[Future[Any]] = [cluster.submit(long_spec, chunk, url, seconds=60.0) for chunk in plan]
    assert {future.result(60).index for future in flying} == set(range(len(plan)))
    assert store.read_slice(url, ["outcome"])["outcome"].all()
    assert len(list(Path(url).glob(".spec-*"))) == 1
