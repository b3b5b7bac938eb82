"""Costly requests: their turns, their memory, back-pressure, and what they leave to other requests."""

import asyncio
import contextlib
import socket
import threading
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

import pytest
from fastapi import Response
from fastapi.routing import APIRoute
from fastapi.testclient import TestClient
from scripted import DEADLINE, Held, wait_for
from served import FIGURE_2, computing, finished, listening, service, taken
from starlette.types import Message

from service.api import routers
from service.api.app import create_app
from service.api.capacity import PIECE, Capacity, Lease
from service.errors import Busy
from service.jobs.on_demand import Pending
from service.render import answers
from service.results.selection import BASE_MEMORY
from service.server.web_server import limited
from service.settings import Settings

MB = 2**20

#: Endpoints that take little whatever a caller asks for: everything else is costly.
CHEAP = {
    "/healthz", "/readyz", "/metrics", "/", "/docs", "/v1/jobs", "/v1/jobs/{job_id}", "/v1/figures",
    "/v1/jobs/{job_id}/cancel", "/v1/jobs/{job_id}/resume", "/v1/jobs/{job_id}/events",
    "/v1/jobs/{job_id}/refine", "/v1/jobs/{job_id}/pin", "/v1/jobs/{job_id}/unpin", "/v1/software",
}  # fmt: skip


def in_loop(test: Callable[[], Awaitable[None]]) -> Callable[[], None]:
    def run() -> None:
        asyncio.run(asyncio.wait_for(test(), DEADLINE))

    run.__name__ = test.__name__
    return run


def capacity(slots: int = 2, memory: int = 100, **options: Any) -> Capacity:
    return Capacity({"read": slots, "export": 1}, memory, **options)


@in_loop
async def test_a_request_beyond_the_slots_waits_its_turn():
    limits = capacity(slots=1)
    first = await limits.acquire("read", 1)
    second = asyncio.ensure_future(limits.acquire("read", 1))
    third = asyncio.ensure_future(limits.acquire("read", 1))
    await limits.acquire("export", 1)  # has slots of its own
    assert not second.done()
    first.release()
    lease = await second
    assert not third.done()
    lease.release()
    lease.release()  # counts once
    (await third).release()
    assert limits.used == 1


@in_loop
async def test_a_request_beyond_the_memory_waits_its_turn():
    limits = capacity(slots=9, memory=100)
    first, second = await limits.acquire("read", 60), await limits.acquire("export", 40)
    third = asyncio.ensure_future(limits.acquire("read", 50))
    small = asyncio.ensure_future(limits.acquire("read", 1))
    second.release()
    await asyncio.sleep(0)
    assert not third.done()
    assert not small.done()  # does not pass the one before it
    first.release()
    await asyncio.gather(third, small)
    assert limits.used == 51


@in_loop
async def test_an_answer_larger_than_the_memory_is_computed_alone():
    limits = capacity(memory=100, timeout=0.01)
    lease = await limits.acquire("read", 10**12)
    assert limits.used == 100
    with pytest.raises(Busy, match="at most 100 bytes"):
        await limits.acquire("export", 1)
    lease.release()
    (await limits.acquire("export", 1)).release()


@in_loop
async def test_who_has_waited_too_long_is_refused_and_leaves_nothing():
    limits = capacity(slots=1, timeout=0.01)
    lease = await limits.acquire("read", 1)
    with pytest.raises(Busy, match="1 diagrams, maps and tables are computed at a time"):
        await limits.acquire("read", 50)
    lease.release()
    assert limits.used == 0
    (await limits.acquire("read", 100)).release()


@in_loop
async def test_so_many_may_wait_and_no_more():
    limits = capacity(slots=1, max_waiting=2)
    lease = await limits.acquire("read", 1)
    waiting = [asyncio.ensure_future(limits.acquire("read", 1)) for _ in range(2)]
    await asyncio.sleep(0)
    with pytest.raises(Busy):
        await limits.acquire("read", 1)
    waiting[0].cancel()  # its caller is gone
    await asyncio.sleep(0)
    lease.release()
    (await waiting[1]).release()
    assert limits.used == 0


@in_loop
async def test_one_withdrawn_in_the_moment_of_its_turn_gives_it_back():
    limits = capacity(slots=1)
    lease = await limits.acquire("read", 10)
    waiting = asyncio.ensure_future(limits.acquire("read", 10))
    await asyncio.sleep(0)
    lease.release()
    waiting.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        (await waiting).release()
    assert limits.used == 0
    (await limits.acquire("read", 100)).release()


