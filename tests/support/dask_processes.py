"""A Dask scheduler and workers as processes of their own, started as an operator starts them."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx2
import psutil
from paths import CACHE, ROOT
from scripted import free_port, wait_for

from worker.executors.clusters import SCHEDULER_SETTINGS, environment_variable

LOOPBACK = ["--host", "127.0.0.1", "--no-dashboard", "--dashboard-address", "127.0.0.1:0"]


class Processes:
    """A scheduler at `address`, and workers; `end` ends them with all that they started."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._number = folder, 0
        self._variables = {"NUMBA_CACHE_DIR": str(CACHE), "PYTHONPATH": str(ROOT)}
        self.processes: list[subprocess.Popen[bytes]] = []
        port = str(free_port())
        self.address = f"tcp://127.0.0.1:{port}"
        settings = {environment_variable(name): str(value) for name, value in SCHEDULER_SETTINGS.items()}
        self.start(["dask", "scheduler", *LOOPBACK, "--port", port], settings)

    def worker(
        self, *options: str, variables: Mapping[str, str] | None = None, before: tuple[str, ...] = ()
    ) -> subprocess.Popen[bytes]:
        """Start a worker of one process and one thread; `before`: a command that starts it."""
        scratch = self._folder / f"dask-{self._number}"
        command = ["dask", "worker", self.address, *LOOPBACK, "--local-directory", str(scratch)]
        threads = () if "--nthreads" in options else ("--nthreads", "1")
        return self.start([*command, *threads, *options], variables or {}, before)

    def start(
        self, command: list[str], variables: Mapping[str, str] | None = None, before: tuple[str, ...] = ()
    ) -> subprocess.Popen[bytes]:
        """Start a command of this environment."""
        program = str(Path(sys.executable).with_name(command[0]))
        with (self._folder / f"process-{self._number}.log").open("wb") as log:
            process = subprocess.Popen(
                [*before, program, *command[1:]], stdout=log, stderr=log, cwd=self._folder,
                env=os.environ | self._variables | dict(variables or {}), start_new_session=True,
            )  # fmt: skip
        self._number += 1
        self.processes.append(process)
        return process

    def log(self) -> str:
        """The ends of all logs."""
        return "\n".join(text[-3000:] for text in self._logs())

    def has_logged(self, text: str) -> bool:
        """Whether any process has written this, however long ago."""
        return any(text in log for log in self._logs())

    def _logs(self) -> list[str]:
        return [file.read_text() for file in sorted(self._folder.glob("process-*.log"))]

    def end(self) -> None:
        for process in reversed(self.processes):
            for member in family(process):
                with suppress(psutil.NoSuchProcess):
                    member.kill()
            process.wait()


def family(process: "subprocess.Popen[bytes]") -> list[psutil.Process]:
    """A process and all that it started."""
    try:
        first = psutil.Process(process.pid)
        return [first, *first.children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


def listening(process: psutil.Process) -> list[Any]:
    """The addresses at which a process and what it has started listen."""
    found = []
    for each in (process, *process.children(recursive=True)):
        with suppress(psutil.NoSuchProcess):
            sockets = each.net_connections("inet")
            found += [socket.laddr for socket in sockets if socket.status == psutil.CONN_LISTEN]
    return found


@contextmanager
def dask_processes(folder: Path) -> Iterator[Processes]:
    folder.mkdir(exist_ok=True)
    processes = Processes(folder)
    try:
        wait_for((folder / "process-0.log").exists)
        yield processes
    finally:
        processes.end()


class Restarted:
    """A program of this environment that is restarted whenever it ends, until `end`."""

    def __init__(self, log: Path, variables: Mapping[str, str], *command: str) -> None:
        self._command, self._log, self._variables = command, log, variables
        self._over = threading.Event()
        self.process = self._start()
        self._thread = threading.Thread(target=self._keep)
        self._thread.start()

    def _start(self) -> "subprocess.Popen[bytes]":
        program = str(Path(sys.executable).with_name(self._command[0]))
        with self._log.open("ab") as log:
            return subprocess.Popen(
                [program, *self._command[1:]], stdout=log, stderr=log, env=os.environ | dict(self._variables)
            )

    def _keep(self) -> None:
        while not self._over.is_set():
            self.process.wait()
            if not self._over.wait(0.2):
                self.process = self._start()

    def end(self) -> None:
        """Stop it and all that it has started."""
        self._over.set()
        members = family(self.process)[1:]
        self.process.send_signal(signal.SIGCONT)
        self.process.terminate()
        self._thread.join(20)
        for process in psutil.wait_procs(members, timeout=10)[1]:
            process.kill()


class Cluster:
    """A Dask scheduler and two workers on loopback, each restarted whenever it ends."""

    def __init__(self, folder: Path, port: int, variables: Mapping[str, str] | None = None) -> None:
        self.address = f"tcp://127.0.0.1:{port}"
        settings = {environment_variable(name): f"{value:g}" for name, value in SCHEDULER_SETTINGS.items()}
        settings |= variables or {}
        self.scheduler = Restarted(
            folder / "scheduler.log", settings, "dask", "scheduler", *LOOPBACK, "--port", str(port)
        )
        self.workers = Restarted(
            folder / "worker.log", settings, "dask", "worker", self.address, *LOOPBACK, "--nworkers", "2",
            "--nthreads", "1", "--local-directory", str(folder / "dask"), "--death-timeout", "60",
        )  # fmt: skip

    def end(self) -> None:
        """Stop all of its processes."""
        self.workers.end()
        self.scheduler.end()


class Remote:
    """A service elsewhere, over HTTP."""

    def __init__(self, address: str, token: str = "") -> None:
        self.address, self.token = address, token

    def ask(self, path: str) -> httpx2.Response | None:
        """The service's answer; None while there is none."""
        headers = {"Authorization": f"Bearer {self.token}"} if self.token else {}
        try:
            return httpx2.get(f"http://{self.address}{path}", headers=headers, timeout=10)
        except httpx2.TransportError:
            return None

    def metrics(self, name: str) -> dict[str, int]:
        """The values of a metric by its labels'; none while the service does not answer."""
        answer = self.ask("/metrics")
        found = re.findall(rf"^{name}{{(.*)}} (\S+)$", answer.text, re.M) if answer else []
        return {" ".join(re.findall('"(.*?)"', labels)): int(float(value)) for labels, value in found}

    def workers(self) -> int:
        """The number of computing workers, a second later."""
        time.sleep(1.0)
        return self.metrics("bounce_workers").get("computing", 0)
