"""The client against a scripted HTTP server: what it sends, when, and what it makes of the answers."""

import asyncio
import gc
import gzip
import math
import os
import pickle
import socket
import ssl
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from answering import ID, LOST, Answer, scripted, view
from distributed import Security
from scripted import DEADLINE, wait_for
from served import FIGURE_2, computing_at
from tables import for_each

from service.client import (
    BadRequest,
    BounceError,
    Busy,
    Client,
    InvalidSpecification,
    Refused,
    ServiceUnreachable,
    StoreUnreachable,
    Unanswered,
    UnexpectedAnswer,
    transport,
)
from service.client.zarr_store import HTTPStore


@pytest.fixture
def unused_address() -> Iterator[str]:
    """An address at which nobody listens, for as long as the test takes."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        yield f"http://127.0.0.1:{taken.getsockname()[1]}"


@pytest.fixture(autouse=True)
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pauses between two tries are a twentieth as long."""
    clock = SimpleNamespace(monotonic=time.monotonic, sleep=lambda seconds: time.sleep(seconds / 20))
    monkeypatch.setattr(transport, "time", clock)


# Connecting


@for_each("url", ["", "localhost:8000", "ftp://localhost", "http://", "http://[::1", "/v1", "http://h:1/?"])
def test_an_invalid_address_is_refused(url: str):
    with pytest.raises(ServiceUnreachable):
        Client(url)


@for_each("timeout", [None, 0, math.nan, "5"])
def test_a_time_limit_is_a_number_above_0(timeout: Any):
    with pytest.raises(BounceError, match="timeout: must be seconds above 0"):
        Client(timeout=timeout)


def test_after_a_lost_connection_all_but_a_deletion_is_repeated(tmp_path: Path):
    """The same sweep is the same job; of two deletions, the second would tell of no such job."""
    with scripted(LOST, Answer(502, b"<html>"), Answer(body=view())) as (server, client):
        assert client.job(ID).state == "running"
        assert [path for _, path, _ in server.requests] == [f"/v1/jobs/{ID}"] * 3
    with scripted(LOST, Answer(202, view("queued")), LOST, Answer(202, view())) as (server, client):
        job = client.submit({"xi": 1})
        assert (job.id, job.cancel().id) == (ID, ID)
        assert [method for method, _, _ in server.requests] == ["POST"] * 4
    with scripted(Answer(body=view()), LOST) as (_, client), pytest.raises(ServiceUnreachable):
        client.job(ID).delete()
    cut = Answer(200, b"half", Content_Length="8")
    with scripted(Answer(body=view()), cut, LOST, Answer(200, b"complete")) as (_, client):
        assert client.job(ID).export(tmp_path / "sweep.nc").read_bytes() == b"complete"


def test_what_a_proxy_holds_back_is_repeated():
    """A submission has one id, however often it is sent; a second deletion would find nothing."""
    held_back = Answer(503, b"<html>", Content_Type="text/html")
    with scripted(*[held_back] * 4, Answer(202, view()), held_back) as (_, client):
        job = client.submit({"xi": 1})
        with pytest.raises(Busy):
            job.delete()
    with scripted(Answer(503, {"detail": "stopping"})) as (_, client), pytest.raises(Busy, match="stopping"):
        client.job(ID)
    with scripted(Answer(429, {"detail": "full"})) as (_, client), pytest.raises(Busy, match="full"):
        client.submit({"xi": 1})


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_no_proxy_is_used_for_loopback(monkeypatch: pytest.MonkeyPatch, unused_address: str, host: str):
    for name in ("HTTP_PROXY", "http_proxy", "ALL_PROXY", "all_proxy"):
        monkeypatch.setenv(name, unused_address)
    for name in ("NO_PROXY", "no_proxy"):
        monkeypatch.delenv(name, raising=False)
    with scripted(Answer(body=view())) as (_, client):
        assert Client(client.url.replace("127.0.0.1", host), timeout=math.inf).job(ID).id == ID


def test_a_proxy_is_used_for_other_machines(monkeypatch: pytest.MonkeyPatch):
    for name in ("NO_PROXY", "no_proxy", "ALL_PROXY", "all_proxy"):
        monkeypatch.delenv(name, raising=False)
    with scripted(Answer(body=view())) as (server, client):
        for name in ("HTTP_PROXY", "http_proxy"):
            monkeypatch.setenv(name, client.url)
        with Client("http://service.invalid:8000") as far:
            assert far.job(ID).id == ID
        assert [path for _, path, _ in server.requests] == [f"http://service.invalid:8000/v1/jobs/{ID}"]


