"""Costly requests: their turns, their memory, back-pressure, and what they leave to other requests."""

import asyncio
import contextlib
import functools
import socket
import threading
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

import pytest
from fastapi import Response
from fastapi.routing import APIRoute
from fastapi.testclient import TestClient
from prometheus_client import generate_latest
from scripted import DEADLINE, Held, wait_for
from served import FIGURE_2, computing, finished, listening, taken
from starlette.types import Message

from service.api import routers
from service.api.app import create_app
from service.api.capacity import PIECE, Capacity
from service.api.routers import views
from service.errors import Busy
from service.server.web_server import limited
from service.settings import Settings

MB = 2**20

#: Endpoints that take little whatever a caller asks for: everything else is costly.
CHEAP = {
    "/healthz", "/readyz", "/metrics", "/", "/docs", "/v1/jobs", "/v1/jobs/{job_id}", "/v1/figures",
    "/v1/jobs/{job_id}/cancel", "/v1/jobs/{job_id}/resume", "/v1/jobs/{job_id}/events",
    "/v1/jobs/{job_id}/rename",
    "/v1/jobs/{job_id}/pin", "/v1/jobs/{job_id}/unpin", "/v1/software",
}  # fmt: skip


def in_loop(test: Callable[..., Awaitable[None]]) -> Callable[..., None]:
    @functools.wraps(test)
    def run(**fixtures: Any) -> None:
        asyncio.run(asyncio.wait_for(test(**fixtures), DEADLINE))

    return run


def capacity(slots: int = 2, memory: int = 100, **options: Any) -> Capacity:
    return Capacity({"read": slots, "export": 1}, memory, **options)


@in_loop
async def test_an_answer_larger_than_the_memory_is_computed_alone():
    limits = capacity(memory=100, timeout=0.01)
    lease = await limits.acquire("read", 10**12)
    assert limits.used == 100
    with pytest.raises(Busy, match="at most 100 bytes"):
        await limits.acquire("export", 1)
    lease.keep(0)
    (await limits.acquire("export", 1)).keep(0)


@in_loop
async def test_so_many_may_wait_and_no_more():
    limits = capacity(slots=1, max_waiting=2, timeout=DEADLINE)
    lease = await limits.acquire("read", 1)
    waiting = [asyncio.ensure_future(limits.acquire("read", 1)) for _ in range(2)]
    await asyncio.sleep(0)
    refused = asyncio.ensure_future(limits.acquire("read", 1))
    await asyncio.wait([refused], timeout=1.0)
    with pytest.raises(Busy):
        refused.result()
    left = waiting.pop()
    left.cancel()  # its caller is gone, and another one may wait
    await asyncio.wait([left])
    waiting.append(asyncio.ensure_future(limits.acquire("read", 1)))
    await asyncio.sleep(0)
    assert not waiting[-1].done()
    (await limits.acquire("export", 1)).keep(0)  # has slots of its own
    for _ in range(2):
        lease.keep(0)  # counts once
    for each in waiting:
        (await each).keep(0)
    assert limits.used == 0


@pytest.mark.parametrize("why", ["refused", "gone"])
def test_those_behind_one_who_waits_no_longer_get_their_turn(why: str):
    """The first in the queue needs more memory than is free, those behind it do not."""

    @in_loop
    async def run() -> None:
        limits = capacity(slots=9, memory=100, timeout=0.01 if why == "refused" else DEADLINE)
        await limits.acquire("read", 60)
        large = asyncio.ensure_future(limits.acquire("read", 50))
        await asyncio.sleep(0)
        limits._timeout = DEADLINE
        small = asyncio.ensure_future(limits.acquire("read", 10))
        await asyncio.sleep(0)
        assert not small.done()
        if why == "gone":
            large.cancel()
        with pytest.raises((Busy, asyncio.CancelledError)):
            await large
        await asyncio.wait_for(small, DEADLINE / 4)
        assert limits.used == 70

    run()


@in_loop
async def test_the_end_of_the_service_waits_for_no_thread_and_begins_nothing():
    limits, go, began = capacity(slots=1), threading.Event(), threading.Semaphore(0)

    def hold() -> Response:
        began.release()
        go.wait(DEADLINE)
        return Response(b"x")

    first = asyncio.ensure_future((await limits.acquire("read", 1)).run(hold))
    while not began.acquire(blocking=False):
        await asyncio.sleep(0.001)
    first.cancel()  # its turn is over, its thread still computes
    with pytest.raises(asyncio.CancelledError):
        await first
    second = asyncio.ensure_future((await limits.acquire("read", 1)).run(hold))
    await asyncio.sleep(0)
    timer = threading.Timer(DEADLINE / 4, go.set)  # what waits for the thread ends, too
    timer.start()
    try:
        limits.close()
        assert not go.is_set()
        with pytest.raises(asyncio.CancelledError):
            await second
    finally:
        timer.cancel()
        go.set()
    assert not began.acquire(blocking=False)


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
    (await limits.acquire("read", 9 * MB)).keep(0)
    assert limits.used == MB
    read.set()
    await sending
    assert limits.used == 0
    assert sum(pieces) == MB
    assert max(pieces) == PIECE
    assert more[-1] is False  # without it the connection would stay open
    assert all(more[1:-1])


