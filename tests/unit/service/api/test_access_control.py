"""Access control: tokens, Host, Origin, security headers; the log; TLS to the scheduler."""

import io
import json
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from fastapi.testclient import TestClient
from scripted import Held, sweep, wait_for
from served import impatient, service
from tables import for_each

from service.api.app import create_app
from service.cli.main import main
from service.server.logging import log_to_stderr
from service.settings import Settings

TOKEN = "a-token-of-thirty-two-characters"
SWEEP = sweep().as_submitted()

#: Required parameters, without which the endpoint itself would refuse the request.
QUERIES = {
    "/v1/jobs/{job_id}/export": "?format=nc",
    "/v1/threshold": "?omega=1&xi=1",
    "/v1/orbits": "?omega=1&xi=1",
    "/v1/curves": "?xi=1&omega_start=1&omega_stop=2",
}

#: Paths that require no token.
PROBES = [("GET", "/healthz"), ("GET", "/readyz")]

#: Every operation of the API document, for one job. Each requires the token.
CALLS = [
    (method.upper(), path.format(job_id="{job}", key="zarr.json") + QUERIES.get(path, ""))
    for path, methods in create_app(Settings(), Held()).openapi()["paths"].items()
    for method in methods
    if (method.upper(), path) not in PROBES
] + [("HEAD", "/v1/jobs/{job}/zarr/zarr.json"), ("GET", "/nowhere"), ("DELETE", "/v1/jobs")]


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    beyond = {"token": TOKEN, "host": "0.0.0.0", "allowed_hosts": "bounce.example.org"}
    with service(tmp_path_factory.mktemp("data"), Held(), **beyond) as client:
        yield client


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    with pytest.MonkeyPatch.context() as patch:
        impatient(patch)
        with service(tmp_path_factory.mktemp("data"), Held()) as client:
            yield client


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


# Tokens


@for_each("given", ["", "wrong", "auto", TOKEN[:-1], TOKEN + "x", TOKEN.upper()])
def test_every_endpoint_requires_the_token(guarded: TestClient, given: str):
    job = guarded.post("/v1/jobs", json=SWEEP, headers=bearer(TOKEN)).json()
    for method, path in CALLS:
        answer = guarded.request(method, path.format(job=job["id"]), headers=bearer(given) if given else {})
        assert answer.status_code == 401, path
        assert answer.headers["WWW-Authenticate"] == "Bearer"
        if method != "HEAD":
            assert "token" in answer.json()["detail"]
            assert TOKEN not in answer.text
    now = guarded.get(job["links"]["self"], headers=bearer(TOKEN)).json()
    assert now["state"] in ("queued", "running")


@for_each(("status", "sent"), [
    (200, [f"Bearer {TOKEN}"]), (200, [f"bearer  {TOKEN} "]), (401, [TOKEN]), (401, [f"Basic {TOKEN}"]),
    (401, [f"Bearer{TOKEN}"]), (401, ["Bearer"]), (401, ["Bearer \u00e9"]),
    (401, [f"Bearer {TOKEN}", "Bearer x"]),
])  # fmt: skip
def test_the_token_must_be_one_bearer_token(guarded: TestClient, status: int, sent: list[str]):
    headers = [(b"Authorization", header.encode("latin-1")) for header in sent]
    assert guarded.get("/v1/jobs", headers=headers).status_code == status


@pytest.mark.parametrize("path", ["/healthz", "/readyz", "/docs", "/openapi.json"])
def test_open_paths_require_no_token(guarded: TestClient, path: str):
    assert guarded.get(path).status_code == 200


@pytest.mark.parametrize(
    "path", ["/static/../v1/jobs", "/docs/../v1/jobs", "//v1/jobs", "/healthz/../v1/jobs"]
)
def test_path_traversal_does_not_bypass_the_token(guarded: TestClient, path: str):
    request = guarded.build_request("GET", "http://localhost/")
    request.url = request.url.copy_with(raw_path=path.encode())
    assert guarded.send(request).status_code in (401, 404)


# Named tokens

ANA, BEN = "ana-has-a-token-of-her-own", "ben-has-a-token-of-his-own"


@pytest.fixture
def named(tmp_path: Path) -> Iterator[TestClient]:
    """A service with two named tokens and one without a name; three jobs of one token may be unfinished.

    It runs one job at a time, and runs one that never ends: submitted jobs stay queued.
    """
    file = tmp_path / "tokens"
    file.write_text(f"# who may compute\nana: {ANA}\n\nben@lab : {BEN}\n")
    file.chmod(0o600)
    limits = {"max_queue_per_token": 3, "active_jobs": 1}
    with service(tmp_path / "data", Held(), token=TOKEN, token_file=file, **limits) as client:
        endless = submitted(client, TOKEN, 0.123).json()["links"]["self"]
        wait_for(lambda: client.get(endless, headers=bearer(TOKEN)).json()["state"] == "running")
        yield client


