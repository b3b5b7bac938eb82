"""The client for async programs: the same answers, and a loop that goes on meanwhile."""

import asyncio
import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import xarray
from scripted import Held, sweep
from served import computing_at

from service.client import (
    AsyncClient,
    AsyncJob,
    BadRequest,
    Client,
    Job,
    JobCancelled,
    WaitTimeout,
)
from service.server import embedded
from service.settings import read_settings

LINE: dict[str, Any] = {
    "gamma": {"start": 0.6, "stop": 1.6, "num": 11}, "omega": 0.5, "xi": 0.26,
    "model": {"kind": "rigid"}, "settle": 40, "observe": 20, "keep": 8,
}  # fmt: skip


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with computing_at(tmp_path_factory.mktemp("data")) as address:
        yield address


@pytest.fixture
def held(tmp_path: Path) -> Iterator[str]:
    """A service whose jobs never end."""
    settings = read_settings(data=tmp_path, port=0, active_jobs=1)
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
            assert [now.state async for now in job.follow()] == ["done"]
            assert await job.pin() is job
            assert job.pinned

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
            ended = client.as_completed([waits, job], timeout=0.1)
            assert await anext(ended) is waits
            with pytest.raises(WaitTimeout):
                await anext(ended)
            ticking.cancel()
            await asyncio.sleep(0)  # what is cancelled ends at the loop's next turn
            assert asyncio.all_tasks() == {asyncio.current_task()}

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
    assert set(theirs) <= set(ours)
    assert set(ours) - set(theirs) <= {"spec"}  # a property of the blocking one
    differing = {name for name in set(ours) & set(theirs) if ours[name] != theirs[name]}
    assert differing <= {"plot", "jobs"}  # the rest of their arguments are passed on
