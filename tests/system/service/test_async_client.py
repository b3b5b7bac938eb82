"""The client for async programs: the same answers, and a loop that goes on meanwhile."""

import asyncio
import inspect
import json
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import xarray
from answering import ID, Answer, Server, scripted, view
from scripted import Held, sweep

from service.client import (
    AsyncClient,
    AsyncJob,
    BadRequest,
    Client,
    Job,
    JobCancelled,
    JobFailed,
    WaitTimeout,
)
from service.server import embedded
from worker.executors.inline import Inline

LINE: dict[str, Any] = {
    "gamma": {"start": 0.6, "stop": 1.6, "num": 11}, "omega": 0.5, "xi": 0.26,
    "model": {"kind": "rigid"}, "settle": 40, "observe": 20, "keep": 8,
}  # fmt: skip


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    executor = Inline()
    settings = embedded.settings(data=tmp_path_factory.mktemp("data"), port=0, heartbeat_seconds=0.2)
    with embedded.running(settings, executor) as address:
        yield address
    executor.close()


@pytest.fixture
def held(tmp_path: Path) -> Iterator[str]:
    """A service whose jobs never end."""
    settings = embedded.settings(data=tmp_path, port=0, active_jobs=1)
    with embedded.running(settings, Held()) as address:
        yield address


def test_answers_are_those_of_the_other_client(address: str, tmp_path: Path):
    async def program() -> None:
        async with AsyncClient(address) as client:
            job = await (await client.submit(LINE)).wait(progress=False)
            shown: list[str] = []
            await job.wait(progress=lambda status: shown.append(status.state))
            assert shown == ["done"]
            same = client.sync.job(job.id)
            xarray.testing.assert_identical(await job.diagram(), same.diagram())
            xarray.testing.assert_identical(
                await client.threshold(0.6, 0.05), client.sync.threshold(0.6, 0.05)
            )
            assert (await job.export(tmp_path / "a.nc")).exists()
            assert (await job.spec())["omega"] == 0.5
            assert (await client.job(job.id[:8])).id == job.id
            assert [found.id async for found in client.jobs("done")].count(job.id) == 1
            assert (await job.plot(along="gamma")).get_xlabel()
            with pytest.raises(BadRequest, match="omega"):
                await client.submit({**LINE, "omega": -1})
            assert f"{job!r}".startswith(f"<AsyncJob {job.id[:8]}")

    asyncio.run(program())


def test_many_jobs(address: str):
    async def program() -> None:
        async with AsyncClient(address) as client:
            specs = [{**LINE, "xi": xi} for xi in (0.1, 0.2, 0.3, 0.4)]
            mapped = [job async for job in client.map(specs, at_once=2)]
            assert [(await job.spec())["xi"] for job in mapped] == [0.1, 0.2, 0.3, 0.4]
            again = [await client.submit(spec) for spec in specs]
            assert {job.id async for job in client.as_completed(again)} == {job.id for job in mapped}
            counts: list[tuple[int, int]] = []
            done = await client.wait_all(again, progress=lambda *count: counts.append(count))
            assert [job.state for job in done] == ["done"] * 4
            assert counts[-1] == (4, 4)
            with pytest.raises(ValueError, match="at_once"):
                await anext(client.map(specs, at_once=0))

    asyncio.run(program())


def test_the_loop_goes_on_while_a_job_is_waited_for(held: str):
    async def program() -> None:
        async with AsyncClient(held) as client:
            job = await client.submit(sweep("never ends"))
            ticks = 0

            async def tick() -> None:
                nonlocal ticks
                while True:
                    await asyncio.sleep(0.01)
                    ticks += 1

            ticking = asyncio.create_task(tick())
            with pytest.raises(WaitTimeout):
                await job.wait(progress=False, timeout=1.0)
            assert ticks >= 20
            with pytest.raises(WaitTimeout):
                await client.wait_all([job], timeout=0.1, progress=False)
            waiting = asyncio.create_task(job.wait(progress=False))
            await asyncio.sleep(0.05)
            waiting.cancel()  # ends the wait at once, and not the job
            with pytest.raises(asyncio.CancelledError):
                await waiting
            assert (await job.refresh()).state == "running"
            waits = await client.submit(sweep("waits", xi=0.3))
            assert (await waits.cancel()).state == "cancelled"
            with pytest.raises(JobCancelled):
                await waits.wait(progress=False)
            ticking.cancel()

    asyncio.run(program())


# Against a scripted server


@asynccontextmanager
async def asking(*script: Answer) -> AsyncIterator[tuple[Server, AsyncClient]]:
    with scripted(*script) as (server, client):
        async with AsyncClient(client.url) as asynchronous:
            yield server, asynchronous


def listed(client: AsyncClient, *states: str) -> list[AsyncJob]:
    return [AsyncJob(Job.from_view(client.sync._transport, view(state))) for state in states]


def test_what_is_done_to_a_job_is_what_the_service_says():
    async def program() -> None:
        calls = ("refresh", "cancel", "pin", "unpin", "resume")
        script = [Answer(body=view() | {"pinned": call == "pin"}) for call in calls]
        async with asking(*script, Answer(202, view() | {"id": "f" * 32})) as (server, client):
            (job,) = listed(client, "done")
            for call in calls:
                assert await getattr(job, call)() is job
                assert (job.state, job.pinned) == ("running", call == "pin")
            assert ((await job.refine()).id, job.id) == ("f" * 32, ID)
            paths = [path.removeprefix(f"/v1/jobs/{ID}").strip("/") for _, path, _ in server.requests]
            assert paths == ["", "cancel", "pin", "unpin", "resume", "refine"]
            assert job._repr_html_() == job.sync._repr_html_()
            assert (client.url, client.page) == (client.sync.url, client.sync.page)
            assert repr(client) == f"<AsyncClient {client.url}>"

    asyncio.run(program())