def submitted(client: TestClient, token: str, omega: float) -> Any:
    return client.post("/v1/jobs", json={**SWEEP, "omega": omega}, headers=bearer(token))


def test_a_job_names_who_submitted_it(named: TestClient):
    jobs = {token: submitted(named, token, 0.3 + i / 10).json() for i, token in enumerate((ANA, BEN, TOKEN))}
    assert [job["owner"] for job in jobs.values()] == ["ana", "ben@lab", None]
    listed = named.get("/v1/jobs", headers=bearer(BEN)).json()["jobs"]
    assert [job["owner"] for job in listed] == [None, "ben@lab", "ana", None]
    assert submitted(named, BEN, 0.3).json()["owner"] == "ana"  # the same sweep is the same job
    assert ANA not in json.dumps(listed)


@for_each("sent", [ANA[:-1], ANA + "x", f"ana: {ANA}", "ana", "", "auto"])
def test_nothing_but_a_token_of_the_file_is_accepted(named: TestClient, sent: str):
    assert submitted(named, sent, 0.3).status_code == 401


# Settings


@pytest.mark.parametrize("host", ["0.0.0.0", "example.org"])
def test_listening_beyond_loopback_requires_a_token(tmp_path: Path, host: str):
    done = CliRunner().invoke(
        main, ["serve", "--host", host, "--data", str(tmp_path)], env={"BOUNCE_TOKEN": ""}
    )
    assert done.exit_code == 1
    assert f"to listen on {host}" in done.output
    assert "BOUNCE_TOKEN" in done.output
    assert list(tmp_path.iterdir()) == []


# Host


@for_each(
    "host",
    ["evil.example", "localhost.evil.example", "127.0.0.1.evil.example", "evil.example:8000", "", "[::1",
     "a@localhost", "localhost\u00e9", "0.0.0.0", "169.254.169.254"],
)  # fmt: skip
def test_another_host_is_refused(local: TestClient, host: str):
    answer = local.get("/v1/jobs", headers={"Host": host.encode("latin-1")})
    assert answer.status_code == 421
    assert "BOUNCE_ALLOWED_HOSTS" in answer.json()["detail"]


@for_each("host", ["localhost", "LOCALHOST:9", "127.0.0.1:8000", "[::1]:8000", "localhost."])
def test_loopback_hosts_are_allowed(local: TestClient, host: str):
    assert local.get("/v1/jobs", headers={"Host": host}).status_code == 200


def test_the_operator_can_allow_hosts(guarded: TestClient, tmp_path: Path):
    assert guarded.get("/healthz", headers={"Host": "bounce.example.org"}).status_code == 200
    assert guarded.get("/healthz", headers={"Host": "other.example.org"}).status_code == 421
    assert Settings(allowed_hosts=" a.org , B.org,").allowed_hosts == {"a.org", "b.org"}
    assert "192.0.2.7" in Settings(host="192.0.2.7", token=TOKEN).hosts


# Origin


FOREIGN = [
    {"Origin": "https://evil.example"},
    {"Origin": "null"},
    {"Origin": "http://localhost:9000"},
    {"Sec-Fetch-Site": "cross-site"},
    {"Sec-Fetch-Site": "same-site"},
]


@for_each("headers", FOREIGN)
@for_each("way", [("POST", "/cancel"), ("POST", "/resume"), ("DELETE", "")])
def test_a_page_of_another_origin_changes_nothing(
    local: TestClient, headers: dict[str, str], way: tuple[str, str]
):
    job = local.post("/v1/jobs", json=SWEEP).json()["links"]["self"]
    answer = local.request(way[0], job + way[1], headers=headers)
    assert answer.status_code == 403
    assert local.get(job).json()["state"] in ("queued", "running")


def test_a_change_that_depends_on_a_tag_is_not_made(local: TestClient):
    job = local.post("/v1/jobs", json=SWEEP).json()["links"]["self"]
    for tag, status in (('"zzz"', 412), (local.get(job).headers["ETag"], 412), ("*", 202)):
        assert local.post(f"{job}/cancel", headers={"If-Match": tag}).status_code == status


READS = [(method, path) for method, path in CALLS if method in ("GET", "HEAD")]


@for_each(("method", "path"), READS)
@for_each("headers", [
    [("Sec-Fetch-Site", "cross-site"), ("Sec-Fetch-Mode", "no-cors"), ("Sec-Fetch-Dest", "image")],
    [("Sec-Fetch-Site", "same-site"), ("Sec-Fetch-Mode", "cors"), ("Sec-Fetch-Dest", "empty")],
    [("Sec-Fetch-Site", "cross-site"), ("Sec-Fetch-Mode", "navigate"), ("Sec-Fetch-Dest", "iframe")],
    [("Sec-Fetch-Site", "none"), ("Sec-Fetch-Site", "cross-site")],
])  # fmt: skip
def test_a_page_of_another_origin_loads_nothing(
    local: TestClient, method: str, path: str, headers: list[tuple[str, str]]
):
    answer = local.request(method, path.format(job="0" * 32), headers=headers)
    assert answer.status_code == 403
    if method == "GET":
        assert "may link to this" in answer.json()["detail"]


