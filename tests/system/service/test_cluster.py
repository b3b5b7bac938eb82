"""The embedded service: startup errors, and clusters created by a user's function as with dask-jobqueue."""

import os
import sys
from pathlib import Path

import pytest
from scripted import Held
from studies import spec_of

from service.client import Client
from service.errors import DataFolderBusy, NotStarted
from service.server import embedded
from service.settings import read_settings

MAKER = """
from distributed import LocalCluster

made = []


def two_processes():
    made.append(LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=":0"))
    return made[-1]
"""

SPEC = spec_of((1.0, 2.0, 6), 0.5, 0.26, window=(5, 5))


@pytest.fixture
def maker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A user's module in the current folder."""
    (tmp_path / "queue_of_mine.py").write_text(MAKER)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "queue_of_mine", raising=False)
    return "queue_of_mine"


def test_the_cluster_of_a_function_computes_and_is_closed(tmp_path: Path, maker: str):
    settings = read_settings(
        host="127.0.0.1", port=0, data=tmp_path / "data", cluster=f"{maker}:two_processes"
    )
    with embedded.running(settings) as address, Client(address) as client:
        job = client.submit(SPEC).wait(progress=False)
        assert job.progress.cells_done == 6
        (cluster,) = sys.modules[maker].made
        assert {worker["nthreads"] for worker in cluster.scheduler_info["workers"].values()} == {1}
        assert cluster.scheduler.allowed_failures == 0  # whose fault a death was is judged by the service
    assert cluster.status.name == "closed"


def test_the_current_folder_comes_after_the_libraries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A file there with the name of a library that is not imported yet is not imported."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "this", raising=False)
    (tmp_path / "this.py").write_text("raise RuntimeError('planted')")
    before = list(sys.path)
    settings = read_settings(host="127.0.0.1", port=0, data=tmp_path / "data", cluster="this:missing")
    with pytest.raises(NotStarted, match="no attribute 'missing'"), embedded.running(settings):
        pass
    assert sys.path == before


def test_a_data_folder_or_port_in_use_is_a_startup_error(tmp_path: Path):
    with embedded.running(read_settings(data=tmp_path / "1", port=0), Held()) as url:
        port = int(url.rpartition(":")[2])
        same_folder = read_settings(data=tmp_path / "1", port=0)
        with pytest.raises(DataFolderBusy, match="another service"), embedded.running(same_folder, Held()):
            pass
        same_port = read_settings(data=tmp_path / "2", port=port)
        with pytest.raises(NotStarted, match="another program has it"), embedded.running(same_port, Held()):
            pass


def starts_another() -> None:
    """A cluster that takes so long that another service is started on the folder meanwhile."""
    with embedded.running(read_settings(port=0), Held()):
        pass


def test_a_data_folder_is_in_use_before_the_cluster_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("BOUNCE_DATA", str(tmp_path))
    settings = read_settings(port=0, cluster=f"{__name__}:starts_another")
    with pytest.raises(NotStarted, match="another service"), embedded.running(settings):
        pass


@pytest.mark.parametrize(
    ("private", "modes"), [(True, (0o700, 0o700, 0o600)), (False, (0o755, 0o755, 0o644))]
)
def test_the_data_is_closed_to_others_unless_that_is_not_wanted(
    tmp_path: Path, private: bool, modes: tuple[int, ...]
):
    before, data = os.umask(0o022), tmp_path / "data"
    try:
        for _ in range(2):
            with embedded.running(read_settings(data=data, port=0, private=private), Held()):
                (data / "stores").mkdir(exist_ok=True)
            found = [path.stat().st_mode & 0o777 for path in (data, data / "stores", data / "ledger.sqlite")]
            assert tuple(found) == modes
    finally:
        os.umask(before)
