"""The embedded service: startup errors, and clusters created by a user's function as with dask-jobqueue."""

import gc
import logging
import os
import resource
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import nullcontext
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from scripted import DEADLINE, Held

from service import address
from service.background import InThisProcess
from service.client import Client
from service.errors import DataFolderBusy, NotStarted
from service.render import answers
from service.server import embedded
from service.server.cluster import _tls
from service.server.web_server import MOST_FILES

MAKER = """
from distributed import LocalCluster

made = []


def two_processes():
    made.append(LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=":0"))
    return made[-1]


def looks_for_a_neighbour():
    import neighbour_of_mine  # in the current folder: not found, for the search there has ended


def no_cluster():
    raise RuntimeError("the queue is closed")
"""

SPEC = {
    "gamma": {"start": 1.0, "stop": 2.0, "num": 6},
    "omega": 0.5,
    "xi": 0.26,
    "model": {"kind": "rigid"},
    "settle": 5,
    "observe": 5,
}


@pytest.fixture
def maker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A user's module in the current folder."""
    (tmp_path / "queue_of_mine.py").write_text(MAKER)
    (tmp_path / "neighbour_of_mine.py").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "queue_of_mine", raising=False)
    return "queue_of_mine"


def test_the_cluster_of_a_function_computes_and_is_closed(tmp_path: Path, maker: str):
    settings = embedded.settings(
        host="127.0.0.1", port=0, data=tmp_path / "data", cluster=f"{maker}:two_processes"
    )
    with embedded.running(settings) as address, Client(address) as client:
        job = client.submit(SPEC).wait(progress=False)
        assert job.progress.cells_done == 6
        (cluster,) = sys.modules[maker].made
        assert {worker["nthreads"] for worker in cluster.scheduler_info["workers"].values()} == {1}
        assert cluster.scheduler.allowed_failures == 0  # whose fault a death was is judged by the service
    assert cluster.status.name == "closed"


@pytest.mark.parametrize(
    ("function", "why"),
    [
        ("no_cluster", "RuntimeError: the queue is closed"),
        ("missing", "no attribute 'missing'"),
        ("looks_for_a_neighbour", "No module named 'neighbour_of_mine'"),
    ],
)
def test_a_function_that_fails_gives_the_reason(tmp_path: Path, maker: str, function: str, why: str):
    settings = embedded.settings(host="127.0.0.1", port=0, data=tmp_path, cluster=f"{maker}:{function}")
    with pytest.raises(NotStarted, match=why), embedded.running(settings):
        pass


def test_the_current_folder_comes_after_the_libraries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A file there with the name of a library that is not imported yet is not imported."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "this", raising=False)
    (tmp_path / "this.py").write_text("raise RuntimeError('planted')")
    before = list(sys.path)
    settings = embedded.settings(host="127.0.0.1", port=0, data=tmp_path / "data", cluster="this:missing")
    with pytest.raises(NotStarted, match="no attribute 'missing'"), embedded.running(settings):
        pass
    assert sys.path == before


def test_two_clusters_are_refused(tmp_path: Path):
    with pytest.raises(NotStarted, match="only one of scheduler, scheduler_file and cluster"):
        embedded.settings(data=tmp_path, cluster="a:b", scheduler="tcp://127.0.0.1:8786")


def test_a_cluster_needs_module_and_function(tmp_path: Path):
    with pytest.raises(NotStarted, match="cluster"):
        embedded.settings(data=tmp_path, cluster="slurm")


def test_a_data_folder_or_port_in_use_is_a_startup_error(tmp_path: Path):
    with embedded.running(embedded.settings(data=tmp_path / "1", port=0), Held()) as url:
        port = int(url.rpartition(":")[2])
        same_folder = embedded.settings(data=tmp_path / "1", port=0)
        with pytest.raises(DataFolderBusy, match="another service"), embedded.running(same_folder, Held()):
            pass
        same_port = embedded.settings(data=tmp_path / "2", port=port)
        who = f"a bouncing-spring service \\(release .*, data in {tmp_path / '1'}\\) has it"
        with pytest.raises(NotStarted, match=who), embedded.running(same_port, Held()):
            pass