@pytest.mark.parametrize("site", ["cross-site", "same-site", "same-origin", "none"])
def test_a_link_on_a_page_of_another_origin_works(local: TestClient, site: str):
    job = local.post("/v1/jobs", json=SWEEP).json()["links"]["self"]
    navigation = {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
    assert local.get(job, headers=navigation).status_code == 200
    assert local.post("/v1/jobs", json=SWEEP, headers=navigation).status_code == (
        200 if site in ("same-origin", "none") else 403
    )


@for_each(("method", "path"), [call for call in READS if call[0] == "GET"])
def test_head_answers_what_get_answers(local: TestClient, method: str, path: str):
    """Without the body, and at once also where GET streams until the job ends."""
    job = local.post("/v1/jobs", json=SWEEP).json()["id"]
    wait_for(lambda: local.get(f"/v1/jobs/{job}").json()["state"] == "running")  # its answers change then
    head = local.head(path.format(job=job))
    assert head.content == b""
    if "/events" in path:
        assert head.status_code == 200
        return
    answer = local.request(method, path.format(job=job))
    assert head.status_code == answer.status_code
    assert head.headers["Content-Type"] == answer.headers["Content-Type"]
    assert head.headers.get("ETag") == answer.headers.get("ETag")
    if answer.status_code == 405:
        assert "GET" not in answer.headers["Allow"]


def test_no_page_of_another_origin_may_read(local: TestClient):
    answer = local.get("/v1/jobs", headers={"Origin": "https://evil.example"})
    assert not [name for name in answer.headers if name.startswith("access-control-")]
    preflight = {"Origin": "https://evil.example", "Access-Control-Request-Method": "POST"}
    answer = local.options("/v1/jobs", headers=preflight)
    assert answer.status_code == 405
    assert not [name for name in answer.headers if name.startswith("access-control-")]


@for_each("path", ["/docs", "/v1/jobs", "/v1/jobs/none", "/nowhere", "/healthz"])
def test_every_response_has_the_security_headers(local: TestClient, path: str):
    headers = local.get(path).headers
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["X-Frame-Options"] == "DENY"
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert "server" not in headers


# The log


def lines(log: io.StringIO) -> list[dict[str, Any]]:
    return [json.loads(line) for line in log.getvalue().splitlines()]


@pytest.fixture
def logged(monkeypatch: pytest.MonkeyPatch) -> Iterator[io.StringIO]:
    log = io.StringIO()
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", log)
        with log_to_stderr("info"):
            yield log


def test_a_request_is_one_line(local: TestClient, logged: io.StringIO):
    job = local.post("/v1/jobs", json=SWEEP).json()
    answer = local.get(job["links"]["self"])
    (line,) = [line for line in lines(logged) if line.get("id") == answer.headers["X-Request-Id"]]
    assert (line["event"], line["method"], line["route"]) == ("request", "GET", "/v1/jobs/{job_id}")
    assert (line["status"], line["job"]) == (200, job["id"])
    assert line["ms"] >= 0


def test_a_warning_of_a_library_is_one_line(logged: io.StringIO):
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.warn("a table\nof versions", stacklevel=1)
    (line,) = lines(logged)
    assert "a table\nof versions" in line["event"]


def test_a_caller_cannot_forge_log_lines(local: TestClient, logged: io.StringIO):
    local.get("/v1/jobs/%0a%7b%22level%22:%22error%22%7d")
    local.get("/nowhere%0aevil", headers={"Authorization": "Bearer secret-of-somebody"})
    requests = [line for line in lines(logged) if line["event"] == "request"]
    assert len(requests) == 2
    assert "secret-of-somebody" not in json.dumps(requests)


def test_a_traceback_goes_to_the_log_and_not_to_the_caller(
    tmp_path: Path, logged: io.StringIO, monkeypatch: pytest.MonkeyPatch
):
    with service(tmp_path, Held()) as client:
        monkeypatch.setattr(client.app.state.service.ledger, "find", lambda job_id: 1 / 0)  # type: ignore[attr-defined]
        answer = client.get("/v1/jobs/none")
    assert answer.status_code == 500
    assert "division" not in answer.text
    (line,) = [line for line in lines(logged) if line["event"] == "internal error"]
    assert "ZeroDivisionError" in line["traceback"]
    assert line["id"] == answer.headers["X-Request-Id"]
    assert line["id"] in answer.json()["detail"]
