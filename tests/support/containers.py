"""Containers on this machine: podman, the image of the Dockerfile, and docker-compose.yml as it is.

Needs root and Debian's packages:

    apt-get install podman runc podman-compose netavark aardvark-dns catatonit iptables mmdebstrap

No image is fetched: the Dockerfile's base is made of Debian's packages. Podman has a store of its own, STORE,
so no other image, container or network of the machine is touched. Images stay there between runs, and are
made anew once their sources have changed; everything else is removed at the end.
"""

import ast
import fcntl
import hashlib
import json
import os
import re
import secrets
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from configparser import RawConfigParser
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from paths import ROOT
from scripted import free_port

#: Each is in the package of that name.
PROGRAMS = (
    "podman", "runc", "podman-compose", "netavark", "aardvark-dns", "catatonit", "iptables", "mmdebstrap",
)  # fmt: skip

STORE = Path("/var/cache/bouncing-spring/containers")
#: What is valid until the machine restarts.
RUN = Path("/run/bouncing-spring/containers")

IMAGE = "bouncing-spring"
PROJECT = "bouncing-spring-test"
#: A label of the image: a digest of what it was made from.
SOURCES = "bouncing-spring.sources"

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
    absent = [name for name in PROGRAMS if shutil.which(name, path=_path()) is None]
    if absent:
        return f"needs {', '.join(absent)}: apt-get install {' '.join(PROGRAMS)}"
    return "" if os.geteuid() == 0 else "needs root"


def _path() -> str:
    return f"{os.environ['PATH']}:/usr/sbin:/usr/lib/podman:/usr/libexec/podman"


