"""docker-compose.yml as it is, in containers of podman on this machine, and what follows where one is killed.

    apt-get install podman runc podman-compose netavark aardvark-dns catatonit iptables mmdebstrap
    pytest -n 0 -s tests/nightly/cluster/test_compose.py

`-s` shows workers and chunks over time. The first run makes the image, which takes some minutes.
"""

import re
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import psutil
import pytest
import xarray
from containers import Podman, Stack, make_image, missing, podman, stack_up
from scripted import wait_for

from service import local
from service.client import Client
from service.client.errors import BounceError
from service.client.job import Job

pytestmark = [
    pytest.mark.timeout(5400),
    pytest.mark.skipif(bool(missing()), reason=missing()),
]

#: What docker-compose.yml starts, and where each container is killed: at this share of the job's chunks.
SERVICES = Counter(scheduler=1, worker=2, service=1)
KILLED_AT = {"worker": 0.1, "scheduler": 0.3, "service": 0.6}
PATIENCE = 600.0

#: About 80 chunks of a core-second each.
SWEEP: dict[str, Any] = {
    "gamma": {"start": 1.0, "stop": 6.0, "num": 15_000},
    "omega": 0.5,
    "xi": 0.26,
    "model": {"kind": "rigid"},
    "settle": 25_000,
    "settle_early": False,
    "observe": 100,
    "keep": 16,
}


@pytest.fixture(scope="module")
def engine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Podman]:
    with podman(tmp_path_factory.mktemp("podman")) as engine:
        make_image(engine)
        yield engine


@pytest.fixture(scope="module")
def stack(engine: Podman) -> Iterator[Stack]:
    with stack_up(engine) as stack:
        wait_for(lambda: workers(stack) == 2, stack.log, PATIENCE)
        yield stack


def ask(stack: Stack, path: str, token: str = "") -> httpx2.Response | None:
    """The service's answer; None while there is none."""
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    try:
        return httpx2.get(f"http://{stack.address}{path}", headers=headers, timeout=10)
    except httpx2.TransportError:
        return None


def metrics(stack: Stack, name: str) -> dict[str, int]:
    """The values of a metric by its labels'; none while the service does not answer."""
    answer = ask(stack, "/metrics", stack.token)
    found = re.findall(rf"^{name}{{(.*)}} (\S+)$", answer.text, re.M) if answer else []
    return {" ".join(re.findall('"(.*?)"', labels)): int(float(value)) for labels, value in found}


def workers(stack: Stack) -> int:
    """Those that compute, a second later."""
    time.sleep(1.0)
    return metrics(stack, "bounce_workers").get("computing", 0)


def test_four_containers_run_without_rights_and_are_healthy(stack: Stack):
    containers = stack.containers()
    assert Counter(re.findall(r"[-_]([a-z]+)[-_]\d+$", name)[0] for name in containers) == SERVICES
    ready = ask(stack, "/readyz")
    assert ready is not None
    assert ready.status_code == 200, ready.text
    for name in containers:
        healthy = stack.engine.attempt("podman", "healthcheck", "run", name)
        assert healthy.returncode == 0, (name, healthy.stdout)
        described = stack.engine.inspect(name)
        assert described["HostConfig"]["ReadonlyRootfs"] is True
        assert described["HostConfig"]["Memory"] > 0
        assert stack.execute(name, "id", "-u").stdout.strip() == "10001"
        refused = stack.execute(name, "touch", "/app/made").stdout  # its own folder
        assert "Read-only file system" in refused, (name, refused)
        assert stack.execute(name, "touch", "/tmp/made").returncode == 0
        status = stack.execute(name, "cat", "/proc/1/status").stdout
        rights = dict(re.findall(r"^(\w+):\s+(\S+)$", status, re.M))
        assert (int(rights["CapPrm"], 16), int(rights["CapBnd"], 16), rights["NoNewPrivs"]) == (0, 0, "1")


