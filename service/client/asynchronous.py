"""The same client for `async` programs: every method that sends a request is a coroutine.

Requests are sent by threads, with the connections of one `Client`, so that both clients have one
implementation. Waiting takes no thread.
"""

import asyncio
import inspect
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable
from functools import update_wrapper
from itertools import islice
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self, TypeVar

from service.client.client import DEFAULT_URL, Client
from service.client.display import PartsCallback, display_job, display_parts, job_html, summary
from service.client.job import FIRST_DELAY, MAX_DELAY, Job, raise_unless_done
from service.client.models import JobStatus
from service.client.specification import Specification

if TYPE_CHECKING:
    import httpx2


#: Jobs of one wait whose status is requested at a time.
_REQUESTS: Final = 4

#: Methods that waits are built from, and that programs do not call.
_BLOCKING: Final = frozenset({"from_view", "has_ended", "pause", "refresh_through_outage"})

Mirror = TypeVar("Mirror", bound=type)


def _mirroring(blocking: type) -> Callable[[Mirror], Mirror]:
    """Give a class the public methods of `blocking` that it lacks, as coroutines or async iterators."""

    def declare(mirror: Mirror) -> Mirror:
        for name, method in inspect.getmembers(blocking, inspect.isfunction):
            if not name.startswith("_") and name not in _BLOCKING and name not in vars(mirror):
                iterates = inspect.isgeneratorfunction(method)
                setattr(mirror, name, (_iterated if iterates else _in_thread)(method))
        return mirror

    return declare


def _in_thread(method: Callable[..., Any]) -> Callable[..., Any]:
    async def call(self: Any, /, *args: Any, **options: Any) -> Any:
        return _mirrored(self, await asyncio.to_thread(method, self.sync, *args, **options))

    return update_wrapper(call, method)


def _iterated(method: Callable[..., Any]) -> Callable[..., Any]:
    async def call(self: Any, /, *args: Any, **options: Any) -> AsyncIterator[Any]:
        found = method(self.sync, *args, **options)
        while (each := await asyncio.to_thread(next, found, None)) is not None:
            yield _mirrored(self, each)

    return update_wrapper(call, method)


def _mirrored(owner: Any, result: Any) -> Any:
    """`result`; a job as an `AsyncJob`, the owner's own as the owner, with the status of now."""
    if result is owner.sync and isinstance(owner, AsyncJob):
        owner._update(owner.sync.view)
        return owner
    return AsyncJob(result) if isinstance(result, Job) else result


@_mirroring(Job)
class AsyncJob(JobStatus):
    """A `Job` whose requests are awaited; `sync` is the same job with blocking methods."""

    if TYPE_CHECKING:  # the methods of Job, as coroutines

        def __getattr__(self, name: str) -> Callable[..., Any]: ...

    def __init__(self, job: Job) -> None:
        self.sync = job
        self._update(job.view)

    async def spec(self) -> dict[str, Any]:
        """The specification with its defaults, as `Job.spec`: a method, as it may send a request."""
        return await asyncio.to_thread(lambda: self.sync.spec)

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

    def __repr__(self) -> str:
        return f"<AsyncJob {summary(self)}>"

    def _repr_html_(self) -> str:
        return job_html(self)


@_mirroring(Client)
class AsyncClient:
    """A client of a running service for `async` programs, with the methods and arguments of `Client`.

        async with AsyncClient() as client:
            job = await client.submit("sweep.toml")
            diagram = await (await job.wait()).diagram()

    `sync` is the blocking client that sends its requests.
    """

    if TYPE_CHECKING:  # the methods of Client, as coroutines

        def __getattr__(self, name: str) -> Callable[..., Any]: ...

    def __init__(
        self,
        url: str = DEFAULT_URL,
        token: str | None = None,
        timeout: float = 30.0,
        *,
        http: "httpx2.Client | None" = None,
    ) -> None:
        self.sync = Client(url, token, timeout, http=http)

    @property
    def url(self) -> str:
        """The address of the service."""
        return self.sync.url

    @property
    def page(self) -> str:
        """As `Client.page`."""
        return self.sync.page

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
