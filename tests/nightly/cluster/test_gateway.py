"""dask-gateway with its local backend: the files and commands of docs/deployment.md, on free ports.

    pip install dask-gateway "dask-gateway-server[local]"
    pytest -n 0 -s tests/nightly/cluster/test_gateway.py

`-s` shows workers and cells over time.
"""

import os
import re
import secrets
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import httpx2
import psutil
import pytest
from dask_processes import family
from documents import blocks
from paths import CACHE, ROOT
from scripted import costing, free_port, wait_for

from worker.kernel_cache import use_cache

PARTS = ("dask_gateway", "dask_gateway_server", "sqlalchemy")
pytestmark = [
    pytest.mark.timeout(1800),
    pytest.mark.skipif(
        not all(map(find_spec, PARTS)),
        reason='needs a gateway: pip install dask-gateway "dask-gateway-server[local]"',
    ),
]

GATEWAY = "127.0.0.1:8001"  # in the document
BINARIES = Path(sys.executable).parent
PATIENCE = 600.0


class Recipe:
    """The recipe of the document in a folder: its files, and its commands as processes."""

    process: "subprocess.Popen[bytes]"  # the gateway

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.gateway, self.service = (f"127.0.0.1:{free_port()}" for _ in range(2))
        self._environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith("BOUNCE_")},
            "PATH": f"{BINARIES}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": str(ROOT),
            "NUMBA_CACHE_DIR": str(CACHE),
            "GATEWAY_PASSWORD": secrets.token_urlsafe(),
            "BOUNCE_PORT": self.service.rpartition(":")[2],
        }
        self._recipe = blocks("docs/deployment.md")
        for name in ("dask_gateway_config.py", "local_gateway.py"):
            (code,) = (block.code for block in self._recipe if block.file == name)
            assert GATEWAY in code
            (folder / name).write_text(code.replace(GATEWAY, self.gateway))
        with (folder / "dask_gateway_config.py").open("a") as file:  # a gateway passes few variables on
            file.write(f'c.ClusterConfig.environment["NUMBA_CACHE_DIR"] = {str(CACHE)!r}\n')

    @contextmanager
    def started(self, program: str) -> Iterator[subprocess.Popen[bytes]]:
        """The command of the recipe that starts `program`, until the end of the block."""
        (code,) = (block.code for block in self._recipe if "dask-gateway-server -f" in block.code)
        (line,) = re.findall(rf"^{program} .*?(?= *&?$)", code, re.M)
        with (self.folder / f"{program}.log").open("wb") as log:
            process = subprocess.Popen(
                shlex.split(line), stdout=log, stderr=log, cwd=self.folder, env=self._environment
            )
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(60)
            finally:
                process.kill()

    def ask(self, path: str) -> httpx2.Response | None:
        """The service's answer; None while there is none."""
        try:
            return httpx2.get(f"http://{self.service}{path}", timeout=10)
        except httpx2.TransportError:
            return None

    def metrics(self, name: str) -> dict[str, float]:
        """The values of a metric by its labels."""
        answer = self.ask("/metrics")
        assert answer is not None
        return {
            label: float(value)
            for label, value in re.findall(rf"^{name}\{{(.*)\}} (\S+)$", answer.text, re.M)
        }

    def log(self) -> str:
        return "\n".join(file.read_text()[-3000:] for file in sorted(self.folder.glob("*.log")))


@pytest.fixture
def recipe(tmp_path: Path) -> Iterator[Recipe]:
    use_cache(CACHE)
    recipe = Recipe(tmp_path)
    with recipe.started("dask-gateway-server") as process:
        recipe.process = process

        def answers() -> bool:
            assert process.poll() is None, recipe.log()
            try:
                return httpx2.get(f"http://{recipe.gateway}/api/health", timeout=10).status_code == 200
            except httpx2.TransportError:
                return False

        wait_for(answers, recipe.log, PATIENCE)
        yield recipe


def listening(process: "subprocess.Popen[bytes]") -> set[str]:
    """The addresses at which a process and all that it started listen."""
    addresses = set()
    for each in family(process):
        with suppress(psutil.NoSuchProcess):
            for socket in each.net_connections(kind="inet"):
                if socket.status == psutil.CONN_LISTEN:
                    addresses.add(socket.laddr.ip)
    return addresses


def submit(recipe: Recipe, **sweep: Any) -> str:
    spec = costing(**sweep).as_submitted()
    answer = httpx2.post(f"http://{recipe.service}/v1/jobs", json=spec, timeout=30)
    return str(answer.raise_for_status().json()["id"])


def test_an_adaptive_cluster_of_a_gateway_computes_a_sweep(recipe: Recipe):
    began, most = time.monotonic(), 0.0
    addresses: set[str] = set()

    def job() -> dict[str, Any]:
        nonlocal most
        answer = recipe.ask(f"/v1/jobs/{name}")
        assert answer is not None, recipe.log()
        view: dict[str, Any] = answer.json()
        workers = recipe.metrics("bounce_workers")
        most = max(most, workers['state="computing"'])
        addresses.update(listening(service), listening(recipe.process))
        sys.stdout.write(
            f"{time.monotonic() - began:6.1f} s  workers {workers}  cells "
            f"{view['progress']['cells_done']}/{view['progress']['cells_total']}  {view['state']}\n"
        )
        time.sleep(1.0)
        return view

    with recipe.started("bounce") as service:
        wait_for(lambda: recipe.ask("/healthz") is not None or service.poll() is not None, seconds=PATIENCE)
        assert service.poll() is None, recipe.log()
        assert recipe.metrics("bounce_workers")['state="computing"'] == 0
        name = submit(recipe, chunks=40, seconds=0.5)
        wait_for(lambda: job()["state"] in ("done", "failed"), recipe.log, PATIENCE)
        ended = job()
        assert ended["state"] == "done", ended["error"]
        assert ended["progress"]["cells_done"] == ended["progress"]["cells_total"]
        assert 2 <= most <= 3
        assert addresses == {"127.0.0.1"}
        returned = recipe.metrics("bounce_chunks_returned_total")
        # On a slow machine a chunk may outlast its time slice, and goes on; none fails.
        assert all('action="continue"' in label for label in returned if returned[label]), returned
        wait_for(lambda: recipe.metrics("bounce_workers")['state="computing"'] == 0, recipe.log, PATIENCE)


def test_the_gateway_asks_for_the_password(recipe: Recipe):
    clusters = f"http://{recipe.gateway}/api/v1/clusters/"
    for password in ("", "a guess"):
        assert httpx2.get(clusters, auth=("somebody", password), timeout=10).status_code == 401
