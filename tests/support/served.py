"""A service, in the ways that tests start one, and requests that most of them make.

`running`: its jobs, without HTTP. `service`, `computing`, `occupied`: the application, with a client.
`service_at`, `computing_at`: at an address, in this process. `serving`: `bounce serve`, a process of its own.
`listening`: an application on a real connection.
"""

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import psutil
import pytest
import uvicorn
import xarray
from fastapi.testclient import TestClient
from json_results import from_json
from paths import CACHE, ROOT
from scripted import DEADLINE, Held, costing, free_port, sweep, wait_for
from stores import files
from studies import spec_of

from service.api import app as application
from service.api.app import create_app
from service.jobs.manager import JobManager
from service.jobs.on_demand import OnDemandCache
from service.ledger.ledger import Ledger
from service.ledger.model import JobRecord, JobState
from service.ledger.transactions import Deletion
from service.server import embedded
from service.settings import Settings
from worker import store
from worker.executors.base import Executor
from worker.executors.inline import Inline
from worker.sweep import SweepSpec

#: Sweeps that several tests submit.
FIGURE_2 = spec_of((0.5, 6.0, 111), 0.5, 0.26, name="figure 2, coarse")
RAMP = spec_of(
    (0.6, 1.6, 11), [0.5, 0.7], [0.05, 0.26], name="up and down, Γ × Ω", ramp="both", window=(40, 20, 8)
)


def settings_of(folder: Path, **settings: Any) -> Settings:
    """Settings with short heartbeats and few chunks at work, unless they say otherwise."""
    return Settings(data=folder, **{"heartbeat_seconds": 0.2, "window_seconds": 0, **settings})


