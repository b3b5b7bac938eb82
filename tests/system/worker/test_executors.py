"""The executor on a cluster: who listens, who is replaced, and errors that name the cause."""

import asyncio
import os
import pickle
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import closing
from datetime import datetime, timedelta, timezone
from types import SimpleNamespace

import dask
import psutil
import pytest
from dask_processes import listening
from distributed import LocalCluster, Security
from harm import Stuck
from scripted import DEADLINE, wait_for

from worker.executors.base import ClusterLost
from worker.executors.dask import Dask, _Call
from worker.sweep.task import run_chunk

#: The longest wait for a result (s): the machine may be compiling kernels at the same time.
PATIENCE = 180


def test_the_cluster_listens_on_loopback_only(cluster):
    assert {address.ip for address in listening(psutil.Process())} == {"127.0.0.1"}


def test_scheduler_and_worker_need_nothing_of_this_project_until_a_task_runs():
    sent = pickle.dumps((pickle.loads, pickle.dumps(_Call(run_chunk, 3))))
    code = (
        "import pickle, sys; function, call = pickle.loads(sys.stdin.buffer.read()); "
        "print('worker' in sys.modules); sys.modules['worker'] = None; function(call)"
    )
    done = subprocess.run([sys.executable, "-c", code], input=sent, capture_output=True, check=False)
    assert done.stdout == b"False\n"
    assert b"ModuleNotFoundError" in done.stderr


def test_an_address_without_a_scheduler_is_an_error_and_leaves_no_thread_and_no_file():
    def fails(address, security=None):
        with pytest.raises(ClusterLost, match=re.escape(f"no scheduler answers at {address}: ")):
            Dask(address, security=security, timeout=0.5)

    fails("tcp://127.0.0.1:9")
    threads, files = set(threading.enumerate()), psutil.Process().num_fds()
    fails("tcp://127.0.0.1:9")
    fails("nonsense")
    with socket.create_server(("127.0.0.1", 0)) as frozen:  # it takes connections and answers nothing
        address = f"tcp://127.0.0.1:{frozen.getsockname()[1]}"
        fails(address)
        fails(address, Security.temporary())
    wait_for(lambda: set(threading.enumerate()) <= threads and psutil.Process().num_fds() <= files)


def test_demands_on_a_frozen_scheduler_hold_no_connections():
    async def freeze(**_):
        await asyncio.Event().wait()

    with LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0") as cluster:
        cluster.scheduler.handlers["set_metadata"] = freeze
        with closing(Dask(cluster.scheduler_address)) as executor:
            connections = executor._connection.client.rpc
            for tasks in range(3):
                executor.ask_for(1.0, tasks)
            wait_for(lambda: connections.active == 3)
            wait_for(lambda: connections.active == 0)


def test_a_cancelled_task_takes_no_other_with_it(cluster):
    """Whatever it waits for: Dask fetches the results of several tasks at once."""
    for milliseconds in range(100):
        tasks = [cluster.call(int) for _ in range(8)]
        time.sleep(1e-3 * (milliseconds % 20))
        for task in tasks[::2]:
            task.cancel()
        assert [task.result(timeout=PATIENCE) for task in tasks[1::2]] == [0] * 4


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


def test_a_worker_computes_on_when_its_kernels_take_most_of_its_memory():
    def fill(dask_worker):
        used = dask_worker.monitor.get_process_memory()
        dask_worker.memory_manager.memory_limit = int(used / 0.85)

    with closing(Dask(workers=1)) as executor:
        executor._connection.client.run(fill)
        time.sleep(1.0)  # a worker looks at its memory ten times a second
        assert executor.call(len, "abc").result(PATIENCE) == 3


def test_workers_join_after_the_clock_was_set_back(monkeypatch):
    """The certificate that they show is of tomorrow."""

    class Tomorrow(datetime):
        @classmethod
        def now(cls, tz=None):
            return datetime.now(tz) + timedelta(days=1)

    clock = SimpleNamespace(datetime=Tomorrow, timedelta=timedelta, timezone=timezone)
    monkeypatch.setattr("distributed.security.datetime", clock)
    with closing(Dask(workers=1)) as executor:
        assert executor.state().workers == 1


def test_a_scheduler_that_would_judge_deaths_itself_is_told_how_to_start(caplog):
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 3}),
        LocalCluster(n_workers=0, processes=False, protocol="tcp", dashboard_address="127.0.0.1:0") as plain,
    ):
        Dask(plain.scheduler_address).close()
    [message] = [message for message in caplog.messages if "allowed-failures" in message]
    assert message.endswith("start it with DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES=0")
