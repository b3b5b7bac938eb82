"""Limits on requests that hold resources for long: threads and memory of costly answers, event streams.

An endpoint that reads much, computes or draws is declared `costly`. It then waits for its turn without a
thread, runs in threads that only costly requests use, and its answer counts as memory until the client has
read it. All other requests keep the threads of the event loop's pool for themselves.

A read that is small by its `Cost` has its own threads and memory, and is computed in this process: neither
costly requests nor jobs delay it. Computing stops for a client that leaves.
"""

import asyncio
import functools
import inspect
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import suppress
from typing import Any, Final, Literal, NamedTuple

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool
from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from service.background import Asker, return_memory
from service.errors import Busy, NotComputed

#: Activities of costly requests; each has its own threads, so that long exports do not delay diagrams.
Activity = Literal["read", "store", "export", "trajectory", "on demand"]

#: Bytes sent at a time; the next ones wait until the client has taken these.
PIECE: Final = 256 * 1024

#: The logged status of a request whose client has left; the client never sees it.
CLIENT_GONE: Final = 499

#: If answers took more than this many bytes, memory is returned to the system once no answer is left.
MUCH: Final = 64 * 2**20

#: Seconds that computing continues after the client has left: most answers finish by then, and ending one
#: ends its process too, which beside jobs takes more to start again.
GRACE: Final = 5.0

#: Limits of a small read, of some hundredths of a second: bytes of its answer, bytes of the chunks that it
#: decodes, and their number.
SMALL_ANSWER: Final = 2 * 2**20
SMALL_CHUNKS: Final = 8 * 2**20
FEW_CHUNKS: Final = 16


class Cost(NamedTuple):
    """The resources of an answer."""

    memory: int  # bytes, from the start of its computation until it is sent
    small: bool = False


class Capacity:
    """The threads and the memory of costly requests; used in one event loop only.

    `slots`: threads of each activity; `memory`: bytes of all answers together, from the start of
    their computation until they are sent. A request beyond either waits up to `timeout` s, first come first
    served; at most `max_waiting` wait for each activity.
    """

    def __init__(
        self, slots: Mapping[Activity, int], memory: int, *, timeout: float = 5.0, max_waiting: int = 100
    ) -> None:
        self._slots, self._free = dict(slots), dict(slots)
        self._memory, self._timeout, self._max_waiting = memory, timeout, max_waiting
        self.used = self._most_used = 0  # bytes, now and at most since memory was last returned
        self.waiting: Counter[Activity] = Counter()
        self._queues = {activity: asyncio.Lock() for activity in slots}  # the holder of a lock is next
        self._released = asyncio.Event()
        self._threads = {
            activity: ThreadPoolExecutor(count, thread_name_prefix=f"costly-{activity}")
            for activity, count in slots.items()
        }

    def close(self) -> None:
        """End the threads, each after its current work."""
        for threads in self._threads.values():
            threads.shutdown(wait=False, cancel_futures=True)

    async def acquire(self, activity: Activity, memory: int) -> "Lease":
        """A thread for `activity` and `memory` bytes, capped at the total. Raises Busy."""
        memory, queue = min(memory, self._memory), self._queues[activity]
        if self.waiting[activity] >= self._max_waiting:
            raise self._busy(activity)
        self.waiting[activity] += 1
        try:
            async with asyncio.timeout(self._timeout), queue:
                while not self._free[activity] or self.used + memory > self._memory:
                    await self._released.wait()
        except TimeoutError:
            raise self._busy(activity) from None
        finally:
            self.waiting[activity] -= 1
        self._free[activity] -= 1
        self.used += memory
        self._most_used = max(self._most_used, self.used)
        return Lease(self, activity, memory, self._threads[activity])

    def give_back(self, activity: Activity | None, memory: int) -> None:
        """Free a thread of `activity`, if given, and `memory` bytes."""
        self.used -= memory
        if activity is not None:
            self._free[activity] += 1
        if self.used == 0 and self._most_used > MUCH:
            self._most_used = 0
            asyncio.get_running_loop().run_in_executor(None, return_memory)
        self._released.set()  # wakes those that wait now
        self._released.clear()

    def _busy(self, activity: Activity) -> Busy:
        count = self._slots[activity]
        return Busy(
            f"too many concurrent requests: {count} of kind '{activity}' are computed at a time, and all "
            f"costly answers together take at most {self._memory:,} bytes"
        )


