"""dask-jobqueue on a real Slurm of this machine, over TLS, as in docs/deployment.md.

    apt-get install slurm-wlm munge && pip install dask-jobqueue
    pytest -n 0 tests/nightly/cluster/test_slurm.py

What differing and failing nodes do is tested with workers of this machine (tests/system/worker).
"""

import gc
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import dask
import pytest
from blame import blamed, noting_errors
from paths import CACHE, ROOT
from scripted import wait_for
from served import Running, running
from slurm import Allocations, Slurm, missing, slurm_running

from worker.executors.clusters import SCHEDULER_SETTINGS, CreatedCluster
from worker.executors.dask import Dask
from worker.kernel_cache import use_cache

jobqueue = pytest.importorskip("dask_jobqueue", reason="needs dask-jobqueue: pip install dask-jobqueue")
pytestmark = [
    pytest.mark.timeout(2400),
    pytest.mark.skipif(bool(missing()), reason=missing()),
    # Of dask-jobqueue, which waits for no answer of scancel.
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]

PATIENCE = 1500.0


@pytest.fixture(scope="module")
def slurm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Slurm]:
    use_cache(CACHE)
    with (
        slurm_running(tmp_path_factory.mktemp("slurm") / "files") as queue,
        pytest.MonkeyPatch.context() as patch,
        dask.config.set(SCHEDULER_SETTINGS),
    ):
        for name, value in queue.variables.items():
            patch.setenv(name, value)
        yield queue


@pytest.fixture(autouse=True)
def collected() -> Iterator[None]:
    """A test's cluster goes with the test: it leaves files open, whose warnings are ignored."""
    yield
    gc.collect()


@contextmanager
def computing(
    folder: Path, grow: Callable[[Any], object], walltime: str = "00:10:00"
) -> Iterator[tuple[Dask, Running]]:
    """A service on a cluster whose scheduler and workers speak TLS, with dask-jobqueue's certificates."""
    cluster = folder / "cluster"
    cluster.mkdir()

    def make() -> Any:
        made = jobqueue.SLURMCluster(
            queue="all",
            cores=1,
            processes=1,
            memory="2GB",
            walltime=walltime,
            python=sys.executable,
            security=True,
            shared_temp_directory=str(cluster),
            local_directory=str(cluster),
            log_directory=str(cluster),
            scheduler_options={"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"},
            worker_extra_args=["--host", "127.0.0.1", "--no-dashboard", "--dashboard-address", "127.0.0.1:0"],
            job_script_prologue=[f"export PYTHONPATH={ROOT}", f"export NUMBA_CACHE_DIR={CACHE}"],
        )
        grow(made)
        return made

    with (
        closing(Dask(CreatedCluster(make, "slurm:cluster"), timeout=60)) as executor,
        running(folder / "data", executor, chunk_tries=1) as service,
    ):
        yield executor, service


@pytest.mark.parametrize(
    ("walltime", "cancel_after"),
    [("00:10:00", 25.0), ("00:01:00", math.inf)],
    ids=["scancel", "walltime"],  # Slurm looks at time limits twice a minute
)
def test_allocations_that_end_are_replaced_and_no_chunk_is_blamed(
    slurm: Slurm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, walltime: str, cancel_after: float
):
    errors = noting_errors(monkeypatch)
    with (
        computing(tmp_path, lambda made: made.scale(jobs=2), walltime) as (_, service),
        Allocations(slurm, cancel_after) as allocations,
    ):
        service.jobs_until(
            lambda: len(allocations.ended) >= 2 and allocations.seen > allocations.ended,
            chunks=40,
            seconds=0.5,
            patience=PATIENCE,
        )
    assert blamed(errors) == []


def test_an_adaptive_batch_queue_grows_from_nothing_and_shrinks(slurm: Slurm, tmp_path: Path):
    def grow(made: Any) -> None:
        made.adapt(minimum=0, maximum=3, interval="1 s", target_duration="10 s")

    with computing(tmp_path, grow) as (executor, service), Allocations(slurm) as allocations:
        service.jobs_until(lambda: allocations.most >= 2, chunks=400, seconds=0.5, patience=PATIENCE)
        wait_for(lambda: executor.workers() == 0 and not slurm.jobs(), slurm.log, 180)
