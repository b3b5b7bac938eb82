"""Clusters that grow and shrink, and clusters that vanish: real ones of this machine."""

import asyncio
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import dask
import pytest
from distributed import LocalCluster
from scripted import costing, wait_for
from served import running

from service.ledger.model import JobState
from worker.executors import clusters
from worker.executors.base import ClusterLost
from worker.executors.clusters import SCHEDULER_SETTINGS, CreatedCluster
from worker.executors.dask import Dask
from worker.kernel_cache import use_cache

PATIENCE = 180.0


def local_cluster(workers: int) -> LocalCluster:
    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        memory_limit=None,
    )


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[LocalCluster]]:
    """Clusters that a test makes; closed at its end. New ones and new workers are asked for sooner."""
    use_cache()
    monkeypatch.setattr(clusters, "MAKE_SECONDS", 1.0)
    monkeypatch.setattr(clusters, "REFILL_SECONDS", 1.0)
    made: list[LocalCluster] = []
    with dask.config.set(SCHEDULER_SETTINGS):
        yield made
    for cluster in made:
        cluster.close()


def test_an_adaptive_cluster_starts_without_workers_grows_and_shrinks(
    tmp_path: Path, made: list[LocalCluster]
):
    made.append(local_cluster(0))
    made[0].adapt(minimum=0, maximum=3, interval="200 ms", target_duration="1 s")
    with closing(Dask(made[0])) as executor:
        wait_for(lambda: executor.state().connected)
        assert executor.state().workers == 0
        with running(tmp_path, executor) as service:
            assert service.manager.fault() is None  # there is nothing to compute
            long = service.submit(costing(chunks=10_000, seconds=0.1))
            wait_for(lambda: executor.state().workers == 3, seconds=PATIENCE)
            service.manager.cancel(long.id)
            job = service.submit(costing(omega=0.6))
            ended = service.until(job, JobState.DONE, seconds=PATIENCE)
            assert ended.chunks_done == ended.chunks_total
            supervisor = service.manager.supervisor
            wait_for(lambda: supervisor.cluster.workers == 0, seconds=PATIENCE)
            assert service.manager.fault() is None
        client = executor._connection.client
    assert (client.status, made[0].status.name) == ("closed", "running")


def test_a_cluster_that_vanishes_is_made_again(tmp_path: Path, made: list[LocalCluster]):
    def make() -> LocalCluster:
        made.append(local_cluster(1))
        return made[-1]

    faults = set()
    with (
        closing(Dask(CreatedCluster(make, "mine:cluster"))) as executor,
        running(tmp_path, executor) as service,
    ):

        def again() -> bool:
            faults.add(executor.state().fault)
            return len(made) == 2 and executor.state().workers == 1

        job = service.submit(costing(chunks=30, seconds=0.1))
        wait_for(lambda: service.job(job).chunks_done >= 2, seconds=PATIENCE)
        vanishing = threading.Thread(target=made[0].close)  # another may be there before it ends
        vanishing.start()
        wait_for(again, lambda: f"{faults}", PATIENCE)
        vanishing.join()
        service.until(job, JobState.DONE, seconds=PATIENCE)
    assert made[1].status.name == "closed"
    assert any("the Dask scheduler does not answer" in fault for fault in faults if fault)


def test_what_the_connection_swallows_is_lost_with_it(
    made: list[LocalCluster], monkeypatch: pytest.MonkeyPatch
):
    """What a client sends while its connection is being lost disappears without an error."""

    def make() -> LocalCluster:
        made.append(local_cluster(1))
        return made[-1]

    sent = threading.Event()

    async def swallowed(*_: object) -> None:
        sent.set()
        await asyncio.Event().wait()

    with closing(Dask(CreatedCluster(make, "mine:cluster"))) as executor:
        with monkeypatch.context() as patched:
            patched.setattr(executor, "_run", swallowed)
            call = executor.call(len, "abc")
            assert sent.wait(PATIENCE)
        made[0].close()
        with pytest.raises(ClusterLost):
            call.result(PATIENCE)
        wait_for(lambda: executor.state().workers == 1, seconds=PATIENCE)
        assert executor.call(len, "abcd").result(PATIENCE) == 4


def test_lost_workers_of_a_users_cluster_are_replaced(made: list[LocalCluster]):
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "100 ms"}):
        made.append(local_cluster(2))
        with closing(Dask(CreatedCluster(lambda: made[0], "mine:cluster"))) as executor:
            lost = next(iter(made[0].workers.values()))
            address = lost.worker_address
            made[0].sync(lost.close)

            def replaced() -> bool:
                workers = executor._connection.worker_threads() or {}
                return len(workers) == 2 and address not in workers

            wait_for(replaced, seconds=PATIENCE)
            wait_for(lambda: executor.state().workers == 2, seconds=PATIENCE)