@in_loop
async def test_an_unread_answer_holds_its_bytes_and_no_thread():
    limits, read = capacity(slots=1, memory=10 * MB), asyncio.Event()
    pieces: list[int] = []
    more: list[object] = []

    async def send(message: Message) -> None:
        more.append(message.get("more_body"))
        pieces.append(len(message.get("body", b"")))
        if len(pieces) == 3:
            await read.wait()

    lease = await limits.acquire("read", 9 * MB)
    response = await lease.run(lambda: Response(bytes(MB)))
    assert limits.used == MB
    sending = asyncio.ensure_future(response({"type": "http"}, never, send))
    (await limits.acquire("read", 9 * MB)).release()
    assert limits.used == MB
    read.set()
    await sending
    assert limits.used == 0
    assert sum(pieces) == MB
    assert max(pieces) == PIECE
    assert more[-1] is False  # without it the connection would stay open
    assert all(more[1:-1])


@in_loop
async def test_an_error_gives_everything_back():
    limits = capacity()

    def fail() -> Response:
        raise ValueError

    lease: Lease = await limits.acquire("read", 50)
    with pytest.raises(ValueError):  # noqa: PT011
        await lease.run(fail)
    assert limits.used == 0

    async def broken(message: Message) -> None:
        raise OSError

    lease = await limits.acquire("read", 50)
    response = await lease.run(lambda: Response(b"x"))
    with pytest.raises(OSError):  # noqa: PT011
        await response({"type": "http"}, never, broken)
    assert limits.used == 0


async def never() -> Message:
    return await asyncio.Future()


def test_every_endpoint_that_is_not_cheap_is_costly():
    """A new endpoint is one or the other: declare it `costly`, or say here why it need not be."""
    modules = [import_module(f"{routers.__name__}.{name}") for _, name, _ in iter_modules(routers.__path__)]
    routes = [route for module in modules for route in module.router.routes if isinstance(route, APIRoute)]
    costly = {route.path for route in routes if hasattr(route.endpoint, "__wrapped__")}
    assert {route.path for route in routes} == costly | CHEAP
    assert not costly & CHEAP
    assert {"/v1/tradeoff", "/v1/trajectories", "/v1/jobs/{job_id}/diagram"} <= costly


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    with computing(tmp_path_factory.mktemp("data"), turn_seconds=0.01) as client:
        yield client


READS = ["diagram", "diagram?format=csv", "diagram?format=png", "line", "modes", "plane"]


@pytest.mark.parametrize(
    "path", [*READS, "threshold", "zarr/zarr.json", "export?format=nc", "trajectory?gamma=2"]
)
def test_a_costly_answer_gives_back_what_it_took(client: TestClient, path: str):
    here = finished(client, FIGURE_2)
    assert client.get(f"{here}/{path}").status_code == 200
    capacity = client.app.state.service.capacity  # type: ignore[attr-defined]
    wait_for(lambda: capacity.used == 0)


@pytest.mark.parametrize("path", READS)
def test_beyond_the_limit_a_read_is_told_to_come_again(client: TestClient, path: str):
    here = finished(client, FIGURE_2)
    for busy in ({"slots": 1}, {"memory": 2**40}):
        with taken(client, "read", **busy):
            refused = client.get(f"{here}/{path}")
            assert (refused.status_code, refused.headers["Retry-After"]) == (429, "5")
            assert client.get(here).status_code == 200
            assert client.get("/v1/jobs").status_code == 200
    assert client.get(f"{here}/{path}").status_code == 200


def test_costly_requests_leave_the_other_threads_alone(tmp_path: Path):
    """Of many at once a few run, the rest waits without a thread, and polls are answered meanwhile."""
    running, go = threading.Semaphore(0), threading.Event()

    def hold(*_: object, **__: object) -> Any:
        running.release()
        go.wait(DEADLINE)
        raise Busy("enough")

    with service(tmp_path, Held(), max_trajectories=2) as client, pytest.MonkeyPatch.context() as patch:
        patch.setattr("service.results.trajectory.compute", hold)
        cell = {"gamma": 2.0, "omega": 0.5, "xi": 0.26}
        ask = [
            threading.Thread(target=client.post, args=["/v1/trajectories"], kwargs={"json": cell})
            for _ in range(60)
        ]
        for thread in ask:
            thread.start()
        try:
            assert all(running.acquire(timeout=DEADLINE) for _ in range(2))
            assert client.get("/v1/jobs").status_code == 200
            assert client.get("/metrics").status_code == 200
            assert not running.acquire(blocking=False)
        finally:
            go.set()
            for thread in ask:
                thread.join()


