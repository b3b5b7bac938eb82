"""Bad requests: the status and part of the message of each, after which the service still answers."""

import contextlib
import gzip
import json
import socket
import time
from collections.abc import Iterator
from typing import Any

import httpx2
import pytest
from fastapi.testclient import TestClient
from scripted import DEADLINE, Held, wait_for
from served import computing, finished, listening, service
from studies import spec_of

from service.api.app import create_app
from service.server.web_server import limited
from service.settings import Settings
from worker.executors.inline import Inline

MAX_BODY = 250_000

GOOD = spec_of((0.6, 1.4, 9), [0.5, 0.6], 0.26, window=(20, 20))


def changed(**fields: Any) -> bytes:
    return json.dumps(GOOD | fields).encode()


LONG = {"start": 1, "stop": 2, "num": 90_000}
MEDIA_TYPE = "Content-Type: application/json"
#: Body of POST /v1/jobs, status, and part of the message.
BODIES = {
    "nothing": (b"", 400, "the text is empty"),
    "deep nesting": (b"[" * 100_000 + b"]" * 100_000, 400, "nested too deeply"),
    "a list": (b"[1, 2]", 422, "must be a group of fields"),
    "an unknown field": (changed(gama=1.0), 422, "did you mean 'gamma'"),
    "too many cells": (changed(gamma=LONG, xi=list(range(99))), 413, "at most 1,000,000"),
    "too many bytes": (changed(gamma=LONG, keep=10_000), 413, "keep"),
    "a body too long": (b" " * (MAX_BODY + 1), 413, f"longer than {MAX_BODY:,} bytes"),
    "a form": (b"gamma=1", 415, MEDIA_TYPE),
    "no type": (changed(), 415, MEDIA_TYPE),
}
HEADERS = {"a form": {"Content-Type": "application/x-www-form-urlencoded"}, "no type": {}}

#: Method, path ({job} is a done job), status, and part of the message.
REQUESTS = {
    "nowhere": ("GET", "/v2/jobs", 404, "no endpoint /v2/jobs"),
    "a made-up method": ("BREW", "/v1/jobs", 405, "/v1/jobs does not support BREW"),
    "an unknown id": ("GET", "/v1/jobs/" + "0" * 32, 404, "no job has the id"),
    "an id that is a path": ("GET", "/v1/jobs/..%2F..%2Fledger.sqlite", 404, ""),
    "the start of an id": ("GET", "/v1/jobs/0000", 404, "an id is 32 hex digits"),
    "a parameter misspelt": ("GET", "/v1/jobs?stat=done", 422, "did you mean 'state'? the parameters are"),
    "an id that is not UTF-8": ("GET", "/v1/jobs/%ff%fe", 404, "no job has the id"),
    "cancelling what is done": ("POST", "{job}/cancel", 409, "the job is done"),
    "a limit without end": ("GET", "/v1/jobs?limit=" + "9" * 5000, 422, "limit"),
    "a fixed NaN": ("GET", "{job}/diagram?omega=nan", 422, "omega: must be finite, not nan"),
    "an unknown format": ("GET", "{job}/diagram?omega=0.5&format=gif", 422, "format: must be 'json'"),
    "a motion too long": ("GET", "{job}/trajectory?gamma=1&omega=0.5&periods=1000", 413, "200,001 samples"),
    "Eq. 25 at rest": ("GET", "/v1/threshold?omega=0&xi=0.1", 422, "omega: must be at least "),
    "almost no damping": ("GET", "/v1/threshold?omega=1&xi=1e-300", 422, "xi: must be 0 or at least 1e-30"),
    "a line feed behind a path": ("GET", "{job}/zarr/zarr.json%0a", 404, "zarr.json\\n'"),
}  # fmt: skip


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    limits = {"max_body_bytes": MAX_BODY, "max_cells": 1_000_000, "max_bytes": 2**32}
    with computing(tmp_path_factory.mktemp("data"), **limits) as client:
        yield client


@pytest.fixture(scope="module")
def job(client: TestClient) -> str:
    return finished(client, GOOD)


def check_refusal(answer: Any, status: int, message: str) -> None:
    assert (answer.status_code, answer.headers["Content-Type"]) == (status, "application/problem+json"), (
        answer.text
    )
    problem = answer.json()
    assert problem["status"] == status
    assert message in problem["detail"], problem
    for error in problem.get("errors", []):
        assert set(error) == {"field", "rule", "code"}


@pytest.mark.parametrize("name", BODIES)
def test_bad_body(client: TestClient, name: str):
    jobs = client.get("/v1/jobs").json()["total"]
    content, status, message = BODIES[name]
    headers = HEADERS.get(name, {"Content-Type": "application/json"})
    check_refusal(client.post("/v1/jobs", content=content, headers=headers), status, message)
    assert client.get("/v1/jobs?limit=1").status_code == 200
    assert client.get("/v1/jobs").json()["total"] == jobs


@pytest.mark.parametrize(("method", "path", "status", "message"), REQUESTS.values(), ids=REQUESTS)
def test_bad_request(client: TestClient, job: str, method: str, path: str, status: int, message: str):
    check_refusal(client.request(method, path.format(job=job)), status, message)
    assert client.get(job).json()["state"] == "done"


