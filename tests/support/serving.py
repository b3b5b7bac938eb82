"""`bounce serve` as a process of its own."""

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx2
import psutil
from paths import CACHE, ROOT
from scripted import DEADLINE, free_port, wait_for


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
