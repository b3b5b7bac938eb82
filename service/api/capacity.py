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
from collections import deque
from collections.abc import Callable, Coroutine, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from typing import Any, Final, Literal, NamedTuple

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool
from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from service.background import Asker, return_memory
from service.errors import Busy, NotComputed, TooManyListeners

#: Activities of costly requests; each has its own threads, so that long exports do not delay diagrams.
Activity = Literal["read", "store", "export", "trajectory", "on demand"]

#: Names of activities in errors.
_PLURALS: Final[Mapping[Activity, str]] = {
    "read": "diagrams, maps and tables",
    "store": "chunks of stores",
    "export": "exports",
    "trajectory": "trajectories",
    "on demand": "answers that workers compute",
}

#: Bytes sent at a time; the next ones wait until the client has taken these.
PIECE: Final = 256 * 1024

#: The logged status of a request whose client has left; the client never sees it.
CLIENT_GONE: Final = 499

#: After this many bytes of answers, return memory to the system once no answer is left.
MUCH: Final = 64 * 2**20


#: Seconds that computing continues after the client has left: most answers finish by then, and ending
#: one costs the process that computes it.
GRACE: Final = 1.0

#: Limits of a small read: bytes of its answer, bytes of the chunks that it decodes, and their number. It
#: takes some hundredths of a second.
SMALL_ANSWER: Final = 2 * 2**20
SMALL_CHUNKS: Final = 8 * 2**20
FEW_CHUNKS: Final = 16


class Cost(NamedTuple):
    """The resources of an answer."""

    memory: int  # bytes, from the start of its computation until it is sent
    small: bool = False


class _Waiter(NamedTuple):
    memory: int
    admitted: "asyncio.Future[None]"


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
        self._used = self._most_used = 0  # bytes, now and at most since memory was last returned
        self._waiting: dict[Activity, deque[_Waiter]] = {activity: deque() for activity in slots}
        self._threads = {
            activity: ThreadPoolExecutor(count, thread_name_prefix=f"costly-{activity}")
            for activity, count in slots.items()
        }

    @property
    def used(self) -> int:
        """Bytes that answers take now, by their estimates."""
        return self._used

    def close(self) -> None:
        """End the threads, each after its current work."""
        for threads in self._threads.values():
            threads.shutdown(wait=False, cancel_futures=True)

    async def acquire(self, activity: Activity, memory: int) -> "Lease":
        """A thread for `activity` and `memory` bytes, capped at the total. Raises Busy."""
        memory, queue = min(memory, self._memory), self._waiting[activity]
        if queue or not self._fits(activity, memory):
            if len(queue) >= self._max_waiting:
                raise self._busy(activity)
            waiter = _Waiter(memory, asyncio.get_running_loop().create_future())
            queue.append(waiter)
            try:
                await asyncio.wait_for(waiter.admitted, self._timeout)
            except TimeoutError:
                self._withdraw(activity, waiter)
                raise self._busy(activity) from None
            except asyncio.CancelledError:
                self._withdraw(activity, waiter)
                raise
        else:
            self._take(activity, memory)
        return Lease(self, activity, memory)

    async def run(self, activity: Activity, work: Callable[[], Response]) -> Response:
        """Run `work` in a thread of the activity, whose lease the caller holds."""
        return await asyncio.get_running_loop().run_in_executor(self._threads[activity], work)

    def give_back(self, activity: Activity | None, memory: int) -> None:
        """Free a thread of `activity`, if given, and `memory` bytes."""
        self._used -= memory
        if activity is not None:
            self._free[activity] += 1
        if self._used == 0 and self._most_used > MUCH:
            self._most_used = 0
            asyncio.get_running_loop().run_in_executor(None, return_memory)
        self._admit()

    def _fits(self, activity: Activity, memory: int) -> bool:
        return self._free[activity] > 0 and self._used + memory <= self._memory

    def _take(self, activity: Activity, memory: int) -> None:
        self._free[activity] -= 1
        self._used += memory
        self._most_used = max(self._most_used, self._used)

    def _admit(self) -> None:
        for activity, queue in self._waiting.items():
            while queue and (queue[0].admitted.done() or self._fits(activity, queue[0].memory)):
                waiter = queue.popleft()
                if not waiter.admitted.done():
                    self._take(activity, waiter.memory)
                    waiter.admitted.set_result(None)

    def _withdraw(self, activity: Activity, waiter: _Waiter) -> None:
        """Remove a request that no longer waits, perhaps admitted in the same moment."""
        if waiter.admitted.done() and not waiter.admitted.cancelled():
            self.give_back(activity, waiter.memory)
        elif waiter in self._waiting[activity]:
            self._waiting[activity].remove(waiter)
            self._admit()  # those behind it may fit

    def _busy(self, activity: Activity) -> Busy:
        count, what = self._slots[activity], _PLURALS[activity]
        return Busy(
            f"too many concurrent requests: {count} {what} are computed at a time, and all costly answers "
            f"together take at most {self._memory:,} bytes"
        )


