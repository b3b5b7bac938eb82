"""Workers that differ from the service get no chunk, beside one that computes; the reason names them."""

import shutil
import signal
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, wait
from contextlib import closing, suppress
from pathlib import Path

import psutil
import pytest
from blame import noting_errors
from dask_processes import Processes, dask_processes
from distributed import Client
from paths import ROOT
from scripted import costing, wait_for
from served import running
from stores import marked

from service.ledger.model import JobState
from worker import store
from worker.executors.base import ClusterLost, WorkerRefused
from worker.executors.dask import Dask
from worker.executors.plugins import WorkerAdmission, facts
from worker.kernel_cache import use_cache
from worker.study import ChunkCancelled, ChunkPaused

PATIENCE = 240.0
#: How chunks come back that nobody is to blame for.
EXPECTED = CancelledError | ChunkCancelled | ChunkPaused | WorkerRefused


def changed_project(folder: Path, file: str, line: str) -> dict[str, str]:
    """Variables of a worker with a copy of this project in which a file has another line."""
    for package in ("kernel", "worker"):
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    with (folder / file).open("a") as changed:
        changed.write(f"\n{line}\n")
    return {"PYTHONPATH": str(folder)}


def of_another_release(processes: Processes, folder: Path) -> None:
    """Which lacks what looks at the stores."""
    lacking = changed_project(folder / "copy", "worker/store/__init__.py", "del write_fault")
    processes.worker(variables=lacking)


#: Of a Python without this project until there is a file `installed`. The kernels' files are then where they
#: are for others, whose compiled kernels it can use.
BARE = """
import sys
from importlib.machinery import PathFinder
from pathlib import Path

class Late:
    def find_spec(name, path=None, target=None):
        if path is None and Path({tree!r}, "installed").exists():
            return PathFinder.find_spec(name, [{root!r}], target)

sys.path[:] = [entry for entry in sys.path if not Path(entry, "kernel", "params.py").exists()]
sys.meta_path[:] = [finder for finder in sys.meta_path if "bouncing_spring" not in finder.__module__]
sys.meta_path.append(Late)
"""


def without_the_project(processes: Processes, folder: Path) -> None:
    tree = folder / "tree"
    tree.mkdir()
    (tree / "sitecustomize.py").write_text(BARE.format(tree=str(tree), root=str(ROOT)))
    processes.worker(variables={"PYTHONPATH": str(tree)})


def with_broken_numba(processes: Processes, folder: Path) -> None:
    """With a library that is there, in the right version, and cannot be imported."""
    (folder / "tree" / "numba").mkdir(parents=True)
    (folder / "tree" / "numba" / "__init__.py").write_text('raise ImportError("no\\nlibnumba.so")\n')
    processes.worker(variables={"PYTHONPATH": f"{folder / 'tree'}:{ROOT}"})


def that_dies_at_once(processes: Processes, folder: Path) -> None:
    """Without a nanny, which would start it again; it ends as soon as it is to be prepared."""
    dying = changed_project(folder / "copy", "worker/kernel_cache.py", "os._exit(1)")
    processes.worker("--no-nanny", variables=dying)


def on_a_read_only_folder(processes: Processes, folder: Path) -> None:
    """In a mount namespace of its own, in which it sees the stores and cannot write there."""
    stores = folder.parent / "data" / "stores"
    stores.mkdir(parents=True, exist_ok=True)
    fix = f'mount --bind {stores} {stores} && mount -o remount,bind,ro {stores} && exec "$@"'
    processes.worker(before=("unshare", "--mount", "--map-root-user", "sh", "-c", fix, "sh"))


def with_two_threads(processes: Processes, folder: Path) -> None:
    processes.worker("--nthreads", "2")


