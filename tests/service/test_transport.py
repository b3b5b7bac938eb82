"""The client against a scripted HTTP server: what it sends, when, and what it makes of the answers."""

import io
import json
import os
import pickle
import socket
import sys
import threading
import time
import traceback
from base64 import b64encode
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from scripted import DEADLINE, wait_for

from service.client import (
    BounceError,
    Busy,
    Client,
    NotComputedYet,
    NotFound,
    Refused,
    ServiceError,
    ServiceUnreachable,
    StoreUnreachable,
    TooLarge,
    Unauthorized,
    UnexpectedAnswer,
)
from service.client.display import display_parts

ID = "0123456789abcdef" * 2
LOST = None  # the connection is closed instead of an answer


def view(state: str = "running", done: int = 0) -> dict[str, Any]:
    progress = {
        "chunks_done": 0,
        "chunks_total": 1,
        "cells_done": done,
        "cells_total": 10,
        "percent": 10.0 * done,
    }
    return {"id": ID, "name": "", "state": state, "progress": progress | {"eta_seconds": None}, "error": None}


class Answer:
    """One answer, as written in a script."""

    def __init__(self, status: int = 200, body: Any = None, **headers: str) -> None:
        self.status, self.headers = status, {name.replace("_", "-"): value for name, value in headers.items()}
        self.body = (
            body if isinstance(body, bytes) else json.dumps(body).encode() if body is not None else b""
        )


class Server(HTTPServer):
    """Gives the answers of a script one by one, and records the requests."""

    script: list[Answer | None]
    requests: list[tuple[str, str, dict[str, str]]]
    when: list[float]


class Handler(BaseHTTPRequestHandler):
    server: Server

    def answer(self) -> None:
        self.rfile.read(int(self.headers.get("Content-Length", 0)))
        self.server.requests.append((self.command, self.path, dict(self.headers)))
        self.server.when.append(time.monotonic())
        answer = self.server.script.pop(0)
        if answer is LOST:
            self.connection.shutdown(socket.SHUT_RDWR)
            return
        self.send_response(answer.status)
        for name, value in answer.headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(answer.body)

    do_GET = do_POST = do_DELETE = answer  # noqa: N815 - the names http.server looks for

    def log_message(self, *_: object) -> None: ...


@contextmanager
def scripted(*script: Answer | None) -> Iterator[tuple[Server, Client]]:
    """A server that gives these answers, all of which must be used at the end, and a client."""
    with Server(("127.0.0.1", 0), Handler) as server:
        server.script, server.requests, server.when = list(script), [], []
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            with Client(f"http://127.0.0.1:{server.server_port}/") as client:
                yield server, client
        finally:
            server.shutdown()
            thread.join()
        assert server.script == []


