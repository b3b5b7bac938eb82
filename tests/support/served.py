"""The application on a data folder, in this process, and requests that most tests make."""

import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import httpx2
import pytest
import uvicorn
import xarray
from fastapi.testclient import TestClient
from json_results import from_json
from scripted import DEADLINE, Held, sweep, wait_for

from service.api import app as application
from service.api.app import create_app
from service.jobs.on_demand import OnDemandCache
from service.server import embedded
from service.settings import Settings
from worker.executors.base import Executor
from worker.executors.inline import Inline

#: Sweeps that several tests submit.
FIGURE_2: dict[str, Any] = {
    "name": "figure 2, coarse",
    "gamma": {"start": 0.5, "stop": 6.0, "num": 111},
    "omega": 0.5,
    "xi": 0.26,
    "model": {"kind": "rigid"},
}
RAMP: dict[str, Any] = {
    "name": "up and down, Γ × Ω",
    "gamma": {"start": 0.6, "stop": 1.6, "num": 11},
    "omega": [0.5, 0.7],
    "xi": [0.05, 0.26],
    "protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"},
    "model": {"kind": "rigid"},
    "settle": 40,
    "observe": 20,
    "keep": 8,
}


@contextmanager
def service(folder: Path, executor: Executor, **settings: Any) -> Iterator[TestClient]:
    """The application with `settings`, and with short heartbeats unless they say otherwise."""
    merged = Settings(data=folder, **{"heartbeat_seconds": 0.2, "window_seconds": 0, **settings})
    with TestClient(create_app(merged, executor), base_url="http://localhost") as client:
        yield client


@contextmanager
def computing(folder: Path, **settings: Any) -> Iterator[TestClient]:
    """A service that computes in this process."""
    with closing(Inline()) as executor, service(folder, executor, **settings) as client:
        yield client


@contextmanager
def computing_at(folder: Path, **settings: Any) -> Iterator[str]:
    """The address of a service that computes in this process."""
    merged = Settings(data=folder, **{"port": 0, "heartbeat_seconds": 0.2, **settings})
    with closing(Inline()) as executor, embedded.running(merged, executor) as address:
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
    """Hold so many slots of an activity of costly requests, and so much memory, during the block."""
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
