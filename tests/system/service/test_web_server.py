"""The web server at the limits of the process, and the log of what others cause."""

import io
import logging
import re
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from itertools import count
from pathlib import Path
from typing import Any

import httpx2
import pytest
from scripted import DEADLINE, Held, free_port, sweep, wait_for
from served import computing_at, listening, service_at, settings_of

from service.api.app import create_app
from service.client import Client
from service.server.logging import log_to_stderr
from service.server.web_server import MOST_FILES, OTHER_FILES, connections_allowed, limited, raise_file_limit

MOST = 4


@pytest.fixture
def address(tmp_path: Path) -> Iterator[tuple[str, int]]:
    """A service that takes MOST connections at a time."""
    with listening(create_app(settings_of(tmp_path), Held()), limited(DEADLINE, MOST)) as address:
        yield address


def received(connection: socket.socket) -> bytes:
    """Everything until the service closes the connection."""
    return b"".join(iter(lambda: connection.recv(65536), b""))


def healthy(port: int) -> bool:
    try:
        return httpx2.get(f"http://127.0.0.1:{port}/healthz", timeout=DEADLINE).status_code == 200
    except httpx2.TransportError:
        return False


def test_more_connections_than_allowed_are_told_to_come_again(address: tuple[str, int]):
    with ExitStack() as held:
        for _ in range(MOST):
            last = held.enter_context(socket.create_connection(address, timeout=DEADLINE))
        with socket.create_connection(address, timeout=DEADLINE) as next_:
            answer = received(next_)
        assert answer.startswith(b"HTTP/1.1 503 ")
        assert b"retry-after: 2" in answer
        assert not healthy(address[1])
        last.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        assert received(last).startswith(b"HTTP/1.1 200 ")
    wait_for(lambda: healthy(address[1]))


def test_a_client_that_reads_slowly_gets_its_whole_answer():
    """It is not disconnected while it reads, although the answer takes longer than a client may pause."""
    part = b"x" * (1 << 20)

    async def app(scope: Any, receive: Any, send: Any) -> None:
        assert scope["type"] == "http"
        await send({"type": "http.response.start", "status": 200, "headers": [(b"connection", b"close")]})
        for more in [True] * 32 + [False]:
            await send({"type": "http.response.body", "body": part, "more_body": more})

    def arrives() -> bool:
        """Not if this process itself paused for longer than a client may, as on a busy machine."""
        got, paused, last = 0, 0.0, time.monotonic()
        with (
            listening(app, limited(DEADLINE, MOST, 1.0)) as address,
            socket.create_connection(address, timeout=DEADLINE) as connection,
        ):
            connection.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
            with suppress(ConnectionResetError):
                for number in count():
                    if not (received := connection.recv(1 << 18)):
                        break
                    got += received.count(part[:1])
                    time.sleep(0.05 if number < 40 else 0.0)
                    paused, last = max(paused, time.monotonic() - last), time.monotonic()
            paused = max(paused, time.monotonic() - last)
        assert got == 33 << 20 or paused > 0.5
        return got == 33 << 20

    wait_for(arrives)


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
    port = free_port()
    command = [sys.executable, "-c", IDLE, str(port), str(files)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as flood:
        assert flood.stdout.readline() == b"begins\n"
        resource.setrlimit(resource.RLIMIT_NOFILE, (files, before[1]))
        try:
            with computing_at(tmp_path, port=port) as url:
                assert flood.stdout.readline() == b"connected\n"
                flood.stdin.close()
                wait_for(lambda: healthy(port))  # once the others have left
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
    with service_at(tmp_path, Held(), host="::1") as url:
        assert url.startswith("http://[::1]:")
        answer = httpx2.get(f"{url}/healthz", timeout=DEADLINE)
        assert answer.status_code == 200
        assert "server" not in answer.headers


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


def test_a_terminal_has_lines_to_read(monkeypatch: pytest.MonkeyPatch):
    stream = io.StringIO()
    stream.isatty = lambda: True  # type: ignore[method-assign]
    monkeypatch.setattr(sys, "stderr", stream)
    with log_to_stderr("info"):
        logging.getLogger("service").warning("refused", extra={"fields": {"id": "1", "status": 404}})
    assert re.fullmatch(r"\d\d:\d\d:\d\d warning: refused \(status 404\)\n", stream.getvalue())
