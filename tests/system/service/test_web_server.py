"""The web server at the limits of the process, and the log of what others cause."""

import io
import json
import logging
import resource
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import httpx2
import pytest
import uvicorn
from scripted import DEADLINE, Held, free_port, sweep, wait_for
from served import listening

from service.api.app import create_app
from service.background import InThisProcess
from service.client import Client
from service.errors import DataFolderBusy
from service.jobs.ledger import Ledger
from service.render import answers
from service.server import embedded
from service.server.logging import JsonLines, OncePerSecond
from service.server.web_server import (
    ACCEPTED_AT_A_TIME,
    MOST_FILES,
    OTHER_FILES,
    WebServer,
    connections_allowed,
    limited,
    raise_file_limit,
)
from service.settings import Settings
from worker.executors.inline import Inline

MOST = 4


@pytest.fixture
def address(tmp_path: Path) -> Iterator[tuple[str, int]]:
    """A service that takes MOST connections at a time."""
    app = create_app(Settings(data=tmp_path), Held())
    http = limited(DEADLINE, MOST)
    with listening(app, http) as address:
        yield address


def received(connection: socket.socket) -> bytes:
    """Everything until the service closes the connection."""
    return b"".join(iter(lambda: connection.recv(65536), b""))


def test_more_connections_than_allowed_are_told_to_come_again(address: tuple[str, int]):
    def healthy() -> bool:
        try:
            return httpx2.get(f"http://127.0.0.1:{address[1]}/healthz").status_code == 200
        except httpx2.TransportError:
            return False

    with ExitStack() as held:
        for _ in range(MOST):
            last = held.enter_context(socket.create_connection(address, timeout=DEADLINE))
        with socket.create_connection(address, timeout=DEADLINE) as next_:
            answer = received(next_)
        assert answer.startswith(b"HTTP/1.1 503 ")
        assert b"Retry-After: 2" in answer
        assert not healthy()
        last.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        assert received(last).startswith(b"HTTP/1.1 200 ")
    wait_for(healthy)


#: Opens connections as soon as there is somebody to listen, and holds them.
IDLE = """
import contextlib, resource, socket, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (resource.getrlimit(resource.RLIMIT_NOFILE)[1],) * 2)
idle = []
print("begins", flush=True)
while len(idle) < int(sys.argv[2]):
    with contextlib.suppress(ConnectionRefusedError):
        idle.append(socket.create_connection(("127.0.0.1", int(sys.argv[1]))))
print("connected", flush=True)
sys.stdin.read()
"""