# Jobs without HTTP


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
        """Compute jobs of this cost one after another until `came()`; all are done then.

        There is always work when it comes, on a fast machine too.
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
        return files(self.settings.store_of(job.store))


@contextmanager
def running(folder: Path, executor: Executor, **options: Any) -> Iterator[Running]:
    settings = settings_of(folder, **options)
    with Ledger(settings.ledger_path) as ledger:
        manager = JobManager(ledger, executor, settings)
        manager.start()
        try:
            yield Running(ledger, manager, settings)
        finally:
            manager.stop()


# The application


@contextmanager
def service(folder: Path, executor: Executor, **settings: Any) -> Iterator[TestClient]:
    app = create_app(settings_of(folder, **settings), executor)
    with TestClient(app, base_url="http://localhost") as client:
        yield client


@contextmanager
def computing(folder: Path, **settings: Any) -> Iterator[TestClient]:
    """A service that computes in this process."""
    with closing(Inline()) as executor, service(folder, executor, **settings) as client:
        yield client


@contextmanager
def service_at(folder: Path, executor: Executor, **settings: Any) -> Iterator[str]:
    """The address of a service in this process."""
    merged = Settings(data=folder, **{"port": 0, "heartbeat_seconds": 0.2, **settings})
    with embedded.running(merged, executor) as address:
        yield address


@contextmanager
def computing_at(folder: Path, **settings: Any) -> Iterator[str]:
    with closing(Inline()) as executor, service_at(folder, executor, **settings) as address:
        yield address


def impatient(patch: pytest.MonkeyPatch) -> None:
    """Applications made from now on answer at once that workers are still computing, not after seconds."""
    patch.setattr(application, "OnDemandCache", partial(OnDemandCache, timeout=0.02))


@contextmanager
def occupied(folder: Path, **settings: Any) -> Iterator[TestClient]:
    """A service that runs one job at a time, and runs one that never ends: submitted jobs stay queued."""
    with service(folder, Held(), active_jobs=1, **settings) as client:
        first = client.post("/v1/jobs", json=sweep("never ends", omega=0.123).as_submitted())
        here = first.headers["Location"]
        wait_for(lambda: bool(get(client, here)["state"] == "running"))
        yield client


@contextmanager
def listening(app: Any, http: Any) -> Iterator[tuple[str, int]]:
    """The address of an application on a real connection, `http` being its uvicorn protocol."""
    server = uvicorn.Server(uvicorn.Config(app, http=http, port=0, log_level="error"))
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        wait_for(lambda: server.started)
        yield server.servers[0].sockets[0].getsockname()
    finally:
        server.should_exit = True
        thread.join()


# A process of its own


class Serving:
    """A service that computes in `folder`/data and logs to `folder`/log."""

    def __init__(self, folder: Path, before: Sequence[str], variables: dict[str, str], options: Any) -> None:
        port = free_port()
        self.url, self.log = f"http://127.0.0.1:{port}", folder / "log"
        words = ["serve", "--port", str(port), "--data", str(folder / "data")]
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                [*before, sys.executable, "-m", "service.cli.entry", *words],
                stdout=log, stderr=log, cwd=ROOT,
                env=os.environ | {"NUMBA_CACHE_DIR": str(CACHE)} | variables, **options,
            )  # fmt: skip

    def ask(self, method: str, path: str, **given: Any) -> httpx2.Response:
        return httpx2.request(method, self.url + path, timeout=DEADLINE, **given)

    def is_ready(self) -> bool:
        assert self.process.poll() is None, self.log.read_text()
        try:
            return self.ask("GET", "/readyz").status_code == 200
        except httpx2.TransportError:
            return False

    def family(self) -> list[psutil.Process]:
        """The processes that it has started."""
        return psutil.Process(self.process.pid).children(recursive=True)


@contextmanager
def serving(
    folder: Path, before: Sequence[str] = (), *, variables: dict[str, str] | None = None, **options: Any
) -> Iterator[Serving]:
    """A service that is ready; `before` is a command that starts it, `options` are those of its process."""
    service = Serving(folder, before, variables or {}, options)
    family: list[psutil.Process] = []
    try:
        wait_for(service.is_ready)
        family = service.family()
        yield service
    finally:
        if service.process.poll() is None:
            family += service.family()
            service.process.terminate()
            service.process.wait(DEADLINE)
        _, left = psutil.wait_procs(family, timeout=DEADLINE)
        for process in left:
            process.kill()
        assert left == [], "processes outlived the service"


# Requests


def finished(client: TestClient | httpx2.Client, spec: dict[str, Any]) -> str:
    """Submit a sweep, wait until it is done, and return the job's path."""
    answer = client.post("/v1/jobs", json=spec)
    assert answer.status_code in (200, 202), answer.text
    here = str(answer.headers["Location"])
    wait_for(lambda: client.get(here).json()["state"] not in ("queued", "running"))
    view = client.get(here).json()
    assert view["state"] == "done", view["error"]
    return here


def done(address: str, spec: dict[str, Any]) -> str:
    """Submit a study to the service at an address, wait until it is done, and return the job's id."""
    with httpx2.Client(base_url=address, timeout=DEADLINE) as client:
        return finished(client, spec).rsplit("/", 1)[1]


@contextmanager
def taken(client: TestClient, activity: str, *, slots: int = 1, memory: int = 0) -> Iterator[None]:
    """Hold slots of an activity of costly requests, each with `memory` bytes, during the block."""
    capacity, loop = client.app.state.service.capacity, client.portal  # type: ignore[attr-defined]
    assert loop is not None
    leases = [loop.call(capacity.acquire, activity, memory) for _ in range(slots)]
    try:
        yield
    finally:
        for lease in leases:
            loop.call(lease.keep, 0)


def get(client: TestClient, path: str, **query: Any) -> Any:
    answer = client.get(path, params=query)
    assert answer.status_code == 200, answer.text
    return answer.json()


def read(client: TestClient, path: str, **query: Any) -> xarray.Dataset:
    """A result that is a Dataset."""
    answer = client.get(path, params=query)
    assert answer.status_code == 200, answer.text
    return from_json(answer.content)
