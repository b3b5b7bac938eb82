"""dask-jobqueue on a real Slurm of this machine, over TLS, as in docs/deployment.md.

    apt-get install slurm-wlm munge && pip install dask-jobqueue
    pytest -n 0 -s tests/nightly/cluster/test_slurm.py

`-s` shows allocations, workers and chunks over time.
"""

import gc
import logging
import os
import socket
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import dask
import pytest
from blame import blamed, noting_errors
from dask_processes import with_another_kernel
from paths import CACHE, ROOT
from scripted import costing, wait_for
from served import Running, running
from slurm import Slurm, missing, slurm_running
from stores import marked

from service.ledger.model import JobRecord, JobState
from worker.executors.clusters import SCHEDULER_SETTINGS, CreatedCluster
from worker.executors.dask import Dask
from worker.executors.inline import Inline
from worker.kernel_cache import use_cache
from worker.sweep import SweepSpec

jobqueue = pytest.importorskip("dask_jobqueue", reason="needs dask-jobqueue: pip install dask-jobqueue")
pytestmark = [
    pytest.mark.timeout(2400),
    pytest.mark.skipif(bool(missing()), reason=missing()),
    # Of dask-jobqueue, which waits for no answer of scancel.
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]

#: Seconds after which every allocation is cancelled.
CANCELLED_AFTER = 25

#: Of the batch script of every allocation. The first gets another kernel. The second gets a mount namespace
#: of its own, in which the stores are spoilt as soon as the file `spoil` exists.
BAD_NODES = """
if mkdir {folder}/first 2>/dev/null; then
    export PYTHONPATH={copy}
    cd {folder}  # Python looks there first
elif [ -n "$SPOILT" ]; then
    (until [ -e {folder}/spoil ]; do sleep 0.1; done; {spoil} && touch {folder}/spoilt) &
elif mkdir {folder}/second 2>/dev/null; then
    SPOILT=1 exec unshare --mount bash "$0"
fi
"""
SPOILT = {
    "hidden": "mount -t tmpfs none {stores}",
    "read-only": "mount --bind {stores} {stores} && mount -o remount,bind,ro {stores}",
}


@pytest.fixture(scope="module")
def slurm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Slurm]:
    use_cache(CACHE)
    folder = tmp_path_factory.mktemp("slurm") / "files"
    with slurm_running(folder) as queue, pytest.MonkeyPatch.context() as patch:
        for name, value in queue.variables.items():
            patch.setenv(name, value)
        with dask.config.set(SCHEDULER_SETTINGS):
            yield queue


@pytest.fixture(autouse=True)
def collected() -> Iterator[None]:
    """A test's cluster goes with the test: it leaves files open, whose warnings are ignored."""
    yield
    gc.collect()


def make(folder: Path, walltime: str = "00:10:00", prologue: Sequence[str] = ()) -> Any:
    """A cluster whose scheduler and workers speak TLS, with certificates that dask-jobqueue makes."""
    folder.mkdir(exist_ok=True)
    return jobqueue.SLURMCluster(
        queue="all",
        cores=1,
        processes=1,
        memory="2GB",
        walltime=walltime,
        python=sys.executable,
        security=True,
        shared_temp_directory=str(folder),
        local_directory=str(folder),
        log_directory=str(folder),
        scheduler_options={"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"},
        worker_extra_args=["--host", "127.0.0.1", "--no-dashboard", "--dashboard-address", "127.0.0.1:0"],
        job_script_prologue=[f"export PYTHONPATH={ROOT}", f"export NUMBA_CACHE_DIR={CACHE}", *prologue],
    )


@contextmanager
def computing(cluster: Callable[[], Any], stores: Path | None = None) -> Iterator[Dask]:
    executor = Dask(
        CreatedCluster(cluster, "slurm:cluster"), timeout=60, stores=marked(stores.parent) if stores else None
    )
    try:
        yield executor
    finally:
        executor.close()


