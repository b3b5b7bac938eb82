"""The same client for `async` programs: every method that sends a request is a coroutine.

Requests are sent by threads, with the connections of one `Client`, so that both clients have one
implementation. Waiting takes no thread.
"""

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable
from functools import update_wrapper
from itertools import islice
from types import TracebackType
from typing import TYPE_CHECKING, Any, Concatenate, Final, ParamSpec, Protocol, Self, TypeVar

from service.client.client import DEFAULT_URL, Client
from service.client.display import PartsCallback, display_job, display_parts, job_html, summary
from service.client.job import FIRST_DELAY, MAX_DELAY, Job, raise_unless_done
from service.client.models import JobStatus
from service.client.specification import Specification

if TYPE_CHECKING:
    import httpx2
    from matplotlib.axes import Axes

    from service.client.plots import Kind

#: Jobs of one wait whose status is requested at a time.
_REQUESTS: Final = 4

Sync_co = TypeVar("Sync_co", covariant=True)
Blocking = TypeVar("Blocking")
Arguments = ParamSpec("Arguments")
Answer = TypeVar("Answer")


class _Wrapper(Protocol[Sync_co]):
    @property
    def sync(self) -> Sync_co: ...


def _in_thread(
    method: Callable[Concatenate[Blocking, Arguments], Answer],
) -> Callable[Concatenate[_Wrapper[Blocking], Arguments], Coroutine[Any, Any, Answer]]:
    """The method of the blocking object as a coroutine."""

    async def call(self: _Wrapper[Blocking], /, *args: Arguments.args, **options: Arguments.kwargs) -> Answer:
        return await asyncio.to_thread(method, self.sync, *args, **options)

    update_wrapper(call, method)
    return call


class AsyncJob(JobStatus):
    """A `Job` whose requests are awaited; `sync` is the same job with blocking methods."""

    def __init__(self, job: Job) -> None:
        self.sync = job
        self._update(job.view)

    diagram = _in_thread(Job.diagram)
    threshold = _in_thread(Job.threshold)
    orbits = _in_thread(Job.orbits)
    modes = _in_thread(Job.modes)
    result = _in_thread(Job.result)
    result_file = _in_thread(Job.result_file)
    basins = _in_thread(Job.basins)
    multistability = _in_thread(Job.multistability)
    multistability_picture = _in_thread(Job.multistability_picture)
    trajectory = _in_thread(Job.trajectory)
    export = _in_thread(Job.export)
    open = _in_thread(Job.open)
    delete = _in_thread(Job.delete)

    async def refresh(self) -> "AsyncJob":
        """As `Job.refresh`."""
        return await self._change(self.sync.refresh)

    async def cancel(self) -> "AsyncJob":
        """As `Job.cancel`."""
        return await self._change(self.sync.cancel)

    async def pin(self) -> "AsyncJob":
        """As `Job.pin`."""
        return await self._change(self.sync.pin)

    async def unpin(self) -> "AsyncJob":
        """As `Job.unpin`."""
        return await self._change(self.sync.unpin)

    async def resume(self) -> "AsyncJob":
        """As `Job.resume`."""
        return await self._change(self.sync.resume)

    async def spec(self) -> dict[str, Any]:
        """The specification with its defaults, as `Job.spec`: a method, as it may send a request."""
        return await asyncio.to_thread(lambda: self.sync.spec)

    async def refine(
        self,
        gamma: tuple[float, float] | None = None,
        omega: tuple[float, float] | None = None,
        xi: float | None = None,
        *,
        finer: int = 4,
        by: str = "mode",
        margin: bool = False,
    ) -> "AsyncJob":
        """As `Job.refine`."""
        refine = self.sync.refine
        return AsyncJob(await asyncio.to_thread(refine, gamma, omega, xi, finer=finer, by=by, margin=margin))

    async def plot(self, kind: "Kind | None" = None, **selection: Any) -> "Axes":
        """As `Job.plot`."""
        return await asyncio.to_thread(self.sync.plot, kind, **selection)

    async def follow(self) -> "AsyncIterator[AsyncJob]":
        """As `Job.follow`."""
        changes = self.sync.follow()
        while await asyncio.to_thread(next, changes, None) is not None:
            self._update(self.sync.view)
            yield self

    async def wait(
        self, progress: "bool | Callable[[AsyncJob], None]" = True, timeout: float | None = None
    ) -> "AsyncJob":
        """As `Job.wait`."""
        with display_job(progress) as show:
            await self._wait_for_end(timeout, show)
        raise_unless_done(self, timeout)
        return self

    async def _wait_for_end(
        self,
        timeout: float | None,
        show: "Callable[[AsyncJob], None]" = lambda job: None,
        requests: asyncio.Semaphore | None = None,
    ) -> "AsyncJob":
        """Wait until the job has ended, or for `timeout` seconds."""
        requests = requests or asyncio.Semaphore()
        deadline = time.monotonic() + (float("inf") if timeout is None else timeout)
        delay = FIRST_DELAY
        show(self)
        while not await asyncio.to_thread(self.sync.has_ended) and (left := deadline - time.monotonic()) > 0:
            await asyncio.sleep(min(self.sync.pause(delay), left))
            delay = min(delay * 1.15, MAX_DELAY)
            async with requests:
                await asyncio.to_thread(self.sync.refresh_through_outage)
            self._update(self.sync.view)
            show(self)
        self._update(self.sync.view)
        return self

    async def _change(self, method: Callable[[], Job]) -> "AsyncJob":
        await asyncio.to_thread(method)
        self._update(self.sync.view)
        return self

    def __repr__(self) -> str:
        return f"<AsyncJob {summary(self)}>"

    def _repr_html_(self) -> str:
        return job_html(self)


