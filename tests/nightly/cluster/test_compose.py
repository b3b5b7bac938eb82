"""docker-compose.yml as it is, in containers of podman on this machine, and what follows where one is killed.

    apt-get install podman runc podman-compose netavark aardvark-dns catatonit iptables mmdebstrap
    pytest -n 0 tests/nightly/cluster/test_compose.py

As root. The first run makes the image, which takes some minutes. No image is fetched: the Dockerfile's base
is made of Debian's packages. Podman has a store of its own, STORE, so no other image, container or network of
the machine is touched. Images stay there between runs; everything else is removed at the end.
"""

import fcntl
import json
import os
import re
import secrets
import shutil
import signal
import subprocess
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import xarray
from dask_processes import Remote
from extras import missing_programs
from paths import ROOT
from scripted import free_port, wait_for
from studies import spec_of

from service import local
from service.client import BounceError, Client

#: Each is in the package of that name.
PROGRAMS = (
    "podman", "runc", "podman-compose", "netavark", "aardvark-dns", "catatonit", "iptables", "mmdebstrap",
)  # fmt: skip
#: Where they are.
PATH = f"{os.environ['PATH']}:/usr/sbin:/usr/lib/podman:/usr/libexec/podman"

STORE = Path("/var/cache/bouncing-spring/containers")
#: Podman's state until the machine restarts.
RUN = Path("/run/bouncing-spring/containers")

IMAGE = "bouncing-spring"
PROJECT = "bouncing-spring-test"

#: Lower than those of most machines. Podman would raise its own, which not every root may do.
LIMITS = ["nofile=16384:16384", "nproc=16384:16384"]

# Without what podman asks systemd for elsewhere: control groups, logs, events.
CONTAINERS_CONF = """
[containers]
default_ulimits = {limits}
init_path = "{init}"
log_driver = "k8s-file"
[engine]
cgroup_manager = "cgroupfs"
events_logger = "file"
runtime = "runc"
tmp_dir = "{run}/libpod"
[network]
network_backend = "netavark"
network_config_dir = "{store}/networks"
"""
STORAGE_CONF = """
[storage]
driver = "overlay"
graphroot = "{store}/graph"
runroot = "{run}/storage"
"""

#: Seconds for a command of podman; for the image, with all libraries and compiled kernels.
COMMAND_SECONDS, BUILD_SECONDS = 120.0, 3600.0


def missing() -> str:
    """Why there can be no containers here; empty if there can."""
    return missing_programs(PROGRAMS, PATH, " ".join(PROGRAMS))


class Podman:
    """Podman with its own store; `variables` make its commands use it. The folder holds settings and logs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        names = {
            "store": STORE,
            "run": RUN,
            "init": shutil.which("catatonit", path=PATH),
            "limits": json.dumps(LIMITS),
        }
        (folder / "containers.conf").write_text(CONTAINERS_CONF.format(**names))
        (folder / "storage.conf").write_text(STORAGE_CONF.format(**names))
        self.variables = {
            "CONTAINERS_CONF": str(folder / "containers.conf"),
            "CONTAINERS_STORAGE_CONF": str(folder / "storage.conf"),
            "PATH": PATH,
        }
        if not Path("/run/systemd/system").exists():
            self.variables["DISABLE_HC_SYSTEMD"] = "true"  # otherwise no container with a health check starts

    def run(self, *command: str, seconds: float = COMMAND_SECONDS, **variables: str) -> str:
        """The output of a command. Raises if it fails."""
        done = self.attempt(*command, seconds=seconds, **variables)
        assert done.returncode == 0, f"{' '.join(command)}: {done.returncode}\n{done.stdout[-6000:]}"
        return done.stdout

    def attempt(
        self, *command: str, seconds: float = COMMAND_SECONDS, **variables: str
    ) -> subprocess.CompletedProcess[str]:
        """A command that may fail. It writes to a file: processes that it leaves would hold a pipe open."""
        with (self.folder / "output").open("w+") as output:
            done = subprocess.run(
                command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, text=True,
                cwd=ROOT, env=os.environ | self.variables | variables, check=False, timeout=seconds,
            )  # fmt: skip
            output.seek(0)
            return subprocess.CompletedProcess(command, done.returncode, output.read(), "")

    def inspect(self, container: str) -> dict[str, Any]:
        (found,) = json.loads(self.run("podman", "inspect", container))
        return dict(found)

    def clear(self) -> None:
        """Remove all containers, networks and volumes of the store."""
        self.run("podman", "rm", "--all", "--force", "--volumes", "--time", "0")
        self.run("podman", "pod", "rm", "--all", "--force")
        self.run("podman", "volume", "rm", "--all", "--force")
        self.run("podman", "network", "prune", "--force")


# ---- The image


def make_image(engine: Podman) -> None:
    """Build the image from the Dockerfile; podman's cache keeps what has not changed."""
    (base,) = re.findall(r"^FROM (\S+)$", (ROOT / "Dockerfile").read_text(), re.M)
    if engine.attempt("podman", "image", "exists", f"localhost/{base}").returncode:
        make_base(engine, base)
    engine.run(
        "podman", "build", "--pull=never", "--network=host",
        *(f"--ulimit={limit}" for limit in LIMITS),
        *(f"--volume={file}:{file}:ro" for file in [Path("/etc/pip.conf")] if file.exists()),
        f"--tag={IMAGE}", str(ROOT), seconds=BUILD_SECONDS,
    )  # fmt: skip
    engine.run("podman", "image", "prune", "--force")