@dataclass
class Seen:
    """The allocations that a job had until it was done."""

    allocations: set[str] = field(default_factory=set)
    cancelled: set[str] = field(default_factory=set)
    timed_out: set[str] = field(default_factory=set)
    most: int = 0  # at a time
    most_workers: int = 0

    def __str__(self) -> str:
        return (
            f"{len(self.allocations)} allocations, {len(self.cancelled)} cancelled, "
            f"{len(self.timed_out)} timed out"
        )

    def look(self, slurm: Slurm, cancel_after: float) -> None:
        running = slurm.jobs()
        old = {name for name, ran in running.items() if ran >= cancel_after} - self.cancelled
        for name in old:
            slurm.ask("scancel", name)
        self.cancelled |= old
        self.allocations |= running.keys()
        self.timed_out = self.allocations & slurm.timed_out()
        self.most = max(self.most, len(running))


def watch(
    slurm: Slurm,
    executor: Dask,
    service: Running,
    job: JobRecord,
    cancel_after: float = 1e9,
    more: Callable[[Seen, int], SweepSpec | None] = lambda seen, number: None,
) -> Seen:
    """Follow a job until it is done, cancelling allocations that are so many seconds old.

    `more`: the sweep that is computed next, by what was seen and how many were computed; None ends it. So
    there is work until what a test waits for has come, however fast the machine is.
    """
    began, seen, number = time.monotonic(), Seen(), 1

    def say(what: str) -> None:
        sys.stdout.write(f"{time.monotonic() - began:6.1f} s  {what}\n")

    def done() -> bool:
        nonlocal job, number
        seen.look(slurm, cancel_after)
        cluster, now = executor.state(), service.job(job)
        seen.most_workers = max(seen.most_workers, cluster.workers)
        say(
            f"{seen}  workers {cluster.workers}, {len(cluster.refused)} refused  "
            f"chunks {now.chunks_done}/{now.chunks_total}  {now.state}"
        )
        time.sleep(1.0)
        if now.state is JobState.DONE and (sweep := more(seen, number)):
            job, number = service.submit(sweep), number + 1
            return False
        return now.state in (JobState.DONE, JobState.FAILED)

    wait_for(done, slurm.log, seconds=1500)
    ended = service.job(job)
    returned = service.manager.supervisor.tally.returned
    say(f"at most {seen.most} allocations, {seen.most_workers} workers at a time; returned: {returned}")
    assert ended.state is JobState.DONE, ended
    assert ended.chunks_done == ended.chunks_total
    return seen