class Lease:
    """A thread and memory of a `Capacity`."""

    def __init__(self, capacity: Capacity, activity: Activity, memory: int, threads: Executor) -> None:
        self._capacity, self._memory, self._threads = capacity, memory, threads
        self._thread: Activity | None = activity

    async def run(self, work: Callable[[], Response]) -> Response:
        """The answer of `work`; the lease then holds only its body, and nothing if `work` raises."""
        try:
            response = await asyncio.get_running_loop().run_in_executor(self._threads, work)
        except BaseException:
            self.keep(0)
            raise
        self.keep(min(self._memory, len(response.body) if hasattr(response, "body") else PIECE))
        return _Leased(response, self)

    def keep(self, memory: int) -> None:
        """Free the thread and all but `memory` bytes; may be called again."""
        thread, freed = self._thread, self._memory - memory
        self._thread, self._memory = None, memory
        self._capacity.give_back(thread, freed)


class _Leased(Response):
    """A response sent piece by piece as the client reads it; releases its lease at the end."""

    def __init__(self, response: Response, lease: Lease) -> None:
        self._response, self._lease = response, lease
        self.status_code, self.background = response.status_code, response.background
        self.raw_headers = response.raw_headers

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            if isinstance(self._response, StreamingResponse):
                await self._response(scope, receive, send)
                return
            start = {"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers}
            await send(start)
            body = memoryview(self._response.body)
            for low in range(0, max(len(body), 1), PIECE):
                piece, more = body[low : low + PIECE], low + PIECE < len(body)
                await send({"type": "http.response.body", "body": piece, "more_body": more})
        finally:
            self._lease.keep(0)


def costly(
    cost: Cost | Callable[..., Cost], activity: Activity = "read"
) -> Callable[[Callable[..., Response]], Callable[..., Coroutine[Any, Any, Response]]]:
    """Declare an endpoint costly; it must have a parameter `service: ServiceDep`.

    `cost`: of every answer, or a function of the endpoint's arguments that estimates it. A request that finds
    no thread or no memory within `turn_seconds` gets 429. Nothing is computed for a client that left before
    its turn; computing stops GRACE seconds after it leaves.
    """

    def declare(endpoint: Callable[..., Response]) -> Callable[..., Coroutine[Any, Any, Response]]:
        @functools.wraps(endpoint)
        async def limited(request: Request, **arguments: Any) -> Response:
            memory, small = await run_in_threadpool(cost, **arguments) if callable(cost) else cost
            if small:
                arguments["service"] = arguments["service"].small
            gone = asyncio.ensure_future(_gone(request))
            try:
                turn = asyncio.ensure_future(arguments["service"].capacity.acquire(activity, memory))
                if await _leaves(gone, turn):
                    turn.cancel()
                    with suppress(asyncio.CancelledError, Busy):
                        (await turn).keep(0)
                    return Response(status_code=CLIENT_GONE)
                client = request.client
                # an address that a proxy forwards has no port: others may have it too
                asker = Asker(client if client is not None and client.port else object())
                work = functools.partial(asker.run, functools.partial(endpoint, **arguments))
                computed: asyncio.Future[Response] = asyncio.ensure_future(turn.result().run(work))
                if await _leaves(gone, computed):
                    await asyncio.wait({computed}, timeout=GRACE)
                    asker.leave()
                return await computed
            except NotComputed:
                if asker.left:
                    return Response(status_code=CLIENT_GONE)
                raise
            finally:
                gone.cancel()

        signature = inspect.signature(endpoint)
        parameter = inspect.Parameter("request", inspect.Parameter.KEYWORD_ONLY, annotation=Request)
        parameters = [*signature.parameters.values(), parameter]
        limited.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        return limited

    return declare


async def _leaves(gone: asyncio.Future[None], task: asyncio.Future[Any]) -> bool:
    """Wait for the task, or until the client is `gone`; whether it is gone."""
    try:
        await asyncio.wait({task, gone}, return_when=asyncio.FIRST_COMPLETED)
        return gone.done()
    except asyncio.CancelledError:
        task.cancel()
        raise


async def _gone(request: Request) -> None:
    """Return when the client closes its connection."""
    while (await request.receive())["type"] != "http.disconnect":
        pass