def test_a_port_of_another_program_is_a_startup_error(tmp_path: Path):
    class Other(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b"[" * 100_000)

        def log_message(self, *_: object) -> None: ...

    with HTTPServer(("127.0.0.1", 0), Other) as other, socket.create_server(("127.0.0.1", 0)) as silent:
        thread = threading.Thread(target=other.serve_forever, args=(0.01,))
        thread.start()
        try:
            for port, who in (
                (other.server_port, "another program has it"),
                (silent.getsockname()[1], "a program that does not answer has it"),
            ):
                settings = embedded.settings(data=tmp_path, port=port)
                with pytest.raises(NotStarted, match=who), embedded.running(settings, Held()):
                    pass
        finally:
            other.shutdown()
            thread.join()


def test_a_damaged_ledger_is_a_startup_error(tmp_path: Path):
    (tmp_path / "ledger.sqlite").write_bytes(b"not a ledger" * 1000)
    settings = embedded.settings(data=tmp_path, port=0)
    with pytest.raises(NotStarted, match="sqlite cannot be used"), embedded.running(settings, Held()):
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
            with embedded.running(embedded.settings(data=data, port=0, private=private), Held()):
                (data / "stores").mkdir(exist_ok=True)
            found = [path.stat().st_mode & 0o777 for path in (data, data / "stores", data / "ledger.sqlite")]
            assert tuple(found) == modes
    finally:
        os.umask(before)


def test_a_connection_with_certificates_is_encrypted():
    files = {f"scheduler_{name}": Path(f"{name}.pem") for name in ("ca", "cert", "key")}
    assert _tls(embedded.settings(**files)).require_encryption is True
    assert _tls(embedded.settings()) is None


@pytest.fixture
def process() -> Iterator[None]:
    """What a service changes in its process, as it was."""
    interval, files = sys.getswitchinterval(), resource.getrlimit(resource.RLIMIT_NOFILE)
    yield
    sys.setswitchinterval(interval)
    resource.setrlimit(resource.RLIMIT_NOFILE, files)
    gc.unfreeze()
    for logger in logging.root.manager.loggerDict.values():
        if isinstance(logger, logging.Logger):
            logger.disabled = False


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.usefixtures("process")
def test_a_service_runs_until_a_signal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
):
    counts, warmed, said = list[int](), threading.Event(), list[str]()
    files = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(1_000, files[1]), files[1]))
    handlers = [signal.getsignal(each) for each in (signal.SIGTERM, signal.SIGINT)]
    monkeypatch.setattr(embedded, "_computing", lambda *_: nullcontext(Held()))
    monkeypatch.setattr(embedded, "Processes", lambda count: counts.append(count) or InThisProcess())
    monkeypatch.setattr(answers, "warm", warmed.set)
    settings = embedded.settings(
        data=tmp_path, port=0, max_reads=3, max_exports=2, token="auto" if number is signal.SIGTERM else None
    )

    def announce(line: str) -> None:
        said.append(line)
        url = address.find(tmp_path)
        token = f", token in {tmp_path / 'token.json'}" if settings.makes_token else ""
        assert line == f"bounce listens on {url} (data in {tmp_path}, 2 worker processes{token})"
        os.umask(umask := os.umask(0))
        assert (umask, sys.getswitchinterval()) == (0o077, pytest.approx(0.001))
        assert resource.getrlimit(resource.RLIMIT_NOFILE)[0] == min(files[1], MOST_FILES)
        assert signal.getsignal(number) not in handlers
        assert warmed.wait(DEADLINE)
        os.kill(os.getpid(), number)

    ends = pytest.raises(KeyboardInterrupt) if number is signal.SIGINT else nullcontext()
    umask = os.umask(0o022)
    try:
        with ends:
            embedded.serve(settings, announce)
        assert os.umask(0o022) == 0o022
    finally:
        os.umask(umask)
    assert (len(said), counts) == (1, [5])
    assert address.find(tmp_path) is None
    assert [signal.getsignal(each) for each in (signal.SIGTERM, signal.SIGINT)] == handlers
    assert logging.getLogger("uvicorn.error").disabled  # nobody needs to know which connections end
    if number is signal.SIGTERM:
        assert gc.get_freeze_count() > 0  # the process ends at once


def test_a_service_says_with_which_cluster_it_computes(tmp_path: Path):
    for given, where in (
        ({"scheduler": "tcp://127.0.0.1:1"}, "cluster tcp://127.0.0.1:1"),
        ({"scheduler_file": tmp_path / "file"}, f"cluster {tmp_path / 'file'}"),
        ({"cluster": "module:make"}, "cluster module:make"),
        ({"workers": 7}, "7 worker processes"),
    ):
        assert embedded._summary(embedded.settings(data=tmp_path, **given)) == f"data in {tmp_path}, {where}"
