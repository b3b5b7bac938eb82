"""What attackers of a running service achieve: another local user, a foreign web page, a hostile client.

    python -m benchmarks.attack [-o FILE]

Starts `bounce serve --token auto` with an umask that hides nothing, computes a job, and tries. Prints one
table: attack, tries, how many succeeded, which must be none. The first three need root, to become another
user, and are left out otherwise. Exits with 1 if anything succeeded. Takes about a minute.
"""

import argparse
import asyncio
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx2
import psutil

from benchmarks.tables import table
from service import tokens
from service.settings import Settings

ROOT = Path(__file__).parents[1]
#: A user without rights: nobody.
OTHER = 65534
SECONDS = 300.0

SWEEP: dict[str, Any] = {
    "gamma": {"start": 1.0, "stop": 2.0, "num": 20}, "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"},
    "settle": 5, "observe": 5,
}  # fmt: skip

#: Attack, tries, successes.
Row = tuple[str, int, int]


class Target:
    """A service with a token of its own, one job that is done, and what is known of its processes."""

    def __init__(self, folder: Path, process: subprocess.Popen[bytes], port: int) -> None:
        self.folder, self.port, self.url = folder, port, f"http://127.0.0.1:{port}"
        self.data = folder / "data"
        self._http = httpx2.Client(timeout=SECONDS, trust_env=False)
        self.process = psutil.Process(process.pid)
        self.token = json.loads((self.data / tokens.FILE_NAME).read_text())["token"]
        self.own = {"Authorization": f"Bearer {self.token}"}
        self.job = str(self.ask("POST", "/v1/jobs", json=SWEEP, headers=self.own).json()["id"])
        deadline = time.monotonic() + SECONDS
        while self.state() != "done":
            if time.monotonic() > deadline:
                raise SystemExit("the job does not end")
            time.sleep(0.1)

    def ask(self, method: str, path: str, **options: Any) -> httpx2.Response:
        return self._http.request(method, self.url + path, **options)

    def state(self) -> str:
        return str(self.ask("GET", f"/v1/jobs/{self.job}", headers=self.own).json().get("state"))

    def jobs(self) -> list[str]:
        listed = self.ask("GET", "/v1/jobs", headers=self.own).json()["jobs"]
        return sorted(f"{job['id']} {job['state']}" for job in listed)

    def family(self) -> list[psutil.Process]:
        return [self.process, *self.process.children(recursive=True)]

    def ports(self) -> set[int]:
        """Where the service and the processes that it started listen."""
        return {
            connection.laddr.port
            for member in self.family()
            for connection in member.net_connections("inet")
            if connection.status == psutil.CONN_LISTEN
        }

    def operations(self) -> list[tuple[str, str]]:
        """Method and path of every operation that requires the token."""
        queries = {"/v1/jobs/{job_id}/export": "?format=nc", "/v1/threshold": "?omega=1&xi=1"}
        document = self.ask("GET", "/openapi.json").json()
        return [
            (method.upper(), path.format(job_id=self.job, key="zarr.json") + queries.get(path, ""))
            for path, methods in document["paths"].items()
            for method in methods
            if path not in ("/healthz", "/readyz")
        ]

    def exchange(self, request: bytes) -> list[int]:
        """The statuses of all answers to raw bytes, until the service closes the connection or is silent."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=SECONDS) as connection:
            connection.sendall(request)
            connection.settimeout(3.0)
            received = b""
            try:
                while piece := connection.recv(65_536):
                    received += piece
            except (TimeoutError, ConnectionResetError):
                pass
        heads = received.split(b"HTTP/1.1 ")[1:]
        return [int(head[:3]) for head in heads]


@contextmanager
def target() -> Iterator[Target]:
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.chmod(0o1777)  # every user can enter and write to it
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        log = folder / "log"
        with log.open("wb") as output:
            process = subprocess.Popen(
                [sys.executable, "-m", "service.cli.main", "serve", "--token", "auto", "--port", str(port),
                 "--data", str(folder / "data")],
                stdout=output, stderr=output, cwd=ROOT, umask=0,
            )  # fmt: skip
        stack.callback(lambda: (process.terminate(), process.wait(SECONDS)))
        deadline = time.monotonic() + SECONDS
        while not _ready(port):
            if process.poll() is not None or time.monotonic() > deadline:
                raise SystemExit(f"the service does not start:\n{log.read_text()}")
            time.sleep(0.2)
        yield Target(folder, process, port)


def _ready(port: int) -> bool:
    try:
        return httpx2.get(f"http://127.0.0.1:{port}/readyz", timeout=5, trust_env=False).status_code == 200
    except httpx2.TransportError:
        return False


# Another user of the machine


def other_user(service: Target) -> list[Row]:
    """Code sent to every port, Dask's pages, files."""
    markers = service.folder / "markers"
    markers.mkdir(mode=0o777)
    markers.chmod(0o777)
    ports = sorted(service.ports())
    files = [str(path) for path in service.data.rglob("*") if path.is_file()]
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests" / "support" / "other_user.py"), str(OTHER)],
        input=json.dumps({"ports": ports, "markers": str(markers), "files": files}),
        capture_output=True, text=True, check=False, timeout=SECONDS,
    )  # fmt: skip
    if done.returncode:
        raise SystemExit(f"the other user's attempts failed: {done.stderr[-2000:]}")
    seen = json.loads(done.stdout)
    return [
        ("another user sends code to every port (TCP and TLS)", len(ports), len(seen["ran"])),
        ("another user asks every port but the service's for a page of Dask", len(ports) - 1,
         len(set(seen["answered"]) - {service.port})),
        ("another user reads a file of the data folder", len(files), len(seen["read"])),
    ]  # fmt: skip