def test_a_job_whose_every_allocation_is_cancelled_finishes_and_no_chunk_is_blamed(
    slurm: Slurm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    errors = noting_errors(monkeypatch)

    def cluster() -> Any:
        made = make(tmp_path / "cluster")
        made.scale(jobs=2)
        return made

    with computing(cluster) as executor, running(tmp_path / "data", executor, chunk_tries=1) as service:

        def more(seen: Seen, number: int) -> SweepSpec | None:
            """Until two were cancelled and another has computed since."""
            enough = len(seen.cancelled) >= 2 and seen.allocations > seen.cancelled
            return None if enough else costing(str(number), chunks=120, seconds=0.5)

        job = service.submit(costing(chunks=120, seconds=0.5))
        seen = watch(slurm, executor, service, job, CANCELLED_AFTER, more)
    assert len(seen.cancelled) >= 2
    assert blamed(errors) == []


def test_a_job_whose_allocations_end_by_their_walltime_finishes_and_no_chunk_is_blamed(
    slurm: Slurm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Slurm looks at time limits twice a minute: until then there are jobs."""
    errors = noting_errors(monkeypatch)

    def cluster() -> Any:
        made = make(tmp_path / "cluster", walltime="00:01:00")
        made.scale(jobs=2)
        return made

    with computing(cluster) as executor, running(tmp_path / "data", executor, chunk_tries=1) as service:

        def more(seen: Seen, number: int) -> SweepSpec | None:
            """Until two have timed out and another has computed since."""
            enough = len(seen.timed_out) >= 2 and seen.allocations > seen.timed_out
            return None if enough else costing(str(number), chunks=400, seconds=0.5)

        job = service.submit(costing(chunks=400, seconds=0.5))
        seen = watch(slurm, executor, service, job, more=more)
    assert len(seen.timed_out) >= 2
    assert seen.allocations > seen.timed_out
    assert blamed(errors) == []


def test_an_adaptive_batch_queue_grows_from_nothing_and_shrinks(slurm: Slurm, tmp_path: Path):
    def cluster() -> Any:
        made = make(tmp_path / "cluster")
        made.adapt(minimum=0, maximum=3, interval="1 s", target_duration="10 s")
        return made

    with computing(cluster) as executor, running(tmp_path / "data", executor) as service:

        def more(seen: Seen, number: int) -> SweepSpec | None:
            return None if seen.most >= 2 else costing(str(number), chunks=400, seconds=0.5)

        job = service.submit(costing(chunks=400, seconds=0.5))
        watch(slurm, executor, service, job, more=more)
        wait_for(lambda: executor.workers() == 0 and not slurm.jobs(), slurm.log, 180)


@pytest.mark.parametrize("spoilt", SPOILT)
def test_a_node_with_another_kernel_and_one_that_fails_every_chunk_beside_a_good_one(
    slurm: Slurm,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    spoilt: str,
):
    sweep = costing(chunks=24, seconds=1.0)
    inline = Inline()
    with running(tmp_path / "calm", inline) as service:
        expected = service.stored(service.until(service.submit(sweep), JobState.DONE))
    inline.close()

    stores, nodes = tmp_path / "data" / "stores", tmp_path / "nodes"
    for folder in (stores, nodes):
        folder.mkdir(parents=True)
    prologue = BAD_NODES.format(
        folder=nodes, copy=with_another_kernel(tmp_path / "copy"), spoil=SPOILT[spoilt].format(stores=stores)
    )

    def cluster() -> Any:
        made = make(tmp_path / "cluster", prologue=[prologue])
        made.scale(jobs=3)
        return made

    computed = Counter[str]()  # chunks, by worker
    on_computed = Dask._on_computed

    def noting(executor: Dask, task: Any) -> None:
        computed[task.worker] += task.chunk is not None
        on_computed(executor, task)

    monkeypatch.setattr(Dask, "_on_computed", noting)
    with computing(cluster, stores) as executor, running(tmp_path / "data", executor) as service:
        wait_for(lambda: executor.workers() == 2 and len(executor.state().refused) == 1, slurm.log, 180)
        caplog.handler.setLevel(logging.NOTSET)  # the cluster has silenced what gets messages of distributed
        (nodes / "spoil").touch()
        wait_for((nodes / "spoilt").exists, slurm.log, 60)
        namespaces = executor._connection.client.run(os.readlink, "/proc/self/ns/mnt")
        here = str(Path("/proc/self/ns/mnt").readlink())
        [bad] = [worker for worker, namespace in namespaces.items() if namespace != here]
        job = service.submit(sweep)
        watch(slurm, executor, service, job)
        refusals = executor.state().refused
        stored = service.stored(job)
    rested = [message for message in caplog.messages if "gets none for " in message]
    sys.stdout.write(f"computed: {dict(computed)}\n{refusals}\n{rested}\n")
    # One that does not see the stores is refused as soon as it is asked again, which may be before the end.
    [refused] = [refusal for refusal in refusals if "it does not see the service's stores" not in refusal]
    assert all(bad in refusal for refusal in refusals if refusal is not refused)
    assert "its package kernel is " in refused
    assert f" on {socket.gethostname()} " in refused
    assert len(computed) == 1
    assert bad not in computed
    assert not any(worker in refused for worker in computed)
    assert rested or len(refusals) > 1
    assert all(f"worker {bad} on {socket.gethostname()} " in message for message in rested)
    assert {name: stored[name] for name in expected} == expected
