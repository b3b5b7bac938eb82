"""Another user of the machine: he runs no code in the service's processes, and reads nothing of its data.

Root alone can become another user, so the tests are skipped for others.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from dask_processes import listening
from distributed import LocalCluster
from paths import CACHE, ROOT, SUPPORT
from scripted import DEADLINE
from served import serving
from studies import spec_of

from service.client import Client

pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")

#: A user without rights: nobody.
OTHER = 65534

SWEEP = spec_of((1.0, 2.0, 20), 0.5, 0.26, window=(5, 5))


@pytest.fixture
def shared() -> Iterator[Path]:
    """A folder that every user can enter and write to, unlike pytest's own."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o1777)
        yield folder


def as_other_user(**task: Any) -> dict[str, list[Any]]:
    done = subprocess.run(
        [sys.executable, str(SUPPORT / "other_user.py"), str(OTHER)],
        input=json.dumps(task), capture_output=True, text=True, check=True, timeout=DEADLINE,
    )  # fmt: skip
    seen: dict[str, list[Any]] = json.loads(done.stdout)
    return seen


def test_another_user_runs_no_code_and_reads_no_data(shared: Path):
    """He tries the same with a plain Dask scheduler and with a file for all, and there he succeeds."""
    data, markers, temporary = shared / "data", shared / "markers", shared / "tmp"
    for folder, mode in ((data, 0o755), (markers, 0o777), (temporary, 0o1777)):
        folder.mkdir()
        folder.chmod(mode)
    # Where Dask would put its workers' files, he has been before.
    ours, trap = shared / "ours", temporary / "dask-scratch-space"
    ours.write_text("mine")
    trap.mkdir()
    (trap / "global.lock").symlink_to(ours)
    for path in (trap, trap / "global.lock"):
        os.chown(path, OTHER, OTHER, follow_symlinks=False)
    with (
        LocalCluster(n_workers=0, processes=False, protocol="tcp", dashboard_address="127.0.0.1:0") as plain,
        serving(shared, variables={"TMPDIR": str(temporary), "BOUNCE_WORKERS": "1"}, umask=0) as served,
    ):
        with Client(served.url) as client:
            client.submit(SWEEP).wait(progress=False)
        ports = {address.port for address in listening(psutil.Process(served.process.pid))}
        # The service; a scheduler, a nanny and a worker; two HTTP servers of theirs.
        assert len(ports) >= 6
        control = int(plain.scheduler_address.rpartition(":")[2])
        ours.chmod(0o644)
        files = [str(path) for path in data.rglob("*") if path.is_file()]
        assert any(file.endswith("ledger.sqlite-wal") for file in files)
        assert any(file.endswith("zarr.json") for file in files)
        seen = as_other_user(ports=sorted({*ports, control}), markers=str(markers), files=[*files, str(ours)])
        modes = {path: path.stat().st_mode & 0o077 for path in (data, *data.rglob("*"))}
    service = int(served.url.rpartition(":")[2])
    assert set(seen["ran"]) == {control}
    assert set(seen["answered"]) == {service}
    assert seen["read"] == [str(ours)]
    assert [str(path) for path, open_to_others in modes.items() if open_to_others] == []
    assert ours.read_text() == "mine"
    assert list(temporary.iterdir()) == [trap]  # what the service made is gone
    assert f"{data} was open to other users" in (shared / "log").read_text()


def test_a_data_folder_in_which_another_user_has_a_file_is_refused(shared: Path):
    data = shared / "data"
    data.mkdir()
    planted = data / "ledger.lock"
    planted.symlink_to(shared / "ours")
    data.chmod(0o777)
    os.chown(planted, OTHER, OTHER, follow_symlinks=False)
    (shared / "ours").write_text("mine")
    done = subprocess.run(
        [sys.executable, "-m", "service.cli.entry", "serve", "--port", "0", "--data", str(data)],
        capture_output=True, text=True, cwd=ROOT, check=False, timeout=DEADLINE,
        env=os.environ | {"NUMBA_CACHE_DIR": str(CACHE)},
    )  # fmt: skip
    assert done.returncode == 1
    assert f"{planted} belongs to another user" in done.stderr
    assert "BOUNCE_DATA" in done.stderr
    assert (shared / "ours").read_text() == "mine"