def test_changes_are_followed():
    events = [b"event: x\n", *(b"data: " + json.dumps(view(state)).encode() for state in ("queued", "done"))]

    async def program() -> None:
        async with asking(Answer(200, b"\n\n".join([*events, b""]))) as (_, client):
            (job,) = listed(client, "queued")
            assert [(now is job, now.state) async for now in job.follow()] == [
                (True, "queued"),
                (True, "done"),
            ]

    asyncio.run(program())


def test_a_wait_shows_each_status_at_the_interval_of_the_service(monkeypatch: pytest.MonkeyPatch):
    from service.client import asynchronous as module

    pauses: list[float] = []

    async def sleep(seconds: float) -> None:
        pauses.append(seconds)

    names = {name: getattr(asyncio, name) for name in ("to_thread", "Semaphore")}
    monkeypatch.setattr(module, "asyncio", SimpleNamespace(sleep=sleep, **names))

    async def program() -> None:
        script = [Answer(200, view("running", 1), Retry_After="0.5"), *[Answer(body=view())] * 30]
        async with asking(*script, Answer(200, view("done", 10))) as (_, client):
            (job,) = listed(client, "queued")
            shown: list[tuple[str, int]] = []
            show = shown.append
            assert await job.wait(progress=lambda now: show((now.state, now.progress.cells_done))) is job
            assert shown[:3] == [("queued", 0), ("running", 1), ("running", 0)]
            assert (len(shown), shown[-1]) == (33, ("done", 10))

    asyncio.run(program())
    first, asked_for, *later = pauses
    assert (first, asked_for, later[-1]) == (0.05, 0.5, 2.0)
    assert later == sorted(later)
    assert all(after <= 1.2 * before for before, after in pairwise(later))  # an end is soon seen


def test_a_wait_goes_on_with_the_job_that_takes_the_place_of_one():
    async def program() -> None:
        async with asking(Answer(body=view("done", 10) | {"id": "f" * 32})) as (_, client):
            replaced = view("failed") | {"replaced_by": "f" * 32}
            job = AsyncJob(Job.from_view(client.sync._transport, replaced))
            await job.wait(progress=False)
            assert (job.id, job.state) == ("f" * 32, "done")

    asyncio.run(program())


def test_ended_jobs_are_returned_however_they_ended():
    async def program() -> None:
        async with asking() as (_, client):
            jobs = listed(client, "failed", "done", "cancelled")
            assert {job async for job in client.as_completed(jobs)} == set(jobs)
            seen: list[tuple[int, int]] = []
            with pytest.raises(JobFailed) as caught:
                await client.wait_all(jobs, progress=lambda *count: seen.append(count))
            assert caught.value.job is jobs[0]
            assert seen == [(0, 3), (1, 3), (2, 3), (3, 3)]
            assert await client.wait_all([jobs[1]], progress=False) == [jobs[1]]

    asyncio.run(program())


def test_a_wait_for_several_ends_at_its_timeout_and_leaves_nothing_behind():
    async def program() -> None:
        async with asking() as (_, client):
            done, running = listed(client, "done", "running")
            ended = client.as_completed([done, running])
            assert await anext(ended) is done
            await ended.aclose()
            with pytest.raises(WaitTimeout):
                [job async for job in client.as_completed([running], timeout=0.0)]
            await asyncio.sleep(0)  # what is cancelled ends at the loop's next turn
            assert asyncio.all_tasks() == {asyncio.current_task()}

    asyncio.run(program())


def test_specifications_are_mapped_few_at_once():
    async def program() -> None:
        taken: list[int] = []

        def specs() -> Iterator[dict[str, int]]:
            for n in range(3):
                taken.append(n)
                yield {"xi": n}

        async with asking(*[Answer(200, view("done"))] * 6) as (_, client):
            assert [len(taken) async for _ in client.map(specs(), at_once=1)] == [1, 2, 3]
            taken.clear()
            assert [len(taken) async for _ in client.map(specs(), at_once=2)] == [2, 3, 3]

    asyncio.run(program())


def test_the_connections_are_closed_with_the_client():
    async def program() -> None:
        async with AsyncClient("http://127.0.0.1:9") as client:
            assert not client.sync._transport._http.is_closed
        assert client.sync._transport._http.is_closed

    asyncio.run(program())


@pytest.mark.parametrize(("asynchronous", "blocking"), [(AsyncClient, Client), (AsyncJob, Job)])
def test_both_clients_have_the_same_methods(asynchronous: type, blocking: type):
    def methods(kind: type) -> dict[str, list[str]]:
        return {
            name: list(inspect.signature(value).parameters)[1:]
            for name, value in inspect.getmembers(kind, callable)
            if not name.startswith("_")
        }

    ours, theirs = methods(asynchronous), methods(blocking)
    internal = {"from_view", "has_ended", "pause", "refresh_through_outage"}
    assert set(theirs) - set(ours) <= internal
    assert set(ours) - set(theirs) <= {"spec"}  # a property of the blocking one
    differing = {name for name in set(ours) & set(theirs) if ours[name] != theirs[name]}
    assert differing <= {"plot", "jobs"}  # the rest of their arguments are passed on
