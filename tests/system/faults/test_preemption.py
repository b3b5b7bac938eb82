"""Workers that are told to leave: no chunk is blamed for it, and every job is computed to its end."""

import signal
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import psutil
import pytest
from blame import blamed, noting_errors
from dask_processes import Processes, dask_processes, family
from scripted import costing, wait_for
from served import Running, running

from service.ledger.model import JobRecord, JobState
from worker.executors.base import WorkerDied, WorkerLeft
from worker.executors.dask import Dask
from worker.kernel_cache import use_cache

PATIENCE = 240.0


@pytest.fixture
def errors(monkeypatch: pytest.MonkeyPatch) -> list[BaseException]:
    """What chunks came back with, of all jobs of the test."""
    use_cache()
    return noting_errors(monkeypatch)


@contextmanager
def serving(folder: Path, **limits: int) -> Iterator[tuple[Processes, Dask, Running]]:
    """A Dask scheduler without workers, and a service on it that tries each chunk once."""
    with (
        dask_processes(folder / "dask") as processes,
        closing(Dask(processes.address, timeout=60)) as executor,
        running(folder / "data", executor, chunk_tries=1, **limits) as service,
    ):
        yield processes, executor, service


def long_job(service: Running) -> JobRecord:
    """A job that takes longer than every test."""
    return service.submit(costing(gamma={"start": 3.0, "stop": 3.5, "num": 100}, settle=10_000_000))


def wait_until_computing(executor: Dask, processes: Processes) -> None:
    wait_for(lambda: any(task.worker for task in executor._tasks.values()), processes.log, PATIENCE)


@pytest.mark.timeout(500)
def test_a_worker_that_gets_sigterm_costs_no_try(tmp_path: Path, errors: list[BaseException]):
    """A batch queue sends it to all processes of a job; an operator to the one that he started."""
    with serving(tmp_path) as (processes, executor, service):
        job = long_job(service)
        for whole in (True, False):
            worker = processes.worker()
            wait_until_computing(executor, processes)
            for each in family(worker) if whole else family(worker)[:1]:
                with suppress(psutil.NoSuchProcess):  # the first has ended it
                    each.send_signal(signal.SIGTERM)
            worker.wait(PATIENCE)
            wait_for(lambda: executor.state().workers == 0, seconds=PATIENCE)
        assert service.job(job).state is JobState.RUNNING
    assert any(isinstance(error, WorkerLeft) for error in errors)
    assert blamed(errors) == []


@pytest.mark.timeout(500)
def test_a_worker_that_is_killed_costs_a_try(tmp_path: Path, errors: list[BaseException]):
    with serving(tmp_path, failed_chunks=1) as (processes, executor, service):
        job = long_job(service)
        worker = processes.worker()
        wait_until_computing(executor, processes)
        for each in reversed(family(worker)):
            with suppress(psutil.NoSuchProcess):  # ended with another
                each.kill()
        service.until(job, JobState.FAILED, seconds=PATIENCE)
    assert any(isinstance(error, WorkerDied) for error in errors)