def test_a_full_queue_sends_retry_after(tmp_path: Any):
    with service(tmp_path, Held(), max_queue=1) as client:
        assert client.post("/v1/jobs", json={**GOOD, "xi": 0.3}).status_code == 202
        answer = client.post("/v1/jobs", json=GOOD)
        check_refusal(answer, 429, "at most 1 may be")
        assert int(answer.headers["Retry-After"]) > 0


def test_a_compressed_body_is_refused(client: TestClient):
    headers = {"Content-Type": "application/json", "Content-Encoding": "gzip"}
    answer = client.post("/v1/jobs", content=gzip.compress(json.dumps(GOOD).encode()), headers=headers)
    check_refusal(answer, 415, "the body is compressed (Content-Encoding: gzip)")


# Requests on a real connection, which a client may stop sending


HTTP = limited(DEADLINE, limit=1000)
#: Seconds for a head or a body, of those that never become complete.
SHORT = 0.5


@pytest.fixture
def address(tmp_path: Any, request: pytest.FixtureRequest) -> Iterator[tuple[str, int]]:
    """Its parameter: the seconds for a body."""
    executor = Inline()
    seconds = getattr(request, "param", DEADLINE)
    app = create_app(Settings(data=tmp_path, max_body_bytes=MAX_BODY, body_seconds=seconds), executor)
    with listening(app, HTTP) as address:
        yield address
    executor.close()


POST = b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"


def exchange(address: tuple[str, int], *pieces: bytes) -> bytes:
    """Everything that the service sends until it closes the connection."""
    with socket.create_connection(address, timeout=DEADLINE) as connection:
        connection.sendall(POST + b"".join(pieces))
        return b"".join(iter(lambda: connection.recv(65536), b""))


@pytest.mark.parametrize("address", [SHORT], indirect=True)
def test_a_stalled_body_times_out(address: tuple[str, int]):
    answer = exchange(address, b"Content-Length: 100\r\n\r\n", b'{"gamma": ')
    assert answer.startswith(b"HTTP/1.1 408 ")
    assert b"did not arrive within 0.5 s" in answer


def test_what_is_no_request_gets_a_problem_document_with_its_fault(address: tuple[str, int]):
    head, _, body = exchange(address, b"Content-Length: -1\r\n\r\n").partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 400 Bad Request\r\n")
    assert json.loads(body)["detail"].endswith("a short head: bad Content-Length")
    secret = exchange(address, b"Authorization : Bearer secret\r\n\r\n")
    assert (b"illegal header line" in secret, b"secret" in secret) == (True, False)


HEAD = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"


@pytest.mark.parametrize("before", [b"", HEAD + b"\r\n"], ids=["first", "next"])
@pytest.mark.parametrize("pieces", [[HEAD], [bytes([byte]) for byte in HEAD]], ids=["stalled", "dripping"])
def test_an_incomplete_head_times_out(
    address: tuple[str, int], before: bytes, pieces: list[bytes], monkeypatch: pytest.MonkeyPatch
):
    """On a new connection, and on one that has had a response."""
    if not before:
        monkeypatch.setattr(HTTP, "timeout", SHORT)
    with socket.create_connection(address, timeout=DEADLINE) as connection:
        if before:
            connection.sendall(before)
            while not (got := connection.recv(65536)).endswith(b"}"):
                assert got
            monkeypatch.setattr(HTTP, "timeout", SHORT)
        with contextlib.suppress(ConnectionError):  # closed while it dripped
            for piece in pieces:
                connection.sendall(piece)
                time.sleep(0.05)
            rest = b"".join(iter(lambda: connection.recv(65536), b""))
            assert rest.startswith(b"HTTP/1.1 408 ")
            assert b"application/problem+json" in rest


def test_a_connection_in_use_does_not_time_out(address: tuple[str, int], monkeypatch: pytest.MonkeyPatch):
    """The connection lasts longer than the timeout; retried, because a slow machine may pause for so long."""
    monkeypatch.setattr(HTTP, "timeout", SHORT)

    def connections() -> int:
        with httpx2.Client(base_url=f"http://127.0.0.1:{address[1]}", timeout=DEADLINE) as client:
            opened = set()
            for _ in range(8):
                answer = client.get("/healthz", headers={"Host": "localhost"})
                assert answer.status_code == 200
                opened.add(answer.extensions["network_stream"].get_extra_info("client_addr"))
                time.sleep(0.1)
            return len(opened)

    def is_one() -> bool:
        with contextlib.suppress(httpx2.TransportError):  # closed in a pause
            return connections() == 1
        return False

    wait_for(is_one)


def test_a_body_declared_too_long_is_refused_unread(address: tuple[str, int]):
    assert exchange(address, b"Content-Length: 99999999999\r\n\r\n").startswith(b"HTTP/1.1 413 ")


def test_a_client_that_disconnects_within_its_body_is_no_defect(address: tuple[str, int], caplog):
    caplog.set_level("INFO", "service.requests")
    with socket.create_connection(address, timeout=DEADLINE) as connection:
        connection.sendall(POST + b"Content-Length: 100\r\n\r\n{")
    wait_for(lambda: [vars(record)["fields"]["status"] for record in caplog.records] == [499])