def inherited(service: Target) -> Row:
    """The token in the environment or the command line of a process that the service started."""
    members = service.family()[1:]
    holding = [
        member
        for member in members
        if service.token in " ".join([*member.environ().values(), *member.cmdline()])
    ]
    return "a process started by the service holds its token", len(members), len(holding)


# Callers without a token


def without_token(service: Target) -> Row:
    wrong = [
        "",
        "auto",
        service.token[:-1],
        service.token + "x",
        service.token.swapcase(),
        "Bearer",
        "\u00e9",
    ]
    headers: list[dict[str, Any]] = [{}]
    headers += [{"Authorization": f"Bearer {text}".strip().encode()} for text in wrong]
    headers += [{"Authorization": f"Basic {service.token}"}, {"Authorization": service.token}]
    headers += [{"Cookie": f"token={service.token}"}]
    tried = [
        service.ask(method, path, headers=header).status_code
        for method, path in service.operations()
        for header in headers
    ]
    return "a request with a missing or wrong token", len(tried), sum(status != 401 for status in tried)


# Foreign web pages


FOREIGN: Sequence[dict[str, str]] = (
    {"Origin": "https://evil.example", "Sec-Fetch-Site": "cross-site"},
    {"Origin": "null"},
    {"Origin": "http://127.0.0.1:1"},
    {"Sec-Fetch-Site": "cross-site"},
    {"Sec-Fetch-Site": "same-site"},
)


def writes_of_foreign_pages(service: Target) -> Row:
    """Their requests carry the token here: a browser that kept it as a cookie would send it."""
    job = f"/v1/jobs/{service.job}"
    before, tried = service.jobs(), 0
    for headers in FOREIGN:
        for method, path in (("POST", f"{job}/cancel"), ("POST", f"{job}/resume"), ("DELETE", job)):
            service.ask(method, path, headers={**headers, **service.own})
            tried += 1
        for media_type in ("application/json", "text/plain", "application/x-www-form-urlencoded"):
            body = json.dumps({**SWEEP, "omega": 0.7})
            headers_sent = {**headers, **service.own, "Content-Type": media_type}
            service.ask("POST", "/v1/jobs", content=body, headers=headers_sent)
            tried += 1
    changed = len(set(service.jobs()) ^ set(before))
    return "a foreign page submits, cancels, resumes or deletes", tried, changed


