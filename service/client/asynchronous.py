"""The same client for `async` programs: every method that sends a request is a coroutine.

Requests are sent by threads, with the connections of one `Client`, so that both clients have one
implementation. Waiting takes no thread.
"""

import asyncio
import inspect
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from contextlib import suppress
from functools import update_wrapper
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar

from service.client.client import DEFAULT_URL, Client
from service.client.display import PartsCallback, job_html, summary
from service.client.job import Job, all_done, until_ended
from service.client.models import JobStatus
from service.client.specification import Specification

if TYPE_CHECKING:
    import httpx2

Mirror = TypeVar("Mirror", bound=type)


def _mirroring(blocking: type) -> Callable[[Mirror], Mirror]:
    """Give a class the public methods of `blocking` that it lacks, as coroutines or async iterators."""

    def declare(mirror: Mirror) -> Mirror:
        for name, method in inspect.getmembers(blocking, inspect.isfunction):
            if not name.startswith("_") and name not in vars(mirror):
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
        async for each in _awaited(method(self.sync, *args, **options)):
            yield _mirrored(self, each)

    return update_wrapper(call, method)


async def _awaited(steps: Iterator[Any]) -> AsyncIterator[Any]:
    """What `steps` yields, computed by threads, less its pauses, which take none."""
    try:
        while (step := await asyncio.to_thread(next, steps, None)) is not None:
            if isinstance(step, float):
                await asyncio.sleep(step)
            else:
                yield step
    finally:
        with suppress(AttributeError, ValueError):  # no generator, or a thread still computes its next step
            steps.close()  # type: ignore[attr-defined]


def _mirrored(owner: Any, result: Any) -> Any:
    """`result`; a job as an `AsyncJob`, the owner's own as the owner."""
    if result is owner.sync:
        return owner
    return AsyncJob(result) if isinstance(result, Job) else result


@_mirroring(Job)
class AsyncJob(JobStatus):
    """A `Job` whose requests are awaited; `sync` is the same job with blocking methods."""

    def __init__(self, job: Job) -> None:
        self.sync = job

    def __getattr__(self, name: str) -> Any:
        """The status of `sync`. For type checkers also the methods of `Job`, as coroutines."""
        if name in ("id", "state", "progress", "view"):
            return getattr(self.sync, name)
        raise AttributeError(name)

    async def spec(self) -> dict[str, Any]:
        """The specification with its defaults, as `Job.spec`: a method, as it may send a request."""
        return await asyncio.to_thread(lambda: self.sync.spec)

    async def wait(
        self, progress: "bool | Callable[[Job], None]" = True, timeout: float | None = None
    ) -> "AsyncJob":
        """As `Job.wait`; `progress` is called with `sync`."""
        async for _ in _awaited(self.sync._until_done(progress, timeout)):
            pass
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
        mirrors = {job.sync: job for job in jobs}
        async for job in _awaited(until_ended(mirrors, timeout)):
            yield mirrors[job]

    async def wait_all(
        self,
        jobs: Iterable[AsyncJob],
        timeout: float | None = None,
        progress: bool | PartsCallback = True,
    ) -> list[AsyncJob]:
        """As `Client.wait_all`."""
        jobs = list(jobs)
        async for _ in _awaited(all_done([job.sync for job in jobs], timeout, progress)):
            pass
        return jobs

    async def map(self, specs: Iterable[Specification], *, at_once: int = 16) -> AsyncIterator[AsyncJob]:
        """As `Client.map`."""
        async for job in _awaited(self.sync._mapped(specs, at_once)):
            yield AsyncJob(job)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        await self.close()

    def __repr__(self) -> str:
        return f"<AsyncClient {self.url}>"
