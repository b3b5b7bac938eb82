"""Bundles on a cluster."""

import asyncio
import pickle
import subprocess
import sys
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from scripted import sweep

from worker import store
from worker.executors.bundles import Bundles, Call
from worker.executors.dask import Dask
from worker.plan import make_plan
from worker.schema import layout
from worker.tasks import run_chunk


class Sending:
    """A client that pickles what is submitted."""

    def map(self, function: Any, calls: Any, **_: Any) -> list[bytes]:
        return [pickle.dumps((function, call)) for call in calls]


def test_scheduler_and_worker_need_nothing_of_this_project_until_a_task_runs():
    sent = asyncio.run(Bundles().add(Sending(), Call((run_chunk, 3), 0.0)))
    code = (
        "import pickle, sys; function, call = pickle.loads(sys.stdin.buffer.read()); "
        "print('worker' in sys.modules); sys.modules['worker'] = None; function(call)"
    )
    done = subprocess.run([sys.executable, "-c", code], input=sent, capture_output=True, check=False)
    assert done.stdout == b"False\n"
    assert b"ModuleNotFoundError" in done.stderr


def test_a_cluster_computes_what_was_sent_once(cluster: Dask, tmp_path: Path):
    gamma = [round(1.0 + i / 1000, 6) for i in range(1000)]
    spec, url = sweep(gamma=gamma, model={"kind": "rigid"}, settle=10), str(tmp_path / "sweep.zarr")
    plan = make_plan(spec)
    store.create(url, layout(spec, plan.chunk_shape))
    flying: list[Future[Any]] = [cluster.submit(spec, chunk, url, seconds=60.0) for chunk in plan]
    assert {future.result(60).index for future in flying} == set(range(len(plan)))
    assert store.read_slice(url, ["outcome"])["outcome"].all()
    assert len(list(Path(url).glob(".spec-*"))) == 1
