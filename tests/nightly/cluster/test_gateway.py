"""dask-gateway with its local backend: the files and commands of docs/deployment.md, on free ports.

pip install dask-gateway "dask-gateway-server[local]"
pytest -n 0 tests/nightly/cluster/test_gateway.py
"""

import os
import re
import secrets
import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

import httpx2
import psutil
import pytest
from dask_processes import Remote, listening
from documents import blocks
from paths import CACHE, ROOT
from scripted import costing, free_port, wait_for

from service.client import Client
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
PATIENCE = 600.0


class Recipe(Remote):
    """The recipe of the document in a folder: its files, and its commands as processes."""

    def __init__(self, folder: Path) -> None:
        super().__init__(f"127.0.0.1:{free_port()}")
        self.folder, self.gateway = folder, f"127.0.0.1:{free_port()}"
        self._environment = os.environ | {
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": str(ROOT),
            "GATEWAY_PASSWORD": secrets.token_urlsafe(),
            "BOUNCE_PORT": self.address.rpartition(":")[2],
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

    def log(self) -> str:
        return "\n".join(file.read_text()[-3000:] for file in sorted(self.folder.glob("*.log")))


@pytest.fixture
def recipe(tmp_path: Path) -> Iterator[Recipe]:
    use_cache()
    recipe = Recipe(tmp_path)
    with recipe.started("dask-gateway-server"):

        def answers() -> bool:
            with suppress(httpx2.TransportError):
                return httpx2.get(f"http://{recipe.gateway}/api/health", timeout=10).status_code == 200
            return False

        wait_for(answers, recipe.log, PATIENCE)
        yield recipe


def test_an_adaptive_cluster_of_a_gateway_computes_a_sweep(recipe: Recipe):
    most, addresses = 0, set[str]()

    def ended() -> bool:
        nonlocal most
        most = max(most, recipe.workers())
        addresses.update(address.ip for address in listening(psutil.Process()))
        return job.refresh().finished

    with recipe.started("bounce"):
        wait_for(lambda: recipe.ask("/healthz") is not None, recipe.log, PATIENCE)
        assert recipe.workers() == 0
        with Client(f"http://{recipe.address}") as client:
            job = client.submit(costing(chunks=40, seconds=0.5))
            wait_for(ended, recipe.log, PATIENCE)
            assert job.state == "done", job.error
        assert 2 <= most <= 3
        assert addresses == {"127.0.0.1"}
        returned = recipe.metrics("bounce_chunks_returned_total")
        # On a slow machine a chunk may outlast its time slice, and goes on; none fails.
        assert all(labels.startswith("continue") for labels, count in returned.items() if count), returned
        wait_for(lambda: recipe.workers() == 0, recipe.log, PATIENCE)
