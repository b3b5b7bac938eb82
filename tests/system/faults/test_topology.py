"""The containers of docker-compose.yml as plain processes: same commands, same health checks, one job."""

import json
import os
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.request import urlopen

import psutil
import pytest
import yaml
from paths import ROOT
from scripted import free_port
from studies import spec_of

SERVICES: dict[str, dict] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"]

#: Seconds for a process to become healthy (longest: the service, whose workers may have to compile the
#: kernels first), and to end after SIGTERM.
PATIENCE = 240
FAREWELL = 120

#: Fig. 2 of the paper: flight times (rad) at these values of gamma; below threshold there are none.
GAMMA = [0.5, 1.5, 2.3, 3.6]
EXPECTED = [[], [4.855013427295], [3.722384327764, 6.284615845152], [11.246604305128]]


class Process:
    """A container's command as a process; `words` replaces what is true inside a container only."""

    def __init__(self, container: str, name: str, words: dict[str, str], folder: Path) -> None:
        self._container, self.name, self._words = SERVICES[container], name, words
        self._log = folder / f"{name}.log"
        with self._log.open("wb") as log:
            self.popen = subprocess.Popen(
                self._here(self._container["command"]),
                cwd=folder,
                env=os.environ | self._environment(),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    def _here(self, command: list[str]) -> list[str]:
        """The command for this machine; all words in one pass, so that none is replaced twice."""
        pattern = re.compile("|".join(map(re.escape, sorted(self._words, key=len, reverse=True))))
        program, *arguments = (pattern.sub(lambda match: self._words[match[0]], word) for word in command)
        return [str(Path(sys.executable).with_name(program)), *arguments]

    def _environment(self) -> dict[str, str]:
        """The container's variables, except those that its user provides."""
        variables = self._container.get("environment", {})
        return {name: value for name, value in variables.items() if not value.startswith("${")}

    def wait_until_healthy(self) -> None:
        """Run the container's own health check until it passes."""
        check = self._here(shlex.split(self._container["healthcheck"]["test"]))
        deadline = time.monotonic() + PATIENCE
        while subprocess.run(check, capture_output=True, check=False, timeout=PATIENCE).returncode != 0:
            assert self.popen.poll() is None, f"{self.name} ended\n{self.log()}"
            assert time.monotonic() < deadline, f"{self.name} did not become healthy\n{self.log()}"
            time.sleep(0.2)

    def log(self) -> str:
        return self._log.read_text()[-5000:]

    def end(self) -> int:
        """Stop it as `docker stop` does and return its exit code; ends all that it started."""
        if self.popen.poll() is not None:
            return self.popen.returncode
        family = psutil.Process(self.popen.pid).children(recursive=True)
        self.popen.terminate()
        try:
            return self.popen.wait(FAREWELL)
        finally:
            _, left = psutil.wait_procs(family, timeout=FAREWELL)
            for process in (*left, self.popen):
                process.kill()
            self.popen.wait()


class Topology:
    """Scheduler, workers and service, started in the order of the compose file's `depends_on`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._words = {
            "0.0.0.0": "127.0.0.1",
            "//scheduler:": "//127.0.0.1:",
            "/data": str(folder / "data"),
            "/tmp/dask": str(folder / "dask"),
            **{port: str(free_port()) for port in ("8000", "8786", "8787")},
        }
        self.url, self.dashboard = (f"http://127.0.0.1:{self._words[port]}" for port in ("8000", "8787"))
        self.processes: list[Process] = []

    def start(self) -> None:
        self._begin("scheduler", "scheduler").wait_until_healthy()
        replicas = SERVICES["worker"]["deploy"]["replicas"]
        rest = [self._begin("worker", f"worker-{n}") for n in range(replicas)]
        for process in (*rest, self._begin("service", "service")):
            process.wait_until_healthy()

    def _begin(self, container: str, name: str) -> Process:
        # Each container has its own port 8788; processes of one machine share theirs.
        process = Process(container, name, self._words | {"8788": str(free_port())}, self._folder)
        self.processes.append(process)
        return process

    def end(self) -> dict[str, int]:
        """Stop all, the service first; exit codes by process."""
        return {process.name: process.end() for process in reversed(self.processes)}


@pytest.fixture
def topology(tmp_path: Path) -> Iterator[Topology]:
    topology = Topology(tmp_path)
    try:
        topology.start()
        yield topology
    finally:
        topology.end()


@pytest.mark.timeout(1200)
def test_compose_topology_as_plain_processes_computes_a_job(topology: Topology):
    from service.client import Client

    sweep = spec_of(GAMMA, 0.5, 0.26, name="as deployed", window=(540, 12, 12))
    with Client(topology.url) as client:
        diagram = client.submit(sweep).wait(progress=False, timeout=PATIENCE).diagram()

    with urlopen(f"{topology.dashboard}/json/counts.json", timeout=PATIENCE) as answer:
        assert json.load(answer)["workers"] == 2  # by the scheduler's count
    for line, known in zip(diagram["flight_time"].values, EXPECTED, strict=True):
        flights = line[line > 0]
        nearest = [min(known, key=lambda expected: abs(expected - flight)) for flight in flights]
        assert set(nearest) == set(known)
        assert flights == pytest.approx(nearest, abs=1e-9)

    assert "start it with" not in topology.processes[-1].log()  # the scheduler has all required settings

    codes = topology.end()
    assert codes["service"] == 0, topology.processes[-1].log()
    assert all(process.popen.poll() is not None for process in topology.processes)
