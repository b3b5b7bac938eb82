"""dask-jobqueue on a real Slurm of this machine, over TLS, as in docs/deployment.md.

    apt-get install slurm-wlm munge && pip install dask-jobqueue
    pytest -n 0 -s -m cluster tests/cluster/test_slurm.py

`-s` shows allocations, workers and chunks over time.
"""

import gc
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dask
import pytest
from blame import blamed, noting_errors
from paths import CACHE, ROOT
from running import Running, costing, running
from scripted import wait_for
from slurm import Slurm, missing, slurm_running

from service.jobs.model import JobRecord, JobState
from worker.executors.connection import SCHEDULER_SETTINGS
from worker.executors.dask import Dask
from worker.executors.targets import Made
from worker.kernel_cache import warm

jobqueue = pytest.importorskip("dask_jobqueue", reason="needs dask-jobqueue: pip install dask-jobqueue")
pytestmark = [
    pytest.mark.cluster,
    pytest.mark.timeout(1200),
    pytest.mark.skipif(bool(missing()), reason=missing()),
    # Of dask-jobqueue, which waits for no answer of scancel.
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]

#: Seconds after which every allocation is cancelled.
CANCELLED_AFTER = 25


@pytest.fixture(scope="module")
def slurm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Slurm]:
    warm(CACHE)
    folder = tmp_path_factory.mktemp("slurm") / "files"
    with slurm_running(folder) as queue, pytest.MonkeyPatch.context() as patch:
        for name, value in queue.variables.items():
            patch.setenv(name, value)
        with dask.config.set(SCHEDULER_SETTINGS):
            yield queue


def make(folder: Path) -> Any:
    """A cluster whose scheduler and workers speak TLS, with certificates that dask-jobqueue makes."""
    folder.mkdir(exist_ok=True)
    return jobqueue.SLURMCluster(
        queue="all",
        cores=1,
        processes=1,
        memory="2GB",
        walltime="00:10:00",
        python=sys.executable,
        security=True,
        shared_temp_directory=str(folder),
        local_directory=str(folder),
        log_directory=str(folder),
        scheduler_options={"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"},
        worker_extra_args=["--host", "127.0.0.1", "--no-dashboard", "--dashboard-address", "127.0.0.1:0"],
        job_script_prologue=[f"export PYTHONPATH={ROOT}", f"export NUMBA_CACHE_DIR={CACHE}"],
    )


def watch(
    slurm: Slurm, executor: Dask, service: Running, job: JobRecord, cancel_after: float = 1e9
) -> tuple[int, int]:
    """Follow a job until it is done, cancelling old allocations: the most at a time, and those cancelled."""
    began, most = time.monotonic(), 0
    cancelled: set[str] = set()

    def done() -> bool:
        nonlocal most
        jobs = slurm.jobs()
        old = {name for name, ran in jobs.items() if ran >= cancel_after} - cancelled
        for name in old:
            slurm.ask("scancel", name)
        cancelled.update(old)
        most = max(most, len(jobs))
        now = service.job(job)
        sys.stdout.write(
            f"{time.monotonic() - began:6.1f} s  allocations {len(jobs)} (cancelled {len(cancelled)})  "
            f"workers {executor.workers()}  chunks {now.chunks_done}/{now.chunks_total}  {now.state}\n"
        )
        time.sleep(1.0)
        return now.state in (JobState.DONE, JobState.FAILED)

    wait_for(done, slurm.log, seconds=900)
    assert service.job(job).state is JobState.DONE, service.job(job)
    return most, len(cancelled)


def test_a_job_whose_every_allocation_is_cancelled_finishes_and_no_chunk_is_blamed(
    slurm: Slurm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    errors = noting_errors(monkeypatch)

    def cluster() -> Any:
        made = make(tmp_path / "cluster")
        made.scale(jobs=2)
        return made

    executor = Dask(Made(cluster, "slurm:cluster"), timeout=60)
    try:
        with running(tmp_path / "data", executor, chunk_tries=1) as service:
            job = service.submit(costing(chunks=120, seconds=0.5))
            _, cancelled = watch(slurm, executor, service, job, CANCELLED_AFTER)
            ended = service.job(job)
    finally:
        executor.close()
        gc.collect()  # the open files of certificates, while their warnings are ignored
    assert cancelled >= 2
    assert ended.chunks_done == ended.chunks_total
    assert blamed(errors) == []


def test_an_adaptive_batch_queue_grows_from_nothing_and_shrinks(slurm: Slurm, tmp_path: Path):
    def cluster() -> Any:
        made = make(tmp_path / "cluster")
        made.adapt(minimum=0, maximum=3, interval="1 s", target_duration="10 s")
        return made

    executor = Dask(Made(cluster, "slurm:cluster"), timeout=60)
    try:
        with running(tmp_path / "data", executor) as service:
            job = service.submit(costing(chunks=80, seconds=0.5))
            most, _ = watch(slurm, executor, service, job)
            assert most >= 2
            wait_for(lambda: executor.workers() == 0 and not slurm.jobs(), slurm.log, 180)
    finally:
        executor.close()
        gc.collect()  # the open files of certificates, while their warnings are ignored
