"""The comparison of models on the workers of a service."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from click.testing import CliRunner
from paths import CACHE
from scripted import DEADLINE

from service.cli.main import main
from service.client import Client
from service.server.embedded import running
from service.settings import Settings
from worker.analysis import work_precision
from worker.analysis.work_precision import SETUPS
from worker.executors.dask import Dask

#: The setups that the advice needs; to measure them all takes a minute.
ADVISED = tuple(
    setup
    for setup in SETUPS
    if setup.model == "rigid" or (setup.purpose == "adhesive" and setup.model in ("soft", "ball"))
    or (setup.purpose, setup.scheme, setup.steps_per_contact) == ("adhesive", "verlet", 20)
)  # fmt: skip


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, cluster: Dask) -> Iterator[str]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(work_precision, "SETUPS", ADVISED)  # all of them take a minute
        with running(Settings(data=tmp_path_factory.mktemp("data"), port=0), cluster) as address:
            yield address


def test_workers_measure_once_for_all_requests(address: str, tmp_path: Path):
    with Client(address) as client:
        first, second = client.tradeoff(), client.tradeoff()
        assert first == second
        assert [row["model"] for row in first["rows"]] == [setup.model for setup in ADVISED]
        assert first["cells"] == 80
    done = CliRunner().invoke(main, ["tradeoff", "--url", address, "-o", str(tmp_path / "tradeoff.png")])
    assert done.exit_code == 0, done.output
    assert done.stderr.startswith("measuring")  # it may take a minute
    lines = done.stdout.splitlines()
    assert lines[0].startswith("Errors relative to the exact soft contact")
    assert lines[-1].startswith("Take rigid")
    assert (tmp_path / "tradeoff.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_no_folder_and_no_process(tmp_path: Path, number: signal.Signals):
    """The service of its own that `bounce tradeoff` computes with."""
    env = os.environ | {"TMPDIR": str(tmp_path), "NUMBA_CACHE_DIR": str(CACHE)}
    command = [sys.executable, "-m", "service.cli.main", "tradeoff", "--workers", "1"]
    with subprocess.Popen(
        command, env=env, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL,
        # Not ignored, as `nohup` has it for all that it starts.
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # noqa: PLW1509
    ) as process:  # fmt: skip
        assert process.stderr
        lines = iter(process.stderr.readline, b"")
        assert next(line for line in lines if line.startswith(b"measuring"))
        family = psutil.Process(process.pid).children(recursive=True)
        assert family
        assert any(tmp_path.iterdir())
        process.send_signal(number)
        assert process.wait(DEADLINE) == 128 + number
    assert list(tmp_path.iterdir()) == []
    assert psutil.wait_procs(family, DEADLINE)[1] == []