class Podman:
    """Podman with its own store; `variables` make its commands use it. The folder holds settings and logs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        names = {
            "store": STORE,
            "run": RUN,
            "init": shutil.which("catatonit", path=_path()),
            "limits": json.dumps(LIMITS),
        }
        (folder / "containers.conf").write_text(CONTAINERS_CONF.format(**names))
        (folder / "storage.conf").write_text(STORAGE_CONF.format(**names))
        self.variables = {
            "CONTAINERS_CONF": str(folder / "containers.conf"),
            "CONTAINERS_STORAGE_CONF": str(folder / "storage.conf"),
            "PATH": _path(),
        }
        if not Path("/run/systemd/system").exists():
            self.variables["DISABLE_HC_SYSTEMD"] = "true"  # otherwise no container with a health check starts

    def run(self, *command: str, seconds: float = COMMAND_SECONDS, **variables: str) -> str:
        """What a command prints. Raises if it fails."""
        done = self.attempt(*command, seconds=seconds, **variables)
        assert done.returncode == 0, f"{' '.join(command)}: {done.returncode}\n{done.stdout[-6000:]}"
        return done.stdout

    def attempt(
        self, *command: str, seconds: float = COMMAND_SECONDS, **variables: str
    ) -> subprocess.CompletedProcess[str]:
        """A command that may fail. Its output is a file: what it leaves running would hold a pipe open."""
        with (self.folder / "output").open("w+") as output:
            done = subprocess.run(
                command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, text=True,
                cwd=ROOT, env=os.environ | self.variables | variables, check=False, timeout=seconds,
            )  # fmt: skip
            output.seek(0)
            return subprocess.CompletedProcess(command, done.returncode, output.read(), "")

    def has(self, image: str) -> bool:
        return self.attempt("podman", "image", "exists", image).returncode == 0

    def inspect(self, container: str) -> dict[str, Any]:
        (found,) = json.loads(self.run("podman", "inspect", container))
        return dict(found)

    def clear(self) -> None:
        """Remove all containers, networks and volumes of the store."""
        self.run("podman", "rm", "--all", "--force", "--volumes", "--time", "0")
        self.run("podman", "pod", "rm", "--all", "--force")
        self.run("podman", "volume", "rm", "--all", "--force")
        self.run("podman", "network", "prune", "--force")


@contextmanager
def podman(folder: Path) -> Iterator[Podman]:
    """Podman for one test at a time, with nothing in its store but images, before and after."""
    STORE.mkdir(parents=True, exist_ok=True)
    with (STORE / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        engine = Podman(folder)
        engine.clear()
        try:
            yield engine
        finally:
            engine.clear()


# ---- The image


def make_image(engine: Podman) -> None:
    """Build the image from the Dockerfile, unless the store has it of the same sources."""
    sources = digest()
    label = engine.attempt(
        "podman", "image", "inspect", "--format", f'{{{{index .Labels "{SOURCES}"}}}}', IMAGE
    )
    if label.returncode == 0 and label.stdout.strip() == sources:
        return
    (base,) = re.findall(r"^FROM (\S+)$", (ROOT / "Dockerfile").read_text(), re.M)
    if not engine.has(f"localhost/{base}"):
        make_base(engine, base)
    engine.run(
        "podman", "build", "--pull=never", "--network=host",
        *(f"--ulimit={limit}" for limit in LIMITS), *reaching_the_index(engine.folder),
        f"--label={SOURCES}={sources}", f"--tag={IMAGE}", str(ROOT), seconds=BUILD_SECONDS,
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


def digest() -> str:
    """Of all files that the image is made from."""
    taken = [line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    files = [ROOT / "Dockerfile"]
    for name in taken:
        files += sorted((ROOT / name).rglob("*")) if (ROOT / name).is_dir() else [ROOT / name]
    found = hashlib.sha256()
    for file in files:
        if file.is_file() and file.suffix not in (".pyc", ".nbi", ".nbc"):
            found.update(
                f"{file.relative_to(ROOT)}\0{hashlib.sha256(file.read_bytes()).hexdigest()}\n".encode()
            )
    return found.hexdigest()


def reaching_the_index(folder: Path) -> list[str]:
    """Options of a build that let its pip find packages where the pip of this machine does."""
    listed = subprocess.run(
        [sys.executable, "-m", "pip", "config", "list"],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    ).stdout
    merged = RawConfigParser()
    paths: set[str] = set()
    for line in listed.splitlines():  # variables come first in it, and take precedence
        section, name, quoted = re.fullmatch(r"(:env:|[^.]+)\.([^=]+)=(.*)", line).groups()  # type: ignore[union-attr]
        section = "global" if section == ":env:" else section
        value = str(ast.literal_eval(quoted))
        if not merged.has_section(section):
            merged.add_section(section)
        if not merged.has_option(section, name):
            merged.set(section, name, value)
        for word in value.split():
            # An index in a folder links to files beside that folder.
            path = Path(word.removeprefix("file://"))
            if path.is_absolute() and path.exists():
                paths.add(str(path if word.startswith("/") else path.parent))
    with (folder / "pip.conf").open("w") as file:
        merged.write(file)
    volumes = {str(folder / "pip.conf"): "/etc/pip.conf"} | {path: path for path in sorted(paths)}
    return [f"--volume={source}:{target}:ro" for source, target in volumes.items()]


# ---- docker-compose.yml


class Stack:
    """The services of docker-compose.yml, with a project name, a port and a token of their own."""

    def __init__(self, engine: Podman) -> None:
        self.engine = engine
        self.address = f"127.0.0.1:{free_port()}"
        self.token = secrets.token_urlsafe()

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

    def execute(self, container: str, *command: str) -> subprocess.CompletedProcess[str]:
        return self.engine.attempt("podman", "exec", container, *command)

    def log(self) -> str:
        """The state of all containers, and the ends of their logs."""
        parts = [self.engine.attempt("podman", "ps", "--all").stdout]
        for name in self.containers():
            parts += [
                f"== {name}",
                self.engine.attempt("podman", "logs", "--tail", "25", name).stdout[-3000:],
            ]
        return "\n".join(parts)


@contextmanager
def stack_up(engine: Podman) -> Iterator[Stack]:
    """The stack until the end of the block."""
    stack = Stack(engine)
    stack.compose("up", "--detach", "--no-build")
    try:
        yield stack
    finally:
        stack.compose("down", "--volumes")