def without_the_folder(processes: Processes, folder: Path) -> None:
    """In a mount namespace of its own, with an empty folder where the stores are."""
    stores = folder.parent / "data" / "stores"
    stores.mkdir(parents=True, exist_ok=True)
    hide = f'mount -t tmpfs none {stores} && exec "$@"'
    processes.worker(before=("unshare", "--mount", "--map-root-user", "sh", "-c", hide, "sh"))


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    use_cache()
    with dask_processes(tmp_path / "dask") as processes:
        yield processes


#: How workers differ, and what is said of each.
DIFFERENT = {
    of_another_release: "its package worker is ",
    with_two_threads: "it has 2 threads: start it with --nthreads 1",
    without_the_folder: "it does not see the service's stores in ",
    on_a_read_only_folder: "it cannot write into ",
    without_the_project: "it cannot load the kernel: ModuleNotFoundError: No module named 'kernel'",
    with_broken_numba: "it cannot load the kernel: ImportError: no libnumba.so",
}


def test_workers_that_differ_are_refused_beside_one_that_computes(tmp_path: Path, processes: Processes):
    for start in DIFFERENT:
        (tmp_path / start.__name__).mkdir()
        start(processes, tmp_path / start.__name__)
    with Client(processes.address, timeout=60, set_as_default=False) as client:
        wait_for(lambda: len(client.scheduler_info()["workers"]) == len(DIFFERENT), processes.log, PATIENCE)
    with (
        closing(Dask(processes.address, stores=marked(tmp_path / "data"), timeout=60)) as executor,
        running(tmp_path / "data", executor) as service,
    ):
        job = service.submit(costing(chunks=20, seconds=0.1))
        wait_for(lambda: len(executor.state().refused) == len(DIFFERENT), processes.log, PATIENCE)
        refused = executor.state().refused
        for why in DIFFERENT.values():
            [reason] = [reason for reason in refused if why in reason]
            assert f"on {socket.gethostname()}" in reason
            assert "tcp://127.0.0.1:" in reason
        assert executor.state().workers == 0
        wait_for(lambda: refused[0] in (service.manager.supervisor.cluster.explanation or ""))
        assert service.manager.fault() == "no workers yet; jobs wait until there are; workers refused: 6"
        assert service.job(job).chunks_done == 0
        processes.worker()
        ended = service.until(job, JobState.DONE, seconds=PATIENCE)
        assert ended.chunks_done == ended.chunks_total
        wait_for(lambda: executor.state().workers == 1)
        wait_for(lambda: service.manager.fault() is None)


def test_a_worker_that_dies_while_it_is_prepared_does_not_keep_the_service_from_starting(
    tmp_path: Path, processes: Processes, caplog: pytest.LogCaptureFixture
):
    that_dies_at_once(processes, tmp_path)
    processes.worker()
    with Client(processes.address, timeout=60, set_as_default=False) as client:
        wait_for(lambda: len(client.scheduler_info()["workers"]) == 2, processes.log, PATIENCE)
    with closing(Dask(processes.address, stores=marked(tmp_path / "data"), timeout=60)) as executor:
        assert "the workers cannot be prepared, trying again" in caplog.text
        assert executor.call(len, "abc").result(PATIENCE) == 3
        wait_for(lambda: executor.state().workers == 1)


def test_a_worker_that_joins_and_cannot_load_the_kernel_fails_no_chunk_until_it_can(
    tmp_path: Path, processes: Processes, monkeypatch: pytest.MonkeyPatch
):
    """It is given a chunk at once, before it is refused."""
    errors = noting_errors(monkeypatch)
    processes.worker()
    with (
        closing(Dask(processes.address, stores=marked(tmp_path / "data"), timeout=60)) as executor,
        running(tmp_path / "data", executor, chunk_tries=1) as service,
    ):
        job = service.submit(costing(chunks=2000, seconds=0.1))
        wait_for(lambda: service.job(job).chunks_done >= 1, processes.log, PATIENCE)
        without_the_project(processes, tmp_path)
        wait_for(lambda: executor.state().refused, processes.log, PATIENCE)
        done = service.job(job).chunks_done
        wait_for(lambda: service.job(job).chunks_done >= done + 3, processes.log, PATIENCE)
        wait_for(lambda: executor.state().workers == 1)
        wait_for(lambda: len(executor._connection.worker_threads() or ()) == 2)
        (tmp_path / "tree" / "installed").touch()
        wait_for(
            lambda: executor.state().workers == 2 and not executor.state().refused, processes.log, PATIENCE
        )
        service.manager.cancel(job.id)
        assert service.until(job, JobState.CANCELLED).error is None
    unexpected = [error for error in errors if not isinstance(error, EXPECTED)]
    assert unexpected == []