class AsyncClient:
    """A client of a running service for `async` programs, with the methods and arguments of `Client`.

        async with AsyncClient() as client:
            job = await client.submit("sweep.toml")
            diagram = await (await job.wait()).diagram()

    `sync` is the blocking client that sends its requests.
    """

    def __init__(
        self,
        url: str = DEFAULT_URL,
        token: str | None = None,
        timeout: float = 30.0,
        *,
        http: "httpx2.Client | None" = None,
    ) -> None:
        self.sync = Client(url, token, timeout, http=http)

    estimate = _in_thread(Client.estimate)
    threshold = _in_thread(Client.threshold)
    orbits = _in_thread(Client.orbits)
    curves = _in_thread(Client.curves)
    trajectory = _in_thread(Client.trajectory)
    result = _in_thread(Client.result)
    result_file = _in_thread(Client.result_file)
    metrics = _in_thread(Client.metrics)

    @property
    def url(self) -> str:
        """The address of the service."""
        return self.sync.url

    @property
    def page(self) -> str:
        """As `Client.page`."""
        return self.sync.page

    async def submit(self, spec: Specification, *, key: str | None = None) -> AsyncJob:
        """As `Client.submit`."""
        return AsyncJob(await asyncio.to_thread(self.sync.submit, spec, key=key))

    async def job(self, id: str) -> AsyncJob:
        """As `Client.job`."""
        return AsyncJob(await asyncio.to_thread(self.sync.job, id))

    async def jobs(self, state: str | None = None, **wanted: Any) -> AsyncIterator[AsyncJob]:
        """As `Client.jobs`, with the same arguments."""
        jobs = self.sync.jobs(state, **wanted)
        while (job := await asyncio.to_thread(next, jobs, None)) is not None:
            yield AsyncJob(job)

    async def as_completed(
        self, jobs: Iterable[AsyncJob], timeout: float | None = None
    ) -> AsyncIterator[AsyncJob]:
        """As `Client.as_completed`."""
        requests = asyncio.Semaphore(_REQUESTS)
        waits = [asyncio.create_task(job._wait_for_end(timeout, requests=requests)) for job in jobs]
        try:
            for wait in asyncio.as_completed(waits):
                job = await wait
                if not job.finished:
                    raise_unless_done(job, timeout)
                yield job
        finally:
            for wait in waits:
                wait.cancel()

    async def wait_all(
        self,
        jobs: Iterable[AsyncJob],
        timeout: float | None = None,
        progress: bool | PartsCallback = True,
    ) -> list[AsyncJob]:
        """As `Client.wait_all`."""
        jobs = list(jobs)
        show = display_parts(progress, "ended", "jobs")
        ended = 0
        show(ended, len(jobs))
        async for _ in self.as_completed(jobs, timeout):
            ended += 1
            show(ended, len(jobs))
        for job in jobs:
            raise_unless_done(job, timeout)
        return jobs

    async def map(self, specs: Iterable[Specification], *, at_once: int = 16) -> AsyncIterator[AsyncJob]:
        """As `Client.map`."""
        if at_once < 1:
            raise ValueError(f"at_once: must be at least 1, not {at_once}")
        remaining, submitted = iter(specs), deque[AsyncJob]()
        while True:
            for spec in islice(remaining, at_once - len(submitted)):
                submitted.append(await self.submit(spec))
            if not submitted:
                return
            yield await submitted.popleft()._wait_for_end(None)

    async def close(self) -> None:
        """Close the connections. Jobs continue."""
        await asyncio.to_thread(self.sync.close)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        await self.close()

    def __repr__(self) -> str:
        return f"<AsyncClient {self.url}>"