async def never() -> Message:
    return await asyncio.Future()


def test_every_endpoint_that_is_not_cheap_is_costly():
    """A new endpoint is one or the other: declare it `costly`, or say here why it need not be."""
    modules = [import_module(f"{routers.__name__}.{name}") for _, name, _ in iter_modules(routers.__path__)]
    routers_of = [module.router for module in modules if module is not views]
    found = (route for router in (*routers_of, *views.routes()) for route in router.routes)
    routes = [route for route in found if isinstance(route, APIRoute)]
    costly = {route.path for route in routes if hasattr(route.endpoint, "__wrapped__")}
    assert {route.path for route in routes} == costly | CHEAP
    assert not costly & CHEAP
    assert {"/v1/orbits", "/v1/trajectories", "/v1/jobs/{job_id}/diagram"} <= costly


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    with computing(tmp_path_factory.mktemp("data"), turn_seconds=0.01) as client:
        yield client


def test_small_reads_are_answered_while_every_costly_place_is_taken(client: TestClient):
    """`benchmarks/burst.py` measures how soon, beside an atlas and costly requests."""
    here = finished(client, FIGURE_2)
    small = [
        "diagram", "diagram?format=csv&every=2", "diagram?format=bin", "modes", "modes?format=bin",
        "threshold", "threshold?predict=none", "zarr/flight_time/c.0.0.0.0.0",
    ]  # fmt: skip
    with taken(client, "read", memory=2**40), ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(client.get, [f"{here}/{path}" for path in small * 8]))
        assert {answer.status_code for answer in answers} == {200}, [
            a.url.path for a in answers if a.is_error
        ]
        refused = client.get(f"{here}/diagram?format=png")
        assert (refused.status_code, refused.headers["Retry-After"]) == (429, "5")
    wait_for(lambda: client.app.state.service.small_reads.used == 0)  # type: ignore[attr-defined]


#: A request for a motion, as sent.
MOTION = (
    b"POST /v1/trajectories HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
    b'Content-Length: 40\r\n\r\n{"gamma": 2.0, "omega": 0.5, "xi": 0.26}'
)


def test_nothing_is_computed_for_clients_that_left_before_their_turn(tmp_path: Path):
    """What they asked for leaves the queue; the one that was computed gives back what it took."""
    began, go = threading.Semaphore(0), threading.Event()

    def hold(*_: object, **__: object) -> Any:
        began.release()
        go.wait(DEADLINE)
        raise Busy("enough")

    app = create_app(Settings(data=tmp_path, max_trajectories=1, turn_seconds=DEADLINE), Held())
    with pytest.MonkeyPatch.context() as patch, listening(app, limited(DEADLINE, 99)) as address:
        patch.setattr("service.views.trajectory.motion", hold)
        capacity = app.state.service.capacity
        with contextlib.ExitStack() as connections:
            for _ in range(20):
                connection = connections.enter_context(socket.create_connection(address, timeout=DEADLINE))
                connection.sendall(MOTION)
            assert began.acquire(timeout=DEADLINE)
            wait_for(lambda: capacity.waiting["trajectory"] == 19)
        wait_for(lambda: not capacity.waiting["trajectory"])
        go.set()
        wait_for(lambda: capacity.used == 0)
        assert not began.acquire(blocking=False)
        metrics = app.state.service.metrics
        left = b'route="/v1/trajectories",status="499"} 19.0'
        wait_for(lambda: left in generate_latest(metrics.registry))


def test_an_answer_that_nobody_reads_ends(tmp_path: Path):
    """The client's connection is closed, and what its answer took is free again."""
    app = create_app(Settings(data=tmp_path), Held())
    held = []

    def answer(*_: object, **__: object) -> Response:
        held.append(app.state.service.capacity.used)
        return Response(bytes(64 * MB))

    with pytest.MonkeyPatch.context() as patch, listening(app, limited(DEADLINE, 9, stall=0.2)) as address:
        patch.setattr("service.api.routers.views.Response", answer)
        capacity = app.state.service.capacity
        with socket.create_connection(address, timeout=DEADLINE) as connection:
            connection.sendall(MOTION)
            wait_for(lambda: held and capacity.used == 0)
            assert held[0] > MB
            with pytest.raises(ConnectionResetError):
                b"".join(iter(lambda: connection.recv(MB), b""))