def test_a_worker_whose_folder_is_mounted_late_is_admitted(tmp_path: Path, processes: Processes):
    stores = tmp_path / "data" / "stores"
    with closing(Dask(processes.address, stores=marked(tmp_path / "data"), timeout=60)) as executor:
        stores.rename(tmp_path / "away")
        processes.worker()
        wait_for(lambda: executor.state().refused, processes.log, PATIENCE)
        (tmp_path / "away").rename(stores)
        wait_for(lambda: executor.state().workers == 1 and not executor.state().refused, seconds=PATIENCE)


def test_workers_of_this_machine_that_cannot_compute_are_an_error_and_are_ended(tmp_path, monkeypatch):
    """No others will join. Here their cache is open to all users."""
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(0o777)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))

    def running() -> set[object]:
        """Worker processes, and threads that keep a connection."""
        workers = set()
        for process in psutil.Process().children(recursive=True):
            with suppress(psutil.Error):  # it has ended
                if "spawn_main" in " ".join(process.cmdline()):
                    workers.add(process.pid)
        return workers | {thread for thread in threading.enumerate() if thread.name == "scheduler"}

    before = running()
    with pytest.raises(
        ClusterLost,
        match=r"^no worker can compute: it cannot load the kernel: CacheRefused: the kernel cache",
    ):
        Dask(workers=1)
    wait_for(lambda: running() <= before)


def test_a_worker_that_a_service_of_another_release_admits_computes_nothing(tmp_path, processes: Processes):
    of_another_release(processes, tmp_path)
    with closing(Dask(processes.address)) as executor, Client(processes.address) as other:
        wait_for(lambda: executor.state().refused, processes.log, PATIENCE)
        [theirs] = other.run(facts).values()
        other.register_plugin(WorkerAdmission(theirs))
        with pytest.raises(ClusterLost, match="a service of another release admits it"):
            executor.call(divmod, 17, 5).result(PATIENCE)
        wait_for(lambda: "another release" in "".join(executor.state().refused), processes.log)


def test_a_service_starts_beside_a_worker_that_hangs(tmp_path: Path, processes: Processes):
    hanging, _ = processes.worker("--no-nanny"), processes.worker()
    with Client(processes.address) as client:
        client.wait_for_workers(2, timeout=PATIENCE)
    hanging.send_signal(signal.SIGSTOP)
    try:
        with closing(Dask(processes.address, timeout=10.0)) as executor:
            results = [executor.call(divmod, 17, 5) for _ in range(2)]  # one for each worker
            done, _ = wait(results, PATIENCE, FIRST_COMPLETED)
            assert [result.result() for result in done] == [(3, 2)]
    finally:
        hanging.send_signal(signal.SIGCONT)


def test_what_a_process_is_judged_by(tmp_path: Path):
    url, content, here = str(tmp_path / "stores"), "ours", facts()
    store.write_marker(url, content)
    assert WorkerAdmission(here, (url, content)).judge(1) == ""
    assert "does not see" in WorkerAdmission(here, (url, "other")).judge(1)
    for name in here:
        reason = WorkerAdmission(here | {name: "other"}).judge(1)
        assert reason == f"its {name} is {here[name]}, the service's other"
    assert "4 threads" in WorkerAdmission(here).judge(4)