def test_more_connections_than_files_leave_some_for_jobs(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    """They wait to be accepted when the service starts, and are refused a few at a time."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    files = len(list(Path("/proc/self/fd").iterdir())) + 300
    settings = Settings(data=tmp_path, port=free_port())
    command = [sys.executable, "-c", IDLE, str(settings.port), str(files)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as flood:
        assert flood.stdin is not None
        assert flood.stdout is not None
        assert flood.stdout.readline() == b"begins\n"
        resource.setrlimit(resource.RLIMIT_NOFILE, (files, before[1]))
        try:
            with closing(Inline()) as executor, embedded.running(settings, executor) as url:
                assert flood.stdout.readline() == b"connected\n"
                flood.stdin.close()
                with Client(url) as client:
                    assert client.submit(sweep("after it")).wait(progress=False).state == "done"
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, before)
    assert "out of system resource" not in caplog.text


def test_an_answer_to_head_ends_after_its_headers(address: tuple[str, int]):
    """The next one follows on the same connection."""
    request = "HEAD /docs HTTP/1.1\r\nHost: localhost\r\n"
    with socket.create_connection(address, timeout=DEADLINE) as connection:
        connection.sendall(f"{request}\r\n{request}Connection: close\r\n\r\n".encode())
        answers = received(connection)
    assert answers.count(b"HTTP/1.1 200 OK\r\n") == 2
    assert answers.endswith(b"\r\n\r\n")
    assert b"<html" not in answers


def test_the_service_listens_on_ipv6(tmp_path: Path):
    if not socket.has_dualstack_ipv6():
        pytest.skip("needs IPv6")
    with embedded.running(Settings(data=tmp_path, host="::1", port=0), Held()) as url:
        assert url.startswith("http://[::1]:")
        answer = httpx2.get(f"{url}/healthz")
        assert answer.status_code == 200
        assert "server" not in answer.headers


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener


def test_its_start_and_its_end_are_told(tmp_path: Path, listener: socket.socket):
    settings, told = Settings(data=tmp_path), list[str]()
    app = create_app(settings, Held())
    server = WebServer(app, settings, listener, told.append, lambda: told.append("ends"))
    thread = threading.Thread(target=server.serve_until_stopped)
    thread.start()
    url = server.wait_until_started()
    assert told == [url] == [f"http://127.0.0.1:{listener.getsockname()[1]}"]
    server.should_exit = True
    thread.join()
    assert told == [url, "ends"]


def test_more_connections_than_are_accepted_at_a_time_wait(tmp_path: Path):
    """While the service does something else: here, while it tells its start."""
    settings, connected = Settings(data=tmp_path), list[socket.socket]()
    with ExitStack() as held:
        listener = held.enter_context(socket.create_server(("127.0.0.1", 0), backlog=1))

        def connect(_: str) -> None:
            with suppress(TimeoutError):
                for _ in range(4 * ACCEPTED_AT_A_TIME):
                    connection = socket.create_connection(listener.getsockname(), timeout=5.0)
                    connected.append(held.enter_context(connection))

        server = WebServer(create_app(settings, Held()), settings, listener, connect)
        thread = threading.Thread(target=server.serve_until_stopped)
        thread.start()
        server.wait_until_started()
        server.should_exit = True
        thread.join()
    assert len(connected) == 4 * ACCEPTED_AT_A_TIME


def test_a_service_whose_data_folder_is_taken_while_it_starts_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    settings, told = Settings(data=tmp_path, port=0), list[str]()

    @contextmanager
    def computing(*_: object) -> Iterator[Held]:
        with Ledger(settings.ledger_path):
            yield Held()

    monkeypatch.setattr(embedded, "_computing", computing)
    monkeypatch.setattr(embedded, "Processes", lambda _: InThisProcess())
    monkeypatch.setattr(answers, "warm", lambda: None)
    interval = sys.getswitchinterval()
    try:
        with pytest.raises(DataFolderBusy):
            embedded.serve(settings, told.append)
    finally:
        sys.setswitchinterval(interval)
    assert told == []


def test_an_error_of_the_startup_is_raised_where_it_is_waited_for(tmp_path: Path, listener: socket.socket):
    settings = Settings(data=tmp_path)
    with Ledger(settings.ledger_path):
        server = WebServer(create_app(settings, Held()), settings, listener)
        thread = threading.Thread(target=server.serve_until_stopped)
        thread.start()
        with pytest.raises(DataFolderBusy):
            server.wait_until_started()
        thread.join()


def test_small_answers_are_sent_at_once(tmp_path: Path):
    """Connections inherit it from the socket that listens."""
    with embedded._listening(Settings(data=tmp_path, port=0)) as (listener, _):
        assert listener.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


@dataclass
class Timer:
    seconds: float
    run: Callable[[], object]
    cancelled: bool = False

    def cancel(self) -> None:
        self.cancelled = True


class Connection:
    """The loop and the transport of one connection, of which a test lets time go by."""

    def __init__(self) -> None:
        self.timers: list[Timer] = []
        self.unsent, self.written, self.ended = 0, b"", ""

    def waiting(self) -> list[float]:
        return [timer.seconds for timer in self.timers if not timer.cancelled]

    def go_on(self) -> None:
        """Run the timer that is left."""
        [timer] = [timer for timer in self.timers if not timer.cancelled]
        self.timers.clear()
        timer.run()

    def call_later(self, seconds: float, function: Callable[..., object], *arguments: object) -> Timer:
        self.timers.append(Timer(seconds, partial(function, *arguments)))
        return self.timers[-1]

    def create_task(self, request: Any, **_: Any) -> Future[None]:
        request.close()
        return Future()

    def get_extra_info(self, name: str) -> None: ...

    def pause_reading(self) -> None: ...

    def get_write_buffer_size(self) -> int:
        return self.unsent

    def write(self, data: bytes) -> None:
        self.written += data

    def close(self) -> None:
        self.ended = "closed"

    def abort(self) -> None:
        self.ended = "aborted"

    def is_closing(self) -> bool:
        return bool(self.ended)


@pytest.fixture
def connection() -> Connection:
    return Connection()


@pytest.fixture
def protocol(connection: Connection) -> Any:
    """Ten seconds for the head of a request, and a client may pause its reading for sixty."""
    config = uvicorn.Config(lambda *_: None, log_config=None, lifespan="off")
    protocol: Any = limited(10, 1, 60)(config, uvicorn.server.ServerState(), {}, _loop=connection)  # type: ignore[arg-type]
    protocol.connection_made(connection)
    return protocol


def test_the_head_of_a_request_has_its_time(protocol: Any, connection: Connection):
    assert connection.waiting() == [10]
    protocol.data_received(b"GET / HTTP/1.1\r\nHost: localhost\r\n")
    assert connection.waiting() == [10]  # the time goes on
    protocol.data_received(b"\r\n")
    assert connection.waiting() == []  # an answer may take longer
    protocol.cycle.response_complete = True
    protocol.data_received(b"GET")
    assert connection.waiting() == [10]
    connection.go_on()
    assert connection.written.startswith(b"HTTP/1.1 408 ")
    assert (connection.ended, connection.waiting()) == ("closed", [])


@pytest.mark.parametrize("ended", ["", "closed"])
def test_a_connection_that_has_ended_has_no_time_left(protocol: Any, connection: Connection, ended: str):
    connection.ended = ended
    if ended:
        connection.go_on()
        assert connection.written == b""
    protocol.connection_lost(None)
    assert connection.waiting() == []


def test_a_client_that_reads_is_not_disconnected_however_slow_it_is(protocol: Any, connection: Connection):
    protocol.connection_lost(None)
    connection.ended = ""
    for unsent in (1, 5, 3):
        connection.unsent = unsent
        protocol.pause_writing() if unsent == 1 else connection.go_on()
        assert (connection.waiting(), connection.ended) == ([60], "")
        assert protocol.flow.write_paused
    protocol.resume_writing()
    assert connection.waiting() == []
    assert not protocol.flow.write_paused
    protocol.pause_writing()
    connection.go_on()
    assert (connection.ended, connection.waiting()) == ("aborted", [])
    connection.unsent += 1
    protocol.pause_writing()
    protocol.connection_lost(None)
    assert connection.waiting() == []


@pytest.mark.parametrize("path", ["/healthz", "/v1/nothing"])
def test_a_request_with_two_ends_is_the_last_of_its_connection(address: tuple[str, int], path: str):
    """RFC 9112, section 6.1: what follows it may be part of it for a server in between."""
    first = (
        f"GET {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n"
    )
    smuggled = "GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"
    with socket.create_connection(address, timeout=DEADLINE) as connection:
        connection.sendall(f"{first}0\r\n\r\n{smuggled}".encode())
        answer = received(connection)
    assert answer.count(b"HTTP/1.1 ") == 1
    assert answer.startswith(b"HTTP/1.1 200 " if path == "/healthz" else b"HTTP/1.1 404 ")
    assert b"connection: close" in answer.lower()


def test_the_process_may_open_as_many_files_as_the_system_allows():
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    allowed = MOST_FILES if before[1] == resource.RLIM_INFINITY else min(before[1], MOST_FILES)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (allowed // 2, before[1]))
        raise_file_limit()
        assert resource.getrlimit(resource.RLIMIT_NOFILE) == (allowed, before[1])
        for files, connections in ((400, 200), (OTHER_FILES * 4, OTHER_FILES * 3)):
            resource.setrlimit(resource.RLIMIT_NOFILE, (files, before[1]))
            assert connections_allowed() == connections
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest.mark.parametrize(
    ("limits", "raised", "connections"),
    [
        ((1_024, 4_096), (4_096, 4_096), 1_024 - OTHER_FILES),
        ((1_024, resource.RLIM_INFINITY), (MOST_FILES, resource.RLIM_INFINITY), 1_024 - OTHER_FILES),
        ((MOST_FILES + 1, MOST_FILES + 9), None, MOST_FILES - OTHER_FILES),
        ((resource.RLIM_INFINITY, resource.RLIM_INFINITY), None, MOST_FILES - OTHER_FILES),
    ],
)
def test_a_limit_of_files_is_raised_and_never_lowered(
    limits: tuple[int, int],
    raised: tuple[int, int] | None,
    connections: int,
    monkeypatch: pytest.MonkeyPatch,
):
    """Of limits that this process cannot have, or not give back."""
    changed: list[tuple[int, int]] = []
    monkeypatch.setattr(resource, "getrlimit", lambda _: limits)
    monkeypatch.setattr(resource, "setrlimit", lambda _, limit: changed.append(limit))
    raise_file_limit()
    assert changed == ([] if raised is None else [raised])
    assert connections_allowed() == connections


def test_a_message_of_a_library_is_logged_once_a_second(monkeypatch: pytest.MonkeyPatch):
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    handler.setFormatter(JsonLines())
    handler.addFilter(OncePerSecond())

    def log(name: str, message: str, *given: object) -> None:
        handler.handle(logging.LogRecord(name, logging.ERROR, "", 0, message, given, None))

    for port in range(1000):
        log("distributed.comm.tcp", "handshake failed with %r", port)
        log("asyncio", f"socket.accept() out of system resource\nsocket: {port}")
    log("service", "always")
    log("service", "always")
    now += 1.0
    log("asyncio", "socket.accept() out of system resource\nsocket: 1000")
    lines = [json.loads(line) for line in stream.getvalue().splitlines()]
    assert [(line["logger"], line.get("left_out")) for line in lines] == [
        ("distributed.comm.tcp", None),
        ("asyncio", None),
        ("service", None),
        ("service", None),
        ("asyncio", 999),
    ]


def test_the_messages_that_are_remembered_are_limited():
    """Whoever causes ever new ones would else take all memory."""
    once = OncePerSecond()
    for number in range(3_000):
        record = logging.LogRecord("asyncio", logging.ERROR, "", 0, f"message {number}", (), None)
        assert once.filter(record)
        assert not once.filter(record)
    assert max(len(once._last), len(once._left_out)) <= 1_001
