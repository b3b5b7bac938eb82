"""Workers that differ from the service get no chunk, beside one that computes; the reason names them."""

import shutil
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from dask_processes import Processes, dask_processes
from paths import CACHE, ROOT
from running import costing, running
from scripted import wait_for

from service.api.monitoring import Readiness
from service.jobs.model import JobState
from worker import store
from worker.executors.admission import Probe, Requirements, facts, run_if_admitted
from worker.executors.dask import Dask
from worker.executors.errors import WorkerRefused
from worker.kernel_cache import warm

PATIENCE = 240.0


def with_another_kernel(processes: Processes, folder: Path) -> None:
    copy = folder / "copy"
    for package in ("kernel", "worker"):
        shutil.copytree(ROOT / package, copy / package, ignore=shutil.ignore_patterns("__pycache__"))
    with (copy / "kernel" / "modes.py").open("a") as file:
        file.write("\n# another kernel\n")
    processes.worker(variables={"PYTHONPATH": str(copy)})


def with_two_threads(processes: Processes, folder: Path) -> None:
    processes.worker("--nthreads", "2")


def without_the_folder(processes: Processes, folder: Path) -> None:
    """In a mount namespace of its own, with an empty folder where the stores are."""
    stores = folder / "data" / "stores"
    stores.mkdir(parents=True, exist_ok=True)
    hide = f'mount -t tmpfs none {stores} && exec "$@"'
    processes.worker(before=("unshare", "--mount", "--map-root-user", "sh", "-c", hide, "sh"))


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    warm(CACHE)
    with dask_processes(tmp_path / "dask") as processes:
        yield processes


@pytest.mark.parametrize(
    ("start", "why"),
    [
        (with_another_kernel, "its package kernel is "),
        (with_two_threads, "it has 2 threads: start it with --nthreads 1"),
        (without_the_folder, "it does not see the service's stores in "),
    ],
)
def test_a_worker_that_differs_is_refused_beside_one_that_computes(
    tmp_path: Path, processes: Processes, start: Callable[[Processes, Path], None], why: str
):
    start(processes, tmp_path)
    executor = Dask(processes.address, stores=str(tmp_path / "data" / "stores"), timeout=60)
    readiness = Readiness(executor, max_age=0.0)
    try:
        with running(tmp_path / "data", executor) as service:
            job = service.submit(costing(chunks=20, seconds=0.1))
            wait_for(lambda: executor.state().refused, processes.log, PATIENCE)
            [reason] = executor.state().refused
            assert why in reason
            assert f"on {socket.gethostname()}" in reason
            assert "tcp://127.0.0.1:" in reason
            assert executor.workers() == 0
            assert readiness.fault() == "no workers yet; jobs wait until there are; workers refused: 1"
            wait_for(lambda: reason in (service.manager.cluster_fault or ""))
            assert service.job(job).chunks_done == 0
            processes.worker()
            ended = service.until(job, JobState.DONE, seconds=PATIENCE)
            assert ended.chunks_done == ended.chunks_total
            assert executor.workers() == 1
            assert readiness.fault() is None
    finally:
        executor.close()


def test_a_worker_whose_folder_is_mounted_late_is_admitted(tmp_path: Path, processes: Processes):
    stores = tmp_path / "data" / "stores"
    executor = Dask(processes.address, stores=str(stores), timeout=60)
    try:
        stores.rename(tmp_path / "away")
        processes.worker()
        wait_for(lambda: executor.state().refused, processes.log, PATIENCE)
        (tmp_path / "away").rename(stores)
        wait_for(lambda: executor.workers() == 1 and not executor.state().refused, seconds=PATIENCE)
    finally:
        executor.close()


def test_what_a_process_is_judged_by(tmp_path: Path):
    url = str(tmp_path / "stores")
    content = store.write_probe(url)
    assert store.write_probe(url) == content
    here = facts()
    try:
        assert Requirements(here, Probe(url, content)).judge(1) == ""
        assert run_if_admitted(sum, [1, 2]) == 3
        assert "does not see" in Requirements(here, Probe(url, "other")).judge(1)
        for name in here:
            reason = Requirements(here | {name: "other"}).judge(1)
            assert reason == f"its {name} is {here[name]}, the service's other"
        assert isinstance(run_if_admitted(sum, [1, 2]), WorkerRefused)
        assert "4 threads" in Requirements(here).judge(4)
    finally:
        Requirements(here).judge(1)  # this process computes for other tests
