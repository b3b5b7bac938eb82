"""A Dask scheduler and workers as processes of their own, started as an operator starts them."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import psutil
from paths import CACHE, ROOT
from scripted import free_port, wait_for

from worker.executors.connection import SCHEDULER_SETTINGS, environment_variable

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
                [*before, program, *command[1:]],
                stdout=log,
                stderr=log,
                env=os.environ | self._variables | dict(variables or {}),
                cwd=self._folder,
                start_new_session=True,
            )
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
            for each in family(process):
                try:
                    each.kill()
                except psutil.NoSuchProcess:
                    continue
            process.wait()


def with_another_kernel(folder: Path) -> Path:
    """A new folder with a copy of this project whose kernel has another line: a PYTHONPATH."""
    for package in ("kernel", "worker"):
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    with (folder / "kernel" / "modes.py").open("a") as file:
        file.write("\n# another kernel\n")
    return folder


def family(process: "subprocess.Popen[bytes]") -> list[psutil.Process]:
    """A process and all that it started."""
    try:
        first = psutil.Process(process.pid)
        return [first, *first.children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


@contextmanager
def dask_processes(folder: Path) -> Iterator[Processes]:
    folder.mkdir(exist_ok=True)
    processes = Processes(folder)
    try:
        wait_for((folder / "process-0.log").exists)
        yield processes
    finally:
        processes.end()