class Lease:
    """A thread and memory of a `Capacity`."""

    def __init__(self, capacity: Capacity, activity: Activity, memory: int) -> None:
        self._capacity, self._activity, self._memory = capacity, activity, memory
        self._thread: Activity | None = activity

    async def run(self, work: Callable[[], Response]) -> Response:
        """The answer of `work`; the lease then holds only its body, and nothing if `work` raises."""
        try:
            response = await self._capacity.run(self._activity, work)
        except BaseException:
            self.release()
            raise
        kept = min(self._memory, len(response.body) if hasattr(response, "body") else PIECE)
        self._give_back(self._memory - kept)
        return _Leased(response, self)

    def release(self) -> None:
        """Free thread and memory; may be called again."""
        self._give_back(self._memory)

    def _give_back(self, memory: int) -> None:
        thread, self._thread = self._thread, None
        self._memory -= memory
        if memory or thread:
            self._capacity.give_back(thread, memory)


class _Leased(Response):
    """A response sent piece by piece as the client reads it; releases its lease at the end."""

    def __init__(self, response: Response, lease: Lease) -> None:
        self._response, self._lease = response, lease
        self.status_code, self.background = response.status_code, response.background
        self.raw_headers = response.raw_headers  # the same list: routes add headers to it

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            if isinstance(self._response, StreamingResponse):
                await self._response(scope, receive, send)
                return
            start = {"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers}
            await send(start)
            body = memoryview(self._response.body)
            for low in range(0, len(body), PIECE):
                await send({"type": "http.response.body", "body": body[low : low + PIECE], "more_body": True})
            await send({"type": "http.response.body", "body": b"", "more_body": False})
        finally:
            self._lease.release()


def costly(
    cost: int | Callable[..., Cost | int], activity: Activity = "read"
) -> Callable[[Callable[..., Response]], Callable[..., Coroutine[Any, Any, Response]]]:
    """Declare an endpoint costly; it must have a parameter `service: ServiceDep`.

    `cost`: most bytes of an answer, or a function of the endpoint's arguments that estimates them or the
    `Cost`. A request that finds no thread or no memory within `turn_seconds` gets 429.
    Nothing is computed for a client that left before its turn; computing stops GRACE seconds after it leaves.
    """

    def declare(endpoint: Callable[..., Response]) -> Callable[..., Coroutine[Any, Any, Response]]:
        signature = inspect.signature(endpoint)
        takes_request = "request" in signature.parameters

        @functools.wraps(endpoint)
        async def limited(request: Request, **arguments: Any) -> Response:
            if takes_request:
                arguments["request"] = request
            estimate = await run_in_threadpool(cost, **arguments) if callable(cost) else cost
            taken = estimate if isinstance(estimate, Cost) else Cost(estimate)
            if taken.small:
                arguments["service"] = arguments["service"].small
            lease = await _unless_gone(request, arguments["service"].capacity.acquire(activity, taken.memory))
            if lease is None:
                return Response(status_code=CLIENT_GONE)
            return await _answer(request, lease, functools.partial(endpoint, **arguments))

        if not takes_request:
            parameter = inspect.Parameter("request", inspect.Parameter.KEYWORD_ONLY, annotation=Request)
            signature = signature.replace(parameters=[*signature.parameters.values(), parameter])
        limited.__signature__ = signature  # type: ignore[attr-defined]
        return limited

    return declare


async def _unless_gone(request: Request, acquiring: Coroutine[Any, Any, Lease]) -> Lease | None:
    """The acquired lease; None, with nothing held, if the client has closed its connection."""
    acquired, gone = asyncio.ensure_future(acquiring), asyncio.ensure_future(_gone(request))
    try:
        await asyncio.wait({acquired, gone}, return_when=asyncio.FIRST_COMPLETED)
        if not gone.done():
            return acquired.result()
    finally:
        gone.cancel()
        acquired.cancel()
    with suppress(asyncio.CancelledError, Busy):
        (await acquired).release()
    return None


async def _answer(request: Request, lease: Lease, work: Callable[[], Response]) -> Response:
    """The answer of `work`; stops computing if the client closes its connection."""
    asker = Asker(request.client)
    computed = asyncio.ensure_future(lease.run(functools.partial(asker.run, work)))
    gone = asyncio.ensure_future(_gone(request))
    try:
        await asyncio.wait({computed, gone}, return_when=asyncio.FIRST_COMPLETED)
        if not computed.done():
            await asyncio.wait({computed}, timeout=GRACE)
            asker.leave()
        return await computed
    except NotComputed:
        if asker.left:
            return Response(status_code=CLIENT_GONE)
        raise
    finally:
        gone.cancel()
        computed.cancel()


async def _gone(request: Request) -> None:
    """Return when the client closes its connection."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


class ListenerLimit:
    """At most `limit` event streams at a time; used in one event loop only."""

    def __init__(self, limit: int) -> None:
        self._limit, self._listeners = limit, 0

    @contextmanager
    def slot(self) -> Iterator[None]:
        """Count as a listener during the block. Raises TooManyListeners at once."""
        if self._listeners >= self._limit:
            raise TooManyListeners(
                f"too many event streams: at most {self._limit:,} at a time; poll the job instead"
            )
        self._listeners += 1
        try:
            yield
        finally:
            self._listeners -= 1