@pytest.fixture
def unused_address() -> Iterator[str]:
    """An address at which nobody listens, for as long as the test takes."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        yield f"http://127.0.0.1:{taken.getsockname()[1]}"


# Connecting


def test_an_unreachable_service_is_reported_with_what_to_do(unused_address: str):
    with Client(unused_address) as client, pytest.raises(ServiceUnreachable, match="bounce serve") as caught:
        client.job(ID)
    assert unused_address in str(caught.value)
    assert caught.value.url == unused_address


@pytest.mark.parametrize("url", ["", "localhost:8000", "ftp://localhost", "http://", "http://[::1", "/v1"])
def test_an_invalid_address_is_refused(url: str):
    with pytest.raises(ServiceUnreachable):
        Client(url)


def test_a_lost_connection_is_retried():
    with scripted(LOST, LOST, Answer(body=view())) as (server, client):
        assert client.job(ID).state == "running"
        assert [path for _, path, _ in server.requests] == [f"/v1/jobs/{ID}"] * 3


def test_retries_end():
    with scripted(LOST, LOST, LOST) as (_, client), pytest.raises(ServiceUnreachable):
        client.job(ID)


def test_submitting_may_be_repeated_since_the_same_sweep_is_the_same_job():
    with scripted(LOST, Answer(202, view("queued"))) as (server, client):
        assert client.submit({"xi": 1}).id == ID
        assert [method for method, _, _ in server.requests] == ["POST", "POST"]


@pytest.mark.parametrize("call", ["cancel", "resume", "refine"])
def test_what_is_done_to_a_job_may_be_repeated(call: str):
    with scripted(Answer(body=view()), LOST, Answer(202, view())) as (server, client):
        getattr(client.job(ID), call)()
        assert [method for method, _, _ in server.requests] == ["GET", "POST", "POST"]


def test_a_deletion_is_not_repeated():
    """Of two, the second would tell of no such job."""
    with scripted(Answer(body=view()), LOST) as (_, client), pytest.raises(ServiceUnreachable):
        client.job(ID).delete()


def test_a_silent_service_is_unreachable():
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"http://127.0.0.1:{silent.getsockname()[1]}"
        with Client(url, timeout=0.2) as client, pytest.raises(ServiceUnreachable, match="in time"):
            client.job(ID)


def test_no_proxy_is_used_for_loopback(monkeypatch: pytest.MonkeyPatch, unused_address: str):
    for name in ("HTTP_PROXY", "http_proxy", "ALL_PROXY", "all_proxy"):
        monkeypatch.setenv(name, unused_address)
    for name in ("NO_PROXY", "no_proxy"):
        monkeypatch.delenv(name, raising=False)
    with scripted(Answer(body=view())) as (_, client):
        assert client.job(ID).id == ID


def test_the_token_goes_with_every_call():
    with scripted(Answer(body=view())) as (server, client), Client(client.url, token="s3cret") as known:
        known.job(ID)
        assert server.requests[0][2]["Authorization"] == "Bearer s3cret"
        assert "s3cret" not in repr(known)


@pytest.mark.parametrize("word", ["schlüssel", "two words", "two\nlines"])
def test_what_a_header_cannot_carry_is_refused_and_not_repeated(word: str):
    with pytest.raises(BounceError, match="the token must consist of ASCII") as caught:
        Client("http://127.0.0.1:1", token=word)
    assert word not in str(caught.value)
    with Client("http://127.0.0.1:1") as client, pytest.raises(BounceError, match="an idempotency key must"):
        client.submit({"gamma": 1.5, "omega": 0.5, "xi": 0.26}, key=word)


@pytest.mark.parametrize(
    "url", ["http://me:s3cr@t@127.0.0.1:1", "ftp://me:s3cr@t@host", "http://me:s3cr@t@h:x"]
)
def test_a_password_in_an_address_appears_nowhere(url: str):
    with pytest.raises(ServiceUnreachable) as refused:
        Client(url).threshold(omega=0.5, xi=0.26)
    assert "s3cr" not in str(refused.value) + refused.value.url
    with Client("http://me:s3cr@t@127.0.0.1:1") as client:
        assert "s3cr" not in repr(client) + client.url


def test_a_password_in_an_address_is_sent():
    with scripted(Answer(body=view())) as (server, client):
        with Client(client.url.replace("//", "//me:s3cr%40t@")) as known:
            known.job(ID)
            assert known.url == client.url
        assert server.requests[0][2]["Authorization"] == "Basic " + b64encode(b"me:s3cr@t").decode()


def test_an_empty_token_is_none():
    with scripted(Answer(body=view())) as (server, client), Client(client.url, token="") as unknown:
        unknown.job(ID)
        assert "Authorization" not in server.requests[0][2]


# Answers


@pytest.mark.parametrize(
    ("status", "kind"),
    [
        (401, Unauthorized),
        (403, Unauthorized),
        (404, NotFound),
        (413, TooLarge),
        (418, Refused),
        (429, Busy),
        (500, ServiceError),
        (502, ServiceError),
        (503, Busy),
    ],
)
def test_every_status_has_its_error(status: int, kind: type[Refused]):
    problem = {
        "title": "No",
        "status": status,
        "detail": "because",
        "errors": [{"field": "xi", "rule": "is odd"}],
    }
    with scripted(Answer(status, problem)) as (_, client), pytest.raises(Refused) as caught:
        client.job(ID)
    assert type(caught.value) is kind
    assert caught.value.problem.title == "No"
    assert caught.value.fields == (("xi", "is odd"),)
    assert str(caught.value) == "because\n  xi: is odd"


def test_busy_carries_retry_after():
    with (
        scripted(Answer(429, {"detail": "full"}, Retry_After="7")) as (_, client),
        pytest.raises(Busy) as caught,
    ):
        client.submit({})
    assert caught.value.retry_after == 7.0


@pytest.mark.parametrize(
    "answer",
    [
        Answer(200, b"<html>hello</html>"),
        Answer(200, b"\xff\xfe"),
        Answer(200, [1, 2]),
        Answer(200, {"id": ID}),
        Answer(200, view() | {"progress": None}),
        Answer(200, view() | {"progress": {"percent": 50.0}}),
        Answer(302, b"", Location="http://127.0.0.1:1/"),
    ],
)
def test_another_program_at_the_address_is_recognised(answer: Answer):
    with scripted(answer) as (_, client), pytest.raises(UnexpectedAnswer):
        client.job(ID)


def test_a_proxys_own_error_page_is_no_problem_document():
    with (
        scripted(Answer(502, b"<html>Bad Gateway</html>")) as (_, client),
        pytest.raises(ServiceError, match="502"),
    ):
        client.job(ID)


def test_malformed_problem_documents_are_read_as_far_as_possible():
    for errors in ("none", [1, "two", {"field": 3}], {"field": "xi"}):
        answer = Answer(422, {"detail": ["a", "list"], "errors": errors})
        with scripted(answer) as (_, client), pytest.raises(Refused) as caught:
            client.threshold(1.0, 1.0)
        assert caught.value.status == 422


# Waiting


def test_a_wait_polls_at_the_interval_of_the_service():
    slow = Answer(200, view("running", 1), Retry_After="0.5")
    with scripted(Answer(202, view("queued"), Retry_After="0.3"), slow, Answer(200, view("done", 10))) as (
        server,
        client,
    ):
        client.submit({}).wait(progress=False)
        first, second, third = server.when
    assert second - first >= 0.3
    assert third - second >= 0.5


def test_without_retry_after_a_wait_polls_less_and_less_often(monkeypatch: pytest.MonkeyPatch):
    from service.client import job as module

    pauses: list[float] = []
    clock = SimpleNamespace(monotonic=time.monotonic, sleep=pauses.append)
    monkeypatch.setattr(module, "time", clock)
    running = [Answer(200, view("running")) for _ in range(39)]
    with scripted(Answer(202, view("queued")), *running, Answer(200, view("done", 10))) as (_, client):
        client.submit({}).wait(progress=False)
    assert (pauses[0], pauses[-1]) == (0.05, 2.0)
    assert pauses == sorted(pauses)


def test_an_unchanged_job_is_requested_by_its_etag():
    first = Answer(200, view("running", 3), ETag='W/"one"', Retry_After="0")
    with scripted(first, Answer(304, Retry_After="0"), Answer(200, view("done", 10))) as (server, client):
        job = client.job(ID)
        assert job.refresh().progress.cells_done == 3
        assert job.wait(progress=False).state == "done"
        assert [headers.get("If-None-Match") for _, _, headers in server.requests] == [
            None,
            'W/"one"',
            'W/"one"',
        ]


def test_a_wait_outlives_a_restart_of_the_service(monkeypatch: pytest.MonkeyPatch):
    from service.client import job as module

    monkeypatch.setattr(module, "MAX_OUTAGE", DEADLINE)
    gone = [LOST] * 3 + [Answer(503, {"detail": "starting"})]
    with scripted(Answer(body=view()), *gone, Answer(body=view("done", 10))) as (_, client):
        assert client.job(ID).wait(progress=False).state == "done"


def test_a_wait_ends_if_the_service_stays_away(monkeypatch: pytest.MonkeyPatch):
    from service.client import job as module

    monkeypatch.setattr(module, "MAX_OUTAGE", 0.1)
    with scripted(Answer(body=view())) as (_, client):
        job = client.job(ID)
    with Client(client.url) as again:
        job._transport = again._transport
        with pytest.raises(ServiceUnreachable):
            job.wait(progress=False)


def computing(done: int) -> Answer:
    return Answer(
        202, {"state": "running", "progress": {"parts_done": done, "parts_total": 4}}, Retry_After="0.2"
    )


def test_an_answer_of_the_workers_is_polled_until_it_is_computed():
    reported: list[tuple[int, int]] = []
    script = (
        computing(0),
        Answer(429, {"detail": "full"}, Retry_After="0.1"),
        computing(3),
        Answer(body={"rows": []}),
    )
    with scripted(*script) as (server, client):
        assert client.tradeoff(progress=lambda *parts: reported.append(parts)) == {"rows": []}
        assert reported == [(0, 4), (3, 4)]
        assert server.when[1] - server.when[0] >= 0.2


def test_a_timeout_of_the_workers_answer_reports_their_progress():
    with (
        scripted(computing(1)) as (_, client),
        pytest.raises(
            NotComputedYet,
            match=r"^1 of 4 parts computed after -1 s; the computation continues, repeat the request later$",
        ),
    ):
        client.tradeoff(timeout=-1.0, progress=False)
    with scripted(Answer(202, {"state": "running"})) as (_, client), pytest.raises(UnexpectedAnswer):
        client.tradeoff(progress=False)


def test_progress_of_the_workers_answer_is_written_in_lines(capsys: pytest.CaptureFixture[str]):
    show = display_parts(True)
    for done in range(24):
        show(done, 23)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "computed 0 of 23 parts"
    assert len(lines) == 8
    display_parts(False)(1, 2)
    assert capsys.readouterr().err == ""


def test_a_list_goes_on_to_its_last_page():
    pages = [Answer(body={"jobs": [view()], "next": "more"}), Answer(body={"jobs": [view("done")]})]
    with scripted(*pages) as (server, client):
        assert [job.state for job in client.jobs(state="running")] == ["running", "done"]
        assert "cursor=more" in server.requests[1][1]
        assert "state=running" in server.requests[1][1]
    with scripted(Answer(body={"rows": []})) as (_, client), pytest.raises(UnexpectedAnswer):
        list(client.jobs())


# Showing progress


def shown(*views: tuple[float, dict[str, Any]]) -> list[str]:
    """The plain lines written for jobs that look like this at these seconds."""
    from service.client.display import JobLines
    from service.client.job import Job

    out, now = io.StringIO(), [0.0]
    lines = JobLines(out, clock=lambda: now[0])
    with Client("http://127.0.0.1:9") as client:
        for now[0], description in views:
            lines(Job.from_view(client._transport, description))
    return out.getvalue().splitlines()


def test_plain_lines_are_few():
    percents = [(0.01 * done, view("running", done) | {"name": "x"}) for done in range(11)]
    assert len(shown(*percents)) == 11
    slow = [(float(second), view("running", 0)) for second in range(100)]
    assert len(shown(*slow)) == 1
    creeping = view("running", 0)
    creep = [
        (float(second), creeping | {"progress": creeping["progress"] | {"percent": second / 100}})
        for second in range(100)
    ]
    assert len(shown(*creep)) == 10


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("out", "text"),
    [(io.StringIO(), "compiling\ntook 0 s\n"), (Terminal(), "\rcompiling (0 s)\n")],
    ids=["no terminal", "terminal"],
)
def test_what_takes_long_tells_how_long(monkeypatch: pytest.MonkeyPatch, out: io.StringIO, text: str):
    from service.client.display import display_elapsed

    monkeypatch.setattr(sys, "stderr", out)
    with display_elapsed("compiling"):
        wait_for(lambda: "compiling" in out.getvalue())
    assert out.getvalue() == text
    with display_elapsed("compiling", after=60.0):
        pass
    assert out.getvalue() == text


def test_a_plain_line_shows_percent_cells_and_time_left():
    progress = {"cells_done": 1234, "cells_total": 5000, "percent": 24.68, "eta_seconds": 4000.0}
    (line,) = shown((0.0, view() | {"name": "three", "progress": view()["progress"] | progress}))
    assert line == "01234567 three: running, 24% (1,234 of 5,000 cells), 1 h 6 min left"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.4, "0 s"), (59.6, "1 min 0 s"), (125, "2 min 5 s"), (3600, "1 h 0 min"), (4e6, "1,111 h 6 min")],
)
def test_durations_read_well(seconds: float, text: str):
    from service.client.display import duration

    assert duration(seconds) == text


# Stores


def array(*codecs: str, **changes: Any) -> dict[str, Any]:
    """The metadata of an array, as in `zarr.json`."""
    return {
        "zarr_format": 3,
        "node_type": "array",
        "shape": [1],
        "data_type": "float64",
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [1]}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": 0.0,
        "codecs": [{"name": name, "configuration": {}} for name in codecs],
        "attributes": {},
        "storage_transformers": [],
        "dimension_names": ["gamma"],
    } | changes


def group(**arrays: dict[str, Any]) -> dict[str, Any]:
    kept = {"kind": "inline", "must_understand": False, "metadata": arrays}
    return {"zarr_format": 3, "node_type": "group", "attributes": {}, "consolidated_metadata": kept}


@pytest.mark.parametrize(
    ("document", "why"),
    [
        (
            group(gamma=array("bytes"), evil=array("bytes", "numcodecs.pickle")),
            "codecs that no bounce .*pickle",
        ),
        (array("blosc"), "codecs that no bounce store has: 'blosc'"),
        (group(evil=array("bytes", zarr_format=2)), "not the metadata of a bounce store"),
        (
            group(evil=array("bytes", storage_transformers=[{"name": "x"}])),
            "not the metadata of a bounce store",
        ),
        (group(evil=array(codecs=["bytes"])), "not the metadata of a bounce store"),
        ([], "not the metadata of a bounce store"),
        (b"{", "not the metadata of a bounce store"),
    ],
)
def test_a_store_that_the_service_cannot_have_written_is_refused(document: Any, why: str):
    with scripted(Answer(body=view()), Answer(body=document)) as (server, client):
        with pytest.raises(UnexpectedAnswer, match=why):
            client.job(ID).open()
        assert [path.rpartition("/zarr/")[2] for _, path, _ in server.requests[1:]] == ["zarr.json"]


def test_a_store_of_zarrs_version_2_is_not_looked_for():
    """Its compressors and filters can unpickle."""
    answers = (Answer(body=view()), Answer(404, {"detail": "nothing"}))
    with scripted(*answers) as (_, client), pytest.raises(StoreUnreachable):
        client.job(ID).open()


class Marks:
    """Makes a folder where it is unpickled."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.folder),)