def make_base(engine: Podman, name: str) -> None:
    """Debian's packages in the place of python:VERSION-slim-SUITE. Python is in /usr/local, as there."""
    parts = re.fullmatch(r"python:(\d+\.\d+)-slim-(\w+)", name)
    assert parts, name
    root = engine.folder / "base.tar"
    engine.run(
        "mmdebstrap", "--variant=minbase", "--include=ca-certificates,python3-venv",
        '--customize-hook=chroot "$1" python3 -m venv /usr/local', parts[2], str(root), seconds=BUILD_SECONDS,
    )  # fmt: skip
    engine.run("podman", "import", str(root), f"localhost/{name}", seconds=BUILD_SECONDS)
    root.unlink()
    version = engine.run("podman", "run", "--rm", "--network=none", name, "python", "--version")
    assert re.search(rf"^Python {re.escape(parts[1])}\.", version, re.M), version


# ---- docker-compose.yml


class Stack(Remote):
    """The services of docker-compose.yml, with a project name, a port and a token of their own."""

    def __init__(self, engine: Podman) -> None:
        super().__init__(f"127.0.0.1:{free_port()}", secrets.token_urlsafe())
        self.engine = engine

    def compose(self, *arguments: str) -> str:
        command = ["podman-compose", "-f", str(ROOT / "docker-compose.yml"), "-p", PROJECT, *arguments]
        return self.engine.run(
            *command, seconds=2 * COMMAND_SECONDS, BOUNCE_TOKEN=self.token, BOUNCE_PUBLISH=self.address
        )

    def containers(self) -> list[str]:
        """The names of all containers, of those too that have ended."""
        listed = self.engine.run("podman", "ps", "--all", "--format", "{{.Names}}")
        return sorted(listed.split())

    def container(self, service: str) -> str:
        """The first container of a service."""
        return next(name for name in self.containers() if re.search(rf"[-_]{service}[-_]\d+$", name))

    def pid(self, container: str) -> int:
        """Its first process, on this machine; 0 while it does not run."""
        return int(self.engine.inspect(container)["State"]["Pid"])

    def kill(self, container: str) -> int:
        """SIGKILL its first process, and return its number. After `podman kill` it would stay away."""
        pid = self.pid(container)
        os.kill(pid, signal.SIGKILL)
        return pid

    def log(self) -> str:
        """The state of all containers, and the ends of their logs."""
        logs = [["podman", "logs", "--tail", "25", name] for name in self.containers()]
        return "\n".join(self.engine.attempt(*each).stdout for each in [["podman", "ps", "--all"], *logs])


@contextmanager
def stack_up(folder: Path) -> Iterator[Stack]:
    """The stack, one at a time; before and after it podman's store has nothing but images."""
    STORE.mkdir(parents=True, exist_ok=True)
    with (STORE / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        engine = Podman(folder)
        engine.clear()
        make_image(engine)
        stack = Stack(engine)
        try:
            stack.compose("up", "--detach", "--no-build")
            yield stack
        finally:
            engine.clear()


pytestmark = [pytest.mark.timeout(5400), pytest.mark.skipif(bool(missing()), reason=missing())]

#: Where each container is killed: at this share of the job's chunks.
KILLED_AT = {"worker": 0.1, "scheduler": 0.3, "service": 0.6}
PATIENCE = 600.0

#: About 80 chunks of a core-second each.
SWEEP = spec_of((1.0, 6.0, 15_000), 0.5, 0.26, window=(25_000, 100, 16))


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    with stack_up(tmp_path_factory.mktemp("podman")) as stack:
        wait_for(lambda: stack.workers() == 2, stack.log, PATIENCE)
        yield stack


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
