"""Executors: one interface for this process and for a cluster, and errors that name the cause."""

import os
import re
import signal
import threading
import time

import dask
import psutil
import pytest
from distributed import LocalCluster
from harm import Stuck
from paths import CACHE
from scripted import DEADLINE, wait_for
from stores import is_sound

from worker import store
from worker.executors.base import ClusterLost, Executor
from worker.executors.dask import Dask
from worker.study import ChunkCancelled, ChunkReport, Plan
from worker.sweep import SweepSpec
from worker.sweep.plan import make_plan
from worker.sweep.schema import layout

#: The longest wait for a result (s): the machine may be compiling kernels at the same time.
PATIENCE = 180


@pytest.fixture(params=["inline", "cluster"])
def executor(request) -> Executor:
    return request.getfixturevalue(request.param)


@pytest.fixture
def planned(small_spec, tmp_path) -> tuple[SweepSpec, Plan, str]:
    spec = small_spec()
    plan, url = make_plan(spec, chunk_shape=(1, 3, 5)), str(tmp_path / "sweep.zarr")
    store.create(url, layout(spec, plan.chunk_shape))
    return spec, plan, url


def test_every_chunk_comes_back_with_a_report(executor, planned):
    spec, plan, url = planned
    futures = [executor.submit(spec, chunk, url) for chunk in plan]
    reports = [future.result(PATIENCE) for future in futures]
    assert [report.index for report in reports] == [0, 1, 2, 3]
    assert all(isinstance(report, ChunkReport) and report.cells == 15 for report in reports)
    assert all(is_sound(url, layout(spec, plan.chunk_shape), chunk) for chunk in plan)


def test_a_task_that_fails_says_why(executor, planned, tmp_path):
    spec, plan, _ = planned
    nowhere = str(tmp_path / "nowhere.zarr")
    with pytest.raises(store.StoreMissing, match="no store here"):
        executor.submit(spec, plan[0], nowhere).result(PATIENCE)


def test_a_cancelled_store_stops_its_tasks(executor, planned):
    spec, plan, url = planned
    store.set_cancelled(url)
    with pytest.raises(ChunkCancelled):
        executor.submit(spec, plan[0], url).result(PATIENCE)
    store.clear_cancelled(url)
    executor.submit(spec, plan[0], url).result(PATIENCE)


def test_the_cluster_listens_on_loopback_only(cluster):
    here = psutil.Process()
    listening = [
        connection.laddr.ip
        for process in (here, *here.children(recursive=True))
        for connection in process.net_connections("inet")
        if connection.status == psutil.CONN_LISTEN
    ]
    assert set(listening) == {"127.0.0.1"}


def test_an_address_without_a_scheduler_is_an_error_and_leaves_no_thread():
    with pytest.raises(ClusterLost, match=re.escape("no scheduler answers at tcp://127.0.0.1:9")):
        Dask("tcp://127.0.0.1:9", timeout=0.5)
    before = set(threading.enumerate())
    with pytest.raises(ClusterLost, match="no scheduler answers at nonsense"):
        Dask("nonsense")
    wait_for(lambda: set(threading.enumerate()) <= before)


@pytest.mark.parametrize("dropped", [False, True])
def test_closing_does_not_wait_for_a_worker_that_is_starting(tmp_path, dropped):
    """On a busy machine Dask has dropped it by then, after 15 s."""
    executor = Dask(workers=1)
    try:
        executor._connection.client.register_plugin(Stuck(tmp_path / "stuck"))
        (tmp_path / "stuck").touch()
        [pid] = executor._connection.client.run(os.getpid).values()
        [nanny] = executor._target.cluster.workers.values()
        with dask.config.set({"distributed.deploy.lost-worker-timeout": "100 ms" if dropped else "1 h"}):
            os.kill(pid, signal.SIGKILL)
            wait_for((tmp_path / "starting").exists, seconds=PATIENCE)
            wait_for(lambda: (nanny in executor._target.cluster.workers.values()) != dropped)
    finally:
        began = time.monotonic()
        executor.close()
    assert time.monotonic() - began < DEADLINE  # and not an hour


def test_workers_that_dask_has_dropped_are_replaced():
    """It drops one that is not back 15 s after it died: here 100 ms."""
    executor = Dask(workers=2, kernel_cache=CACHE)
    client, nannies = executor._connection.client, executor._target.cluster.workers
    try:
        before = set(nannies.values())
        with dask.config.set({"distributed.deploy.lost-worker-timeout": "100 ms"}):
            [pid, _] = client.run(os.getpid).values()
            os.kill(pid, signal.SIGKILL)
            wait_for(lambda: len(before & set(nannies.values())) == 1, seconds=PATIENCE)
        wait_for(lambda: executor.workers() == 2, seconds=PATIENCE)
    finally:
        executor.close()


def test_a_scheduler_that_would_judge_deaths_itself_is_told_how_to_start(caplog):
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 3}),
        LocalCluster(n_workers=0, processes=False, protocol="tcp", dashboard_address="127.0.0.1:0") as plain,
    ):
        Dask(plain.scheduler_address).close()
    [message] = [message for message in caplog.messages if "allowed-failures" in message]
    assert message.endswith("start it with DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES=0")