@pytest.mark.parametrize("version", [2, 3])
def test_a_hostile_store_runs_no_code(tmp_path: Path, version: int):
    """A real one, whose chunk is a pickle, which runs what is in it, as the control shows."""
    marker, control = tmp_path / "ran", tmp_path / "control"
    pickle.loads(pickle.dumps(Marks(control)))
    assert control.is_dir()
    hostile = array("numcodecs.pickle", dimension_names=["evil"])
    old = {"zarr_format": 2, "shape": [1], "chunks": [1], "dtype": "|O", "compressor": None, "order": "C",
           "fill_value": 0, "filters": [{"id": "pickle"}]}  # fmt: skip
    attributes = {"_ARRAY_DIMENSIONS": ["evil"]}
    metadata = {".zgroup": {"zarr_format": 2}, ".zattrs": {}, "evil/.zarray": old, "evil/.zattrs": attributes}
    files: dict[str, Any] = {
        2: metadata | {".zmetadata": {"zarr_consolidated_format": 1, "metadata": metadata}},
        3: {"zarr.json": group(evil=hostile), "evil/zarr.json": hostile},
    }[version]
    chunks = dict.fromkeys(("evil/0", "evil/c/0"), pickle.dumps(Marks(marker)))
    served = {f"/v1/jobs/{ID}/zarr/{key}": content for key, content in {**files, **chunks}.items()}
    with serving(served | {f"/v1/jobs/{ID}": view("done")}) as (url, asked), Client(url) as client:
        job = client.job(ID)
        with pytest.raises((UnexpectedAnswer, StoreUnreachable)):
            job.open().load()
    assert not marker.exists()
    assert any("/zarr/" in path for path in asked)
    assert [path for path in asked if path.endswith(("evil/0", "evil/c/0"))] == []


