"""docker-compose.yml as it is, in containers of podman on this machine, and what follows where one is killed.

    apt-get install podman runc podman-compose netavark aardvark-dns catatonit iptables mmdebstrap
    pytest -n 0 tests/nightly/cluster/test_compose.py

The first run makes the image, which takes some minutes.
"""

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
import xarray
from containers import Stack, missing, stack_up
from scripted import wait_for
from studies import spec_of

from service import local
from service.client import BounceError, Client

pytestmark = [pytest.mark.timeout(5400), pytest.mark.skipif(bool(missing()), reason=missing())]

#: What docker-compose.yml starts, and where each container is killed: at this share of the job's chunks.
SERVICES = Counter(scheduler=1, worker=2, service=1)
KILLED_AT = {"worker": 0.1, "scheduler": 0.3, "service": 0.6}
PATIENCE = 600.0

#: About 80 chunks of a core-second each.
SWEEP = spec_of((1.0, 6.0, 15_000), 0.5, 0.26, window=(25_000, 100, 16))


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    with stack_up(tmp_path_factory.mktemp("podman")) as stack:
        wait_for(lambda: stack.workers() == 2, stack.log, PATIENCE)
        yield stack


def test_all_containers_are_healthy(stack: Stack):
    containers = stack.containers()
    assert Counter(re.findall(r"[-_]([a-z]+)[-_]\d+$", name)[0] for name in containers) == SERVICES
    for name in containers:
        healthy = stack.engine.attempt("podman", "healthcheck", "run", name)
        assert healthy.returncode == 0, (name, healthy.stdout)


def same_bytes(one: xarray.Dataset, other: xarray.Dataset) -> bool:
    """Whether all numbers of two datasets are the same; over HTTP text is held differently."""
    numbers = (name for name in one.variables if name != "direction")
    return all(one[name].values.tobytes() == other[name].values.tobytes() for name in numbers)


def test_a_job_outlives_killed_containers_with_the_same_results(stack: Stack, tmp_path: Path):
    done: list[int] = []
    returned = Counter[str]()  # chunks that came back, by what followed, and why

    def progress() -> float:
        """The share of the chunks that is done; looked at about once a second."""
        try:
            job.refresh()
        except BounceError:
            return 0.0
        assert job.state != "failed", job.error
        returned.update(set(stack.metrics("bounce_chunks_returned_total")))
        done.append(job.progress.chunks_done)
        return done[-1] / job.progress.chunks_total

    with Client(f"http://{stack.address}", stack.token) as client:
        job = client.submit(SWEEP)
        for service, share in KILLED_AT.items():
            wait_for(lambda share=share: progress() >= share, stack.log, PATIENCE)
            name = stack.container(service)
            before = stack.kill(name)
            wait_for(lambda name=name, before=before: stack.pid(name) not in (0, before), stack.log, PATIENCE)
            wait_for(lambda: stack.workers() == 2, stack.log, PATIENCE)
            assert progress() < 1.0, "the job ended before all were killed and back"
        wait_for(lambda: progress() == 1.0 and job.finished, stack.log, PATIENCE)
        assert done == sorted(done)  # none is computed again that was done
        assert returned
        assert not any(label.startswith(("give up", "fatal")) for label in returned), returned
        here = local.run(SWEEP, tmp_path / "here.zarr", progress=False)
        assert same_bytes(job.open(), here)
        stack.compose("down")
        assert stack.containers() == []
        stack.compose("up", "--detach", "--no-build")
        wait_for(lambda: stack.workers() == 2, stack.log, PATIENCE)
        assert job.refresh().state == "done"
        assert same_bytes(job.open(), here)