def test_with_the_service_end_its_threads_and_what_was_asked_of_workers(tmp_path: Path):
    def costly() -> set[threading.Thread]:
        return {thread for thread in threading.enumerate() if thread.name.startswith("costly-")}

    before, asked = costly(), Future[Any]()
    with computing(tmp_path) as client:
        assert client.get(f"{finished(client, FIGURE_2)}/diagram").status_code == 200
        threads = costly() - before
        on_demand = client.app.state.service.on_demand  # type: ignore[attr-defined]
        with pytest.raises(Pending):
            on_demand.get("never computed", lambda _: [asked])
    assert threads
    wait_for(lambda: not threads & costly())
    assert asked.cancelled()


def test_a_burst_of_costly_requests_stays_within_its_limits(tmp_path: Path):
    """`benchmarks/burst.py` measures a larger one, with its times."""
    most, threads = 0, threading.Semaphore(2)
    with computing(tmp_path, turn_seconds=0.5, max_reads=2, answer_memory=3 * BASE_MEMORY) as client:
        here = finished(client, FIGURE_2)
        capacity = client.app.state.service.capacity  # type: ignore[attr-defined]
        with pytest.MonkeyPatch.context() as patch, ThreadPoolExecutor(24) as pool:
            patch.setattr(answers, "diagram", partial(_counted, answers.diagram, threads))
            paths = [f"{here}/diagram?format={format}" for format in ("png", "json", "csv")] * 16
            sent = [pool.submit(client.get, path) for path in paths]
            while not all(answer.done() for answer in sent):
                most = max(most, capacity.used)
                assert client.get(here).status_code == 200
        statuses = Counter(answer.result().status_code for answer in sent)
        assert set(statuses) <= {200, 429}
        assert statuses[200] >= 2
        assert 0 < most <= 3 * BASE_MEMORY
        wait_for(lambda: capacity.used == 0)


def _counted(compute: Callable[..., Any], threads: threading.Semaphore, *arguments: Any) -> Any:
    assert threads.acquire(blocking=False), "more threads compute than allowed"
    try:
        return compute(*arguments)
    finally:
        threads.release()


def test_nothing_is_computed_for_clients_that_left_before_their_turn(tmp_path: Path):
    """What they asked for leaves the queue; the one that was computed gives back what it took."""
    began, go = threading.Semaphore(0), threading.Event()

    def hold(*_: object, **__: object) -> Any:
        began.release()
        go.wait(DEADLINE)
        raise Busy("enough")

    app = create_app(Settings(data=tmp_path, max_trajectories=1, turn_seconds=DEADLINE), Held())
    body = b'{"gamma": 2.0, "omega": 0.5, "xi": 0.26}'
    request = (
        b"POST /v1/trajectories HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        b"Content-Length: %d\r\n\r\n%s" % (len(body), body)
    )
    with pytest.MonkeyPatch.context() as patch, listening(app, limited(DEADLINE, 99)) as address:
        patch.setattr("service.results.trajectory.compute", hold)
        capacity = app.state.service.capacity
        with contextlib.ExitStack() as connections:
            for _ in range(20):
                connection = connections.enter_context(socket.create_connection(address, timeout=DEADLINE))
                connection.sendall(request)
            assert began.acquire(timeout=DEADLINE)
            wait_for(lambda: len(capacity._waiting["trajectory"]) == 19)
        wait_for(lambda: not capacity._waiting["trajectory"])
        go.set()
        wait_for(lambda: capacity.used == 0)
        assert not began.acquire(blocking=False)


def test_an_answer_that_nobody_reads_ends(tmp_path: Path):
    """The client's connection is closed, and what its answer took is free again."""
    app = create_app(Settings(data=tmp_path), Held())
    with pytest.MonkeyPatch.context() as patch, listening(app, limited(DEADLINE, 9, stall=0.2)) as address:
        patch.setattr("service.api.routers.model.Response", lambda *_, **__: Response(bytes(64 * MB)))
        capacity = app.state.service.capacity
        body = b'{"gamma": 2.0, "omega": 0.5, "xi": 0.26}'
        request = (
            b"POST /v1/trajectories HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
            b"Content-Length: %d\r\n\r\n%s" % (len(body), body)
        )
        with socket.create_connection(address, timeout=DEADLINE) as connection:
            connection.sendall(request)
            wait_for(lambda: capacity.used > MB)
            wait_for(lambda: capacity.used == 0)
            assert len(b"".join(iter(lambda: connection.recv(MB), b""))) < 64 * MB