@contextmanager
def serving(contents: dict[str, Any]) -> Iterator[tuple[str, list[str]]]:
    """A server that has these contents by path, and the paths that it was asked for."""
    asked: list[str] = []

    class Static(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            content = contents.get(self.path)
            body = content if isinstance(content, bytes) else json.dumps(content).encode()
            self.send_response(404 if content is None else 200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None: ...

    with ThreadingHTTPServer(("127.0.0.1", 0), Static) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}", asked
        finally:
            server.shutdown()
            thread.join()


@pytest.mark.parametrize(
    "url",
    [
        *("http://me:s3cret@host:bad", "http://me:s3cret@[::1", "me:s3cret@host", "//me:s3cret@host"),
        *("ftp://me:s3cret@host", "http:me:s3cret@host", "http:\\\\me:s3cret@host", "http://me:s3cret@h\n"),
        *("http://me:s3/cret@host", "http://me:s3?cret@host", "http://me:s3#cret@host", "http://me:s3@cret@"),
        "http://me:s3cret@127.0.0.1:1",
    ],
)
def test_no_error_shows_a_password_of_the_address(url: str):
    def ask() -> None:
        with Client(url, timeout=5) as client:
            assert "s3" not in repr(client) + client.url + client.page
            client.metrics()

    with pytest.raises(ServiceUnreachable) as refused:
        ask()
    assert "s3" not in "".join(traceback.format_exception_only(refused.value))
    assert "cret" not in str(refused.value)