def costly_reads_of_foreign_pages(service: Target) -> Row:
    """Pictures that a page of another origin names in `<img>`."""
    job = f"/v1/jobs/{service.job}"
    paths = (
        f"{job}/diagram?format=png",
        f"{job}/diagram",
        f"{job}/modes",
        f"{job}/export?format=nc",
    )
    sites = [{"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "no-cors"} for site in ("cross-site", "same-site")]
    tried = [
        service.ask("GET", path, headers={**headers, **service.own}).status_code
        for path in paths
        for headers in sites
    ]
    return "a foreign page has a costly answer computed", len(tried), sum(status != 403 for status in tried)


def foreign_hosts(service: Target) -> Row:
    """A page that binds its own name to 127.0.0.1 (DNS rebinding)."""
    hosts = (
        "evil.example",
        "localhost.evil.example",
        "127.0.0.1.evil.example",
        "a@localhost",
        "0.0.0.0",
        "[::1",
    )
    tried = [
        service.ask("GET", path, headers={"Host": host, **service.own}).status_code
        for host in hosts
        for path in ("/", "/v1/jobs", "/openapi.json", f"/v1/jobs/{service.job}")
    ]
    return "a request by another host name", len(tried), sum(status < 400 for status in tried)


# Hostile clients


def traversal(service: Target) -> Row:
    """Files outside a job's store or the page's folder, in every spelling of a way up, with the token."""
    spellings = "../ ..%2f %2e%2e/ %2e%2e%2f ..%5c ....// %252e%252e%252f ..;/ .%00./ %c0%ae%c0%ae/"
    ups = spellings.split()
    bases = (
        f"/v1/jobs/{service.job}/zarr/",
        f"/v1/jobs/{service.job}/zarr/outcome/",
        "/static/",
        "/static/js/",
        "/v1/jobs/",
    )
    goals = ("ledger.sqlite", tokens.FILE_NAME, "etc/passwd", "service/settings.py")
    reached = tried = 0
    for base in bases:
        for up in ups:
            for goal in goals:
                for depth in (1, 2, 3, 9):
                    request = (
                        f"GET {base}{up * depth}{goal} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n"
                    )
                    head = f"{request}Authorization: Bearer {service.token}\r\n\r\n".encode()
                    reached += any(status < 300 or status >= 500 for status in service.exchange(head))
                    tried += 1
    return "a path that leads out of its folder", tried, reached


def smuggled(service: Target) -> Row:
    """A second request hidden in the first, or a head that servers read differently: it is answered."""
    token = f"Authorization: Bearer {service.token}\r\n"
    hidden = f"GET /v1/jobs/{service.job} HTTP/1.1\r\nHost: 127.0.0.1\r\n{token}\r\n"
    start = f"POST /v1/jobs HTTP/1.1\r\nHost: 127.0.0.1\r\n{token}"
    chunked, body = "Transfer-Encoding: chunked\r\n", f"0\r\n\r\n{hidden}"
    heads = (
        f"Content-Length: {len(body)}\r\n{chunked}\r\n{body}",
        f"{chunked}Content-Length: 3\r\n\r\n{body}",
        f"Content-Length: 0\r\nContent-Length: {len(hidden)}\r\n\r\n{hidden}",
        f"Content-Length: 0, {len(hidden)}\r\n\r\n{hidden}",
        f"Content-Length: +{len(hidden)}\r\n\r\n{hidden}",
        f"Content-Length: -1\r\n\r\n{hidden}",
        f"Content-Length: 0x10\r\n\r\n{hidden}",
        f"Transfer-Encoding: xchunked\r\n\r\n{body}",
        f"Transfer-Encoding : chunked\r\n\r\n{body}",
        f"Transfer-Encoding: chunked, identity\r\n\r\n{body}",
        f"{chunked}{chunked}\r\n{body}",
        f"{chunked}\r\nffffffffffffffffffff\r\n{hidden}",
        f"{chunked}\r\n-1\r\n\r\n{hidden}",
        f"X: \x00\r\nContent-Length: 0\r\n\r\n{hidden}",
        f"X: a\nContent-Length: {len(hidden)}\r\n\r\n{hidden}",
    )
    answers = [service.exchange((start + head).encode("latin-1")) for head in heads]
    wrong = [statuses for statuses in answers if 200 in statuses or any(status >= 500 for status in statuses)]
    return "a request hidden behind an ambiguous head", len(heads), len(wrong)


def hostile_bodies(service: Target) -> Row:
    """Bodies that cost much to read, or that break what reads them: accepted, a defect, or 2 s and more."""
    bodies = (
        b"[" * 500_000, b'{"a":' * 100_000, b'{"gamma": ' + b"9" * 900_000 + b"}", b'{"gamma": 1e999999999}',
        b'{"gamma": NaN}', b'"\\ud800"', b"\xff\xfe", b'{"name": "' + b"\\u0301" * 100_000 + b'"}',
        json.dumps({**SWEEP, "gamma": [1.0] * 100_000}).encode(),
        json.dumps({**SWEEP, "x" * 900_000: 1}).encode(),
        json.dumps({**SWEEP, "gamma": {"start": 1, "stop": 2, "num": 10**18}}).encode(),
        json.dumps({**SWEEP, "model": {"kind": "__import__"}}).encode(),
        b"{" + b'"a":1,' * 150_000 + b'"a":1}',
    )  # fmt: skip
    wrong = 0
    for body in bodies:
        began = time.monotonic()
        headers = {**service.own, "Content-Type": "application/json"}
        status = service.ask("POST", "/v1/jobs", content=body, headers=headers).status_code
        wrong += not 400 <= status < 500 or time.monotonic() - began > 2.0
    return "a body that is accepted, breaks its reader, or takes longer than 2 s", len(bodies), wrong


def many_listeners(service: Target) -> Row:
    """More event streams at once than allowed: those beyond the limit get 503, all within SECONDS."""
    allowed = Settings().max_listeners
    tried = allowed + 100
    endless = {**SWEEP, "omega": 0.9, "settle": 10**7, "observe": 10**7}
    job = str(service.ask("POST", "/v1/jobs", json=endless, headers=service.own).json()["id"])
    statuses, slowest, polls = asyncio.run(
        streams_at_once(service.url, f"/v1/jobs/{job}", tried, service.own)
    )
    service.ask("POST", f"/v1/jobs/{job}/cancel", headers=service.own)
    print(
        f"{tried:,} event streams at once: {statuses[200]:,} opened, {statuses[503]:,} refused; the slowest "
        f"answer after {slowest:.1f} s; of {len(polls)} polls meanwhile the slowest took {max(polls):.2f} s",
        file=sys.stderr,
    )
    wrong = abs(statuses[200] - allowed) + abs(statuses[503] - (tried - allowed))
    return "an event stream beyond the limit is opened, or one within it is not", tried, wrong


async def streams_at_once(
    url: str, job: str, count: int, headers: Mapping[str, str]
) -> tuple[Counter[int], float, list[float]]:
    """Statuses of so many event streams of a job, seconds until the last is answered, and of polls meanwhile.

    They stay open until all are answered; 503 counts as 0 unless it says when to come again.
    """
    address = httpx2.URL(url)
    lines = [f"GET {job}/events HTTP/1.1", "Host: 127.0.0.1", *map(": ".join, headers.items())]
    head = "".join(f"{line}\r\n" for line in [*lines, ""]).encode()
    streams: list[asyncio.StreamWriter] = []

    async def open_stream() -> int:
        reader, writer = await asyncio.open_connection(address.host, address.port)
        streams.append(writer)
        writer.write(head)
        answer = await reader.readuntil(b"\r\n\r\n")
        status = int(answer.split()[1])
        if status == 200:
            await reader.readuntil(b"event: progress")
        return status if status != 503 or b"retry-after:" in answer.lower() else 0

    async def poll() -> list[float]:
        times: list[float] = []
        async with httpx2.AsyncClient(timeout=SECONDS, trust_env=False, headers=headers) as http:
            while not all(stream.done() for stream in waiting) or not times:
                began = time.monotonic()
                (await http.get(f"{url}{job}")).raise_for_status()
                times.append(time.monotonic() - began)
        return times

    began = time.monotonic()
    waiting = [asyncio.ensure_future(open_stream()) for _ in range(count)]
    polling = asyncio.ensure_future(poll())
    statuses = Counter(await asyncio.gather(*waiting))
    slowest = time.monotonic() - began
    polls = await polling
    for writer in streams:
        writer.close()
    return statuses, slowest, polls


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, help="file for the table")
    options = parser.parse_args()
    with target() as service:
        rows = other_user(service) if os.geteuid() == 0 else []
        attacks = (
            inherited, without_token, writes_of_foreign_pages, costly_reads_of_foreign_pages, foreign_hosts,
            traversal, smuggled, hostile_bodies, many_listeners,
        )  # fmt: skip
        for attack in attacks:
            rows.append(attack(service))
            print(f"{rows[-1][0]}: {rows[-1][2]} of {rows[-1][1]}", file=sys.stderr, flush=True)
        alive = service.state() == "done" and _ready(service.port)
        rows.append(("the service does not answer afterwards, or the job is not done", 1, int(not alive)))
    text = table(("attack", "tries", "succeeded"), rows)
    print(text)
    if options.output:
        options.output.write_text(text + "\n")
    sys.exit(int(any(row[2] for row in rows)))


if __name__ == "__main__":
    main()
