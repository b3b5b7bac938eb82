"""Many who listen to the events of jobs, and requests at the shutdown."""

import asyncio
import json
import threading
import time
from collections import Counter
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import httpx2
import pytest
from scripted import DEADLINE, Held, sweep, wait_for
from served import service_at

from service.api import app as application
from service.jobs.on_demand import OnDemandCache
from service.settings import Settings

SWEEP: dict[str, Any] = {**sweep().as_submitted(), "name": "small"}


def events(text: str) -> list[tuple[str, dict[str, Any]]]:
    blocks = [block.split("\n") for block in text.strip().split("\n\n") if not block.startswith(":")]
    return [
        (block[0].removeprefix("event: "), json.loads(block[1].removeprefix("data: "))) for block in blocks
    ]


async def statuses_at_once(url: str, job: str, count: int) -> Counter[int]:
    """Statuses of event streams, all open until the last is answered; 503 without Retry-After counts as 0."""
    address = httpx2.URL(url)
    head = f"GET {job}/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode()
    streams: list[asyncio.StreamWriter] = []

    async def opened() -> int:
        reader, writer = await asyncio.open_connection(address.host, address.port)
        streams.append(writer)
        writer.write(head)
        answer = await reader.readuntil(b"\r\n\r\n")
        status = int(answer.split()[1])
        if status == 200:
            await reader.readuntil(b"event: progress")
        return status if status != 503 or b"retry-after:" in answer.lower() else 0

    statuses = Counter(await asyncio.gather(*(opened() for _ in range(count))))
    for writer in streams:
        writer.close()
    return statuses


def test_many_listeners_do_not_delay_other_requests(tmp_path: Path):
    held, listeners = Held(), 45  # more than threads that answer
    heard: list[str] = []
    listening: list[str] = []

    def listen(here: str) -> None:
        with many.stream("GET", f"{here}/events") as answer:
            lines = answer.iter_lines()
            listening.append(first := next(lines))
            heard.append("\n".join([first, *lines]))

    limits = httpx2.Limits(max_connections=listeners)
    with (
        service_at(tmp_path, held) as address,
        httpx2.Client(base_url=address, timeout=DEADLINE) as client,
        httpx2.Client(base_url=address, timeout=DEADLINE, limits=limits) as many,
    ):
        here = client.post("/v1/jobs", json=SWEEP).headers["Location"]
        wait_for(held.held)
        threads = [threading.Thread(target=listen, args=[here]) for _ in range(listeners)]
        for thread in threads:
            thread.start()
        wait_for(lambda: len(listening) == listeners)
        for _ in range(20):  # while the listeners wait for a change
            assert client.get(here).status_code == 200
        assert client.get("/metrics").status_code == 200
        held.let_go_until(lambda: client.get(here).json()["state"] == "done")
        for thread in threads:
            thread.join(DEADLINE)
    assert len(heard) == listeners
    for stream in map(events, heard):
        names = [name for name, _ in stream]
        assert names[-1] == "end"
        assert set(names[:-1]) <= {"progress"}
        done = [view["percent"] for _, view in stream]
        assert done == sorted(done)
        assert {*stream[0][1]} == {"state", "percent", "seconds_left", "compiling"}
        assert stream[-1][1]["state"] == "done"


def test_listeners_are_limited_and_do_not_delay_the_shutdown(tmp_path: Path):
    with httpx2.Client(timeout=DEADLINE) as client, ExitStack() as listening:
        with service_at(tmp_path, Held(), max_listeners=1, shutdown_seconds=1000) as address:
            here = address + client.post(f"{address}/v1/jobs", json=SWEEP).headers["Location"]
            lines = listening.enter_context(client.stream("GET", f"{here}/events")).iter_lines()
            assert next(lines) == "event: progress"
            refused = client.get(f"{here}/events")
            assert (refused.status_code, int(refused.headers["Retry-After"]) > 0) == (503, True)
            assert "at most 1 at a time; poll the job" in refused.json()["detail"]
            began = time.monotonic()
        assert time.monotonic() - began < DEADLINE  # and does not wait shutdown_seconds for the open response


def test_a_request_that_outlasts_the_shutdown_is_told_to_come_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(application, "OnDemandCache", partial(OnDemandCache, timeout=DEADLINE))
    asked, executor = threading.Event(), Held()
    monkeypatch.setattr(executor, "call", lambda *_: asked.set() or Future())
    with ThreadPoolExecutor(1) as client:
        with service_at(tmp_path, executor, shutdown_seconds=0.1) as address:
            path = f"{address}/v1/orbits?omega=0.6&xi=0.05&model=soft"
            waiting = client.submit(httpx2.get, path, timeout=DEADLINE)
            assert asked.wait(DEADLINE)
        answer = waiting.result()
    assert (answer.status_code, int(answer.headers["Retry-After"]) > 0) == (503, True)
    assert answer.json()["detail"] == "the service stops: repeat the request"


def test_of_more_listeners_than_allowed_the_others_are_told_to_come_again(tmp_path: Path):
    """At once, with the limit as it is: nobody waits for a place, and every place is free afterwards."""
    allowed = Settings().max_listeners
    with service_at(tmp_path, Held()) as address, httpx2.Client(base_url=address, timeout=DEADLINE) as client:
        here = client.post("/v1/jobs", json=SWEEP).headers["Location"]

        def statuses(count: int) -> Counter[int]:
            return asyncio.run(statuses_at_once(address, here, count))

        assert statuses(allowed + 100) == {200: allowed, 503: 100}
        wait_for(lambda: statuses(allowed) == {200: allowed})