def test_a_certificate_that_is_not_trusted_is_no_missing_service(tmp_path: Path):
    made, context = Security.temporary(), ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    file = tmp_path / "server.pem"
    file.write_text(made.tls_scheduler_key + made.tls_scheduler_cert)
    context.load_cert_chain(file)
    with scripted() as (server, client):
        server.socket = context.wrap_socket(server.socket, server_side=True)
        with (
            Client(client.url.replace("http", "https")) as careful,
            pytest.raises(UnexpectedAnswer, match="is not trusted"),
        ):
            careful.job(ID)


def test_plain_http_and_tls_that_meet_are_told_apart():
    refused = Answer(400, b"The plain HTTP request was sent to HTTPS port")  # nginx
    with scripted(refused) as (_, client), pytest.raises(BadRequest, match="take https:// only"):
        client.job(ID)
    with (
        scripted() as (_, client),
        Client(client.url.replace("http", "https")) as secure,
        pytest.raises(UnexpectedAnswer, match="may begin with http://"),
    ):
        secure.job(ID)


def test_a_pickled_job_has_connections_of_its_own():
    with scripted(Answer(body=view()), Answer(body=view("done", 10))) as (server, client):
        with Client(client.url, "s3cret") as known:
            copy = pickle.loads(pickle.dumps(known.job(ID)))
        assert copy.refresh().state == "done"
        assert server.requests[1][2]["Authorization"] == "Bearer s3cret"
        connections = copy._transport._http
        copy._transport.close()
        assert connections.is_closed
    again = pickle.loads(pickle.dumps(known._transport))
    connections = again._http
    del again
    wait_for(lambda: bool(gc.collect() >= 0 and connections.is_closed))  # nobody else closes them


#: Four forked processes, each of which asks for a job of its own.
FORKED = """
import sys
from multiprocessing import get_context
from bouncing_spring import Client
url, *ids = sys.argv[1:]
client = Client(url)
client.job(ids[0])
def ask(id):
    return [client.job(id).id for _ in range(25)] == [id] * 25
with get_context("fork").Pool(len(ids)) as pool:
    assert all(pool.map(ask, ids, chunksize=1))
"""


def test_forked_processes_have_connections_of_their_own(tmp_path: Path):
    with computing_at(tmp_path) as url, Client(url) as client:
        ids = [client.submit(FIGURE_2 | {"xi": xi}).id for xi in (0.1, 0.2, 0.3, 0.4)]
        subprocess.run([sys.executable, "-c", FORKED, url, *ids], check=True, timeout=DEADLINE)


def test_the_token_goes_with_every_call(monkeypatch: pytest.MonkeyPatch):
    """One that is given, or that of the environment."""
    for given in ({"token": "s3cret"}, {}):
        monkeypatch.setenv("BOUNCE_TOKEN", "another" if given else "s3cret")
        with scripted(Answer(body=view())) as (server, client), Client(client.url, **given) as known:
            known.job(ID)
            assert server.requests[0][2]["Authorization"] == "Bearer s3cret"
            assert "s3cret" not in repr(known)
        with pytest.raises(BounceError, match="the client is closed"):
            known.job(ID)


@pytest.mark.parametrize("word", ["schlüssel", "two words", "two\nlines"])
def test_what_a_header_cannot_carry_is_refused_and_not_repeated(word: str):
    with pytest.raises(BounceError, match="the token must consist of ASCII") as caught:
        Client("http://127.0.0.1:1", token=word)
    assert word not in str(caught.value)
    with Client("http://127.0.0.1:1") as client, pytest.raises(BounceError, match="an idempotency key must"):
        client.submit({"gamma": 1.5, "omega": 0.5, "xi": 0.26}, key=word)


# Answers


@for_each("search", ["\udcff", "x" * 70_000])
def test_a_search_that_no_address_can_hold_is_refused(search: str):
    with scripted() as (_, client), pytest.raises(BadRequest, match="no address can hold what is asked for"):
        list(client.jobs(search=search))