def test_only_the_service_is_reached_from_outside_and_only_with_the_token(stack: Stack):
    address, _, port = stack.address.rpartition(":")
    for name in stack.containers():
        ports = stack.engine.inspect(name)["HostConfig"]["PortBindings"]
        expected = [{"HostIp": address, "HostPort": port}] if name == stack.container("service") else None
        assert ports == {"8000/tcp": expected}
    sockets = [each for each in psutil.net_connections(kind="tcp") if each.status == psutil.CONN_LISTEN]
    assert {each.laddr.ip for each in sockets if each.laddr.port == int(port)} == {"127.0.0.1"}
    for token, code in (("", 401), ("a guess of some length", 401), (stack.token, 200)):
        answer = ask(stack, "/v1/jobs", token)
        assert answer is not None
        assert answer.status_code == code
    for name in (stack.container("worker"), stack.container("scheduler")):
        routes = stack.execute(name, "cat", "/proc/net/route").stdout.splitlines()[1:]
        assert routes
        assert not any(route.split()[1] == "00000000" for route in routes), routes  # none to elsewhere


class Watch:
    """Prints what a job and the containers do, once a second, and keeps the chunks that came back."""

    def __init__(self, stack: Stack, job: Job) -> None:
        self.stack, self.job, self.began = stack, job, time.monotonic()
        self.done: list[int] = []
        self.returned: Counter[str] = Counter()  # by what followed, and why

    def look(self) -> None:
        time.sleep(1.0)
        try:
            self.job.refresh()
        except BounceError as error:
            self.say(f"no answer ({type(error).__name__})")
            return
        self.done.append(self.job.progress.chunks_done)
        counted = Counter(metrics(self.stack, "bounce_chunks_returned_total"))
        self.returned |= counted  # the most of each: a new service counts from 0
        computing = metrics(self.stack, "bounce_workers").get("computing")
        self.say(
            f"workers {computing}  chunks {self.done[-1]}/{self.job.progress.chunks_total}  "
            f"came back {dict(counted)}  {self.job.state}"
        )

    def say(self, text: str) -> None:
        sys.stdout.write(f"{time.monotonic() - self.began:6.1f} s  {text}\n")

    def until(self, condition: Any) -> None:
        """Look until the condition holds."""

        def holds() -> bool:
            self.look()
            assert self.job.state != "failed", self.job.error
            return bool(condition())

        wait_for(holds, self.stack.log, PATIENCE)


def same_bytes(one: xarray.Dataset, other: xarray.Dataset) -> bool:
    """Whether all numbers of two datasets are the same, and the text of a coordinate."""
    assert set(one.variables) == set(other.variables)
    for name in one.variables:
        a, b = (np.ascontiguousarray(each[name].values) for each in (one, other))
        if name == "direction":  # how text is held differs between a store and one read over HTTP
            a, b = a.astype("U8"), b.astype("U8")
        assert (name, a.dtype, a.shape) == (name, b.dtype, b.shape)
        if a.tobytes() != b.tobytes():
            return False
    return True


@pytest.fixture
def client(stack: Stack) -> Iterator[Client]:
    with Client(f"http://{stack.address}", stack.token) as client:
        yield client


def test_a_job_outlives_killed_containers_with_the_same_results(stack: Stack, client: Client, tmp_path: Path):
    job = client.submit(SWEEP)
    watch = Watch(stack, job)
    for service, share in KILLED_AT.items():
        watch.until(lambda share=share: job.progress.chunks_done >= share * job.progress.chunks_total)
        name = stack.container(service)
        before = stack.kill(name)
        watch.say(f"killed {name}")
        watch.until(lambda name=name, before=before: stack.pid(name) not in (0, before))
        watch.say(f"{name} is back")
        watch.until(lambda: metrics(stack, "bounce_workers").get("computing") == 2)
        assert job.state == "running", "the job ended before all were killed and back"
    watch.until(lambda: job.finished)
    assert job.state == "done", job.error
    assert job.progress.chunks_done == job.progress.chunks_total
    assert watch.done == sorted(watch.done)  # none is computed again that was done
    assert watch.returned
    assert not any(label.startswith(("give up", "fatal")) for label in watch.returned), watch.returned
    here = local.run(SWEEP, tmp_path / "here.zarr", progress=False)
    assert int((here["outcome"] == 0).sum()) == 0
    assert same_bytes(job.open(), here)
    assert not same_bytes(job.open(), here.assign(flights=here["flights"] + 1))
    stack.compose("down")
    assert stack.containers() == []
    stack.compose("up", "--detach", "--no-build")
    wait_for(lambda: workers(stack) == 2, stack.log, PATIENCE)
    assert job.refresh().state == "done"
    assert same_bytes(job.open(), here)
