"""Jobs without HTTP: a job manager with its ledger, a counting executor, sweeps of a chosen cost."""

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from scripted import DEADLINE, wait_for

from service.jobs.manager import JobManager
from service.ledger.ledger import Ledger
from service.ledger.model import JobRecord, JobState
from service.ledger.transactions import Deletion
from service.settings import Settings
from worker import store
from worker.executors.base import Executor
from worker.executors.dask import Dask
from worker.study import Chunk, ChunkReport
from worker.sweep import SweepSpec


class Running:
    """A job manager with its ledger, and ways to wait for its jobs."""

    def __init__(self, ledger: Ledger, manager: JobManager, settings: Settings) -> None:
        self.ledger, self.manager, self.settings = ledger, manager, settings

    def submit(self, spec: SweepSpec) -> JobRecord:
        return self.manager.submit(spec).job

    def job(self, job: JobRecord) -> JobRecord:
        current = self.ledger.find(job.id)
        assert current is not None
        return current

    def deletions(self) -> list[Deletion]:
        with self.ledger.reading() as ledger:
            return ledger.deletions()

    def pending_deletions(self) -> int:
        return len(self.deletions())

    def unknown_stores(self) -> list[str]:
        """The names of the stores that the service does not know, as it found them at the start."""
        wait_for(lambda: self.manager.supervisor.unknown_stores is not None)
        return sorted(self.manager.supervisor.unknown_stores or ())

    def until(self, job: JobRecord, *states: JobState, seconds: float = DEADLINE) -> JobRecord:
        wait_for(lambda: self.job(job).state in states, lambda: f"{self.job(job)} is not {states}", seconds)
        return self.job(job)

    def jobs_until(
        self, came: Callable[[], bool], *, chunks: int, seconds: float, patience: float = DEADLINE
    ) -> list[JobRecord]:
        """Have jobs of such a cost computed, one after the other, until something has come, and all are done.

        However fast the machine is, there is work when it comes.
        """
        jobs: list[JobRecord] = []
        while not jobs or not came():
            job = self.submit(costing(f"number {len(jobs)}", chunks, seconds))
            jobs.append(self.until(job, JobState.DONE, JobState.FAILED, seconds=patience))
            assert jobs[-1].state is JobState.DONE, jobs[-1]
        return jobs

    def outcomes(self, job: JobRecord) -> np.ndarray:
        return store.read_slice(self.settings.store_of(job.store), ("outcome",))["outcome"]

    def stored(self, job: JobRecord) -> dict[str, bytes]:
        """The contents of the files of a job's store, by their names in it."""
        url = Path(self.settings.store_of(job.store))
        return {str(path.relative_to(url)): path.read_bytes() for path in url.rglob("*") if path.is_file()}


@contextmanager
def running(folder: Path, executor: Executor, **options: Any) -> Iterator[Running]:
    settings = Settings(data=folder, **{"heartbeat_seconds": 0.2, "window_seconds": 0, **options})
    with Ledger(settings.ledger_path) as ledger:
        manager = JobManager(ledger, executor, settings)
        manager.start()
        try:
            yield Running(ledger, manager, settings)
        finally:
            manager.stop()


class Counting:
    """An executor that records the chunks submitted to it."""

    def __init__(self, executor: Dask) -> None:
        self._executor = executor
        self.chunks: list[int] = []

    @property
    def submitted(self) -> int:
        return len(self.chunks)

    def submit(self, spec: SweepSpec, chunk: Chunk, url: str, **options: Any) -> "Future[ChunkReport]":
        future = self._executor.submit(spec, chunk, url, **options)
        self.chunks.append(chunk.index)
        return future

    def __getattr__(self, name: str) -> Any:
        return getattr(self._executor, name)


def costing(name: str = "", chunks: int = 8, seconds: float = 0.06, **changes: Any) -> SweepSpec:
    """A sweep of `chunks` chunks of about `seconds` core-seconds each, by the cost table."""
    cell = 0.01
    fields: dict[str, Any] = {
        "name": name,
        "gamma": {"start": 0.5, "stop": 1.2, "num": max(round(chunks * seconds / cell), 1)},
        "omega": 0.5,
        "xi": 0.26,
        "model": {"kind": "rigid"},
        "settle": round(cell / 0.4e-6),
        "observe": 10,
        "keep": 4,
        "settle_early": False,
    }
    return SweepSpec(**(fields | changes))