@pytest.mark.parametrize("asked", ["1e300", "0"])
def test_a_read_waits_for_a_busy_service_as_long_as_its_timeout(
    asked: str | None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    pauses, said = list[float](), [""]

    def is_shown() -> bool:
        said[0] += capsys.readouterr().err
        return "the service is busy: waiting" in said[0]

    def sleep(seconds: float) -> None:
        pauses.append(seconds)
        wait_for(is_shown)

    clock = SimpleNamespace(monotonic=lambda: len(pauses) * DEADLINE, sleep=sleep)
    monkeypatch.setattr("service.client.transport.time", clock)
    monkeypatch.setattr("service.client.transport.SHOWN_AFTER", 0.05)
    busy = Answer(429, {"detail": "full"}, **({} if asked is None else {"Retry_After": asked}))
    with scripted(busy, Answer(body=view())) as (_, client), Client(client.url, timeout=DEADLINE) as hurried:
        assert hurried.job(ID).state == "running"
        assert 0.0 < pauses[0] <= DEADLINE
    with scripted(busy, busy) as (_, client), Client(client.url, timeout=DEADLINE) as hurried:
        with pytest.raises(Busy, match="full") as caught:
            hurried.job(ID)
        assert caught.value.__suppress_context__ or caught.value.__context__ is None
    script = (Answer(body=view()), busy, Answer(body={}))
    with scripted(*script) as (_, client), Client(client.url, timeout=DEADLINE) as hurried:
        job = hurried.job(ID)
        with pytest.raises(UnexpectedAnswer):
            job.threshold(timeout=DEADLINE, progress=False)


def test_an_error_of_the_connection_is_one_sentence(unused_address: str):
    """Without the libraries' own errors behind it; only where nobody listens it says that nobody answers."""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        busy = f"http://127.0.0.1:{silent.getsockname()[1]}"
        late = "did not answer: nothing came in time (0.2 s), it may be busy: repeat the request, or give"
        for url, said in ((unused_address, "no service answers at"), (busy, late)):
            with Client(url, timeout=0.2) as client, pytest.raises(ServiceUnreachable) as caught:
                client.job(ID)
            shown = "".join(traceback.format_exception(caught.value))
            assert said in str(caught.value)
            assert "\n" not in str(caught.value)
            assert shown.count("Traceback") == 1
    with scripted(LOST, LOST, LOST) as (_, client), pytest.raises(Unanswered, match="the connection broke"):
        client.job(ID)


def test_an_answer_that_inflates_to_much_more_is_not_read_to_its_end(monkeypatch: pytest.MonkeyPatch):
    """Zeros in a thousandth of their size, as an answer and as a refusal."""
    monkeypatch.setattr("service.client.transport.MAX_ANSWER_BYTES", 2**21)
    packed = gzip.compress(bytes(3_000_000))
    inflating = [Answer(status, packed, Content_Encoding="gzip") for status in (200, 500)]
    with scripted(*inflating) as (_, client):
        for _ in inflating:
            with pytest.raises(UnexpectedAnswer, match="sends more than 2 MiB"):
                client.job(ID)


NESTED = b'{"id": ' + b"[" * 200_000 + b"]" * 200_000 + b"}"


@for_each(("answer", "told"), [
    (Answer(200, NESTED), "answered 200"),
    (Answer(200, b"<html>hello</html>"), "answered 200"),
    (Answer(200, {"id": ID}), "not describe a job"),
    (Answer(308, b"", Location="/bouncing/v1?token=secret"), r"on to http://[0-9.:]+/bouncing/v1: if"),
])  # fmt: skip
def test_another_program_at_the_address_is_recognised(answer: Answer, told: str):
    """An answer that sends on is not followed, because the token is for the address given."""
    with scripted(answer) as (_, client), pytest.raises(UnexpectedAnswer, match=told):
        client.job(ID)


@for_each("page", [
    Answer(200, b"log in", Content_Type="text/html"),
    Answer(404, b"default backend"),
    Answer(200, b"of no length, perhaps cut", Connection="close"),
])  # fmt: skip
def test_a_page_of_a_proxy_is_neither_a_result_nor_a_missing_chunk(tmp_path: Path, page: Answer):
    """A missing chunk would be read as fill values."""
    with scripted(Answer(body=view()), page, page, page) as (_, client):
        job = client.job(ID)
        for read in (partial(job.export, tmp_path / "sweep.nc"), partial(job.result_file, "diagram", "csv")):
            with pytest.raises(UnexpectedAnswer):
                read()
        with pytest.raises(UnexpectedAnswer):
            asyncio.run(HTTPStore(job._transport, "/v1/zarr").exists("gamma/c/0"))
    assert not list(tmp_path.iterdir())


def test_malformed_problem_documents_are_read_as_far_as_possible():
    for errors in ("none", [1, "two", {"field": 3}], {"field": "xi"}):
        answer = Answer(422, {"detail": ["a", "list"], "errors": errors})
        with scripted(answer) as (_, client), pytest.raises(Refused) as caught:
            client.threshold(1.0, 1.0)
        assert caught.value.status == 422


# Waiting


def test_a_wait_polls_at_the_interval_of_the_service():
    slow = Answer(200, view("running", 1), Retry_After="0.5")
    queued = Answer(202, view("queued"), Retry_After="0.3")
    with scripted(queued, slow, Answer(200, view("done", 10))) as (server, client):
        client.submit({}).wait(progress=False)
        first, second, third = server.when
    assert second - first >= 0.3
    assert third - second >= 0.5


def test_an_unchanged_job_is_requested_by_its_etag():
    first = Answer(200, view("running", 3), ETag='W/"one"', Retry_After="0")
    with scripted(first, Answer(304, Retry_After="0"), Answer(200, view("done", 10))) as (server, client):
        job = client.job(ID)
        assert job.refresh().progress.cells_done == 3
        assert job.wait(progress=False).state == "done"
        tags = [headers.get("If-None-Match") for _, _, headers in server.requests]
        assert tags == [None, 'W/"one"', 'W/"one"']


def test_a_wait_and_a_result_outlive_a_restart_of_the_service(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("service.client.transport.SHOWN_AFTER", 0.0)
    of_a_proxy = Answer(502, b"<html>"), Answer(504, {"message": "late"})
    gone = [*[LOST] * 3, *of_a_proxy, Answer(503, {"detail": "starting"})]
    parts = {"parts_done": 0, "parts_total": 1}
    computing = Answer(202, {"progress": parts, "notice": "no workers yet"}, Retry_After="0")
    result = computing, *[LOST] * 3, Answer(body={})
    with scripted(Answer(body=view()), *gone, Answer(body=view("done", 10)), *result) as (_, client):
        job = client.job(ID).wait()
        assert job.state == "done"
        assert "the service does not answer: waiting up to" in capsys.readouterr().err
        assert job.result_file("threshold", "json", progress=True) == b"{}"
    assert "computing\nno workers yet\n" in capsys.readouterr().err


def test_a_list_of_sweeps_outlives_a_restart_and_waits_for_a_full_queue(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("service.client.transport.SHOWN_AFTER", 0.0)
    full, done = Answer(429, {"detail": "full"}), Answer(202, view("done", 10))
    with scripted(full, done, *[LOST] * 3, Answer(503, {}), full, done) as (_, client):
        assert [job.state for job in client.map([{}, {}])] == ["done", "done"]
    shown = capsys.readouterr().err
    assert "the service is busy" in shown
    assert "the service does not answer: waiting up to" in shown
    with scripted(Answer(body=view()), *[LOST] * 3, Answer(body=view("done", 10))) as (_, client):
        assert [job.state for job in client.as_completed([client.job(ID)])] == ["done"]
    assert "the service does not answer: waiting up to" in capsys.readouterr().err
    with scripted(*[LOST] * 3) as (_, client), pytest.raises(ServiceUnreachable):
        next(client.map([{}]))  # of a service that was never there


def test_a_list_goes_on_to_its_last_page():
    pages = [Answer(body={"jobs": [view()], "next": "more"}), Answer(body={"jobs": [view("done")]})]
    with scripted(*pages) as (server, client):
        assert [job.state for job in client.jobs(state="running")] == ["running", "done"]
        assert "cursor=more" in server.requests[1][1]
        assert "state=running" in server.requests[1][1]
    with scripted(Answer(body={"rows": []})) as (_, client), pytest.raises(UnexpectedAnswer):
        list(client.jobs())


# Jobs


def test_a_wait_goes_on_with_the_job_that_takes_the_place_of_one():
    replaced = view("failed") | {"replaced_by": "f" * 32}
    script = (Answer(200, replaced, ETag='"a"'), Answer(body=view("done", 10) | {"id": "f" * 32}))
    with scripted(*script) as (server, client):
        job = client.job(ID)
        job.wait(progress=False)
        assert (job.id, job.state) == ("f" * 32, "done")
        assert "If-None-Match" not in server.requests[1][2]  # that is of the other job


# Stores


def array(*codecs: str, **changes: Any) -> dict[str, Any]:
    """The metadata of an array, as in `zarr.json`."""
    return {
        "zarr_format": 3, "node_type": "array", "shape": [1], "data_type": "float64", "fill_value": 0.0,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [1]}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "codecs": [{"name": name, "configuration": {}} for name in codecs],
        "attributes": {}, "storage_transformers": [], "dimension_names": ["gamma"],
    } | changes  # fmt: skip


def group(**arrays: dict[str, Any]) -> dict[str, Any]:
    kept = {"kind": "inline", "must_understand": False, "metadata": arrays}
    return {"zarr_format": 3, "node_type": "group", "attributes": {}, "consolidated_metadata": kept}


@for_each(("document", "why"), [
    (group(gamma=array("bytes"), evil=array("bytes", "numcodecs.pickle")), "codecs that no bounce .*pickle"),
    (group(evil=array("bytes", zarr_format=2)), "not the metadata of a bounce store"),
    (group(gamma=array("bytes", shape=[10**10])), "a coordinate of 10,000,000,000 values"),
    (group(**{f"a{i}": array("bytes") for i in range(5_000)}), "describes more than 1,000 arrays"),
    (b"{", "not the metadata of a bounce store"),
])  # fmt: skip
def test_a_store_that_the_service_cannot_have_written_is_refused(document: Any, why: str):
    with scripted(Answer(body=view()), Answer(body=document)) as (server, client):
        with pytest.raises(UnexpectedAnswer, match=why):
            client.job(ID).open()
        assert [path.rpartition("/zarr/")[2] for _, path, _ in server.requests[1:]] == ["zarr.json"]


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
    contents = served | {f"/v1/jobs/{ID}": view("done")}
    answers = {path: Answer(body=content) for path, content in contents.items()}
    with scripted(contents=answers) as (server, client):
        job = client.job(ID)
        with pytest.raises((UnexpectedAnswer, StoreUnreachable)):
            job.open().load()
    asked = [path for _, path, _ in server.requests]
    assert not marker.exists()
    assert any("/zarr/" in path for path in asked)
    assert [path for path in asked if path.endswith(("evil/0", "evil/c/0"))] == []


@for_each("url", [
    *("http://me:s3cret@host:bad", "http://me:s3cret@[::1", "me:s3cret@host", "//me:s3cret@host"),
    *("ftp://me:s3cret@host", "http:me:s3cret@host", "http:\\\\me:s3cret@host", "http://me:s3cret@h\n"),
    *("http://me:s3/cret@host", "http://me:s3?cret@host", "http://me:s3#cret@host", "http://me:s3@cret@"),
    *("http://me:s3cret@127.0.0.1:1", "http://127.0.0.1:1/#token=s3cret"),
])  # fmt: skip
def test_no_error_shows_a_password_of_the_address(url: str):
    def ask() -> None:
        with Client(url, timeout=5) as client:
            assert "s3" not in repr(client) + client.url + client.page
            client.job(ID)

    with pytest.raises(ServiceUnreachable) as refused:
        ask()
    assert "s3" not in "".join(traceback.format_exception_only(refused.value))
    assert "cret" not in str(refused.value)


def test_an_address_may_have_a_path_that_names_a_user():
    with Client("http://127.0.0.1:1/user/me@example.org/proxy/8000/") as client:
        assert client.url == "http://127.0.0.1:1/user/me@example.org/proxy/8000"


def test_a_budget_ends_with_its_service():
    """A service that has begun anew knows of none; a budget that was too short says why."""
    begun = {"doing": "level 1", "answer": None, "seconds_left": 9, "over": False, "error": None, "id": "ab"}
    short = begun | {"over": True, "error": "budget: was over before the first level"}
    first = Answer(202, view() | {"budget": begun})
    anew, over = Answer(body=view()), Answer(body=view() | {"budget": short})
    with scripted(first, LOST, anew) as (_, client), pytest.raises(BounceError, match="begun anew"):
        client.run({}, budget=10.0, progress=False)
    with scripted(first, over) as (server, client):
        with pytest.raises(InvalidSpecification, match="was over before"):
            client.run({}, budget=10.0, progress=False)
        assert server.requests[-1][1].endswith("?budget=ab")  # not another of the same sweep
