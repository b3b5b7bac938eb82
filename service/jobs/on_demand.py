"""Results that workers compute while a request waits, kept for the requests that follow.

A request that waits longer than a short time-out raises Pending, which the API answers with 202; the work
continues, and a later request for the same result gets it. Jobs keep at least half of the workers, or of the
time of a single one.
"""

import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Future, InvalidStateError, wait
from contextlib import suppress
from functools import partial
from typing import Any, Final, NamedTuple, Protocol

from service.errors import Busy, NotComputed
from worker.executors.base import Executor, Result
from worker.executors.errors import ExecutorError

#: Results kept, those requested last.
MAX_RESULTS: Final = 64

#: Results computed at a time.
MAX_PENDING: Final = 4


class Caller(Protocol):
    """Runs functions on workers: an executor, or what `OnDemandCache` puts before it."""

    def call(self, function: Callable[..., Result], *arguments: Any) -> "Future[Result]":
        """Run `function(*arguments)` on a worker."""


#: Submits the parts of a result; may raise an ExecutorError.
Submit = Callable[[Caller], Sequence["Future[Any]"]]


class Pending(Exception):
    """Workers are computing the result; `done` of `total` parts are there."""

    def __init__(self, done: int, total: int) -> None:
        super().__init__(done, total)
        self.done, self.total = done, total


class OnDemandCache:
    """Results computed by workers on request. Its methods may be called from any thread.

    `max_pending`: results that may be computed at a time; `timeout`: seconds that a request waits.
    """

    def __init__(self, executor: Executor, max_pending: int = MAX_PENDING, timeout: float = 2.0) -> None:
        self._workers = _HalfOfTheWorkers(executor)
        self._max_pending, self._timeout = max_pending, timeout
        self._results: OrderedDict[Hashable, Sequence[Future[Any]]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable, submit: Submit) -> list[Any]:
        """The parts of a result; `submit` is called if none is kept under `key`.

        Raises Pending after the time-out, Busy if too many results are being computed, NotComputed if there
        are no workers or they were lost, and what the work itself raised.
        """
        parts = self._parts(key, submit)
        done, left = wait(parts, timeout=self._timeout)
        if left:
            raise Pending(len(done), len(parts))
        try:
            return [part.result() for part in parts]
        except BaseException as error:
            self._forget(key, parts)
            if isinstance(error, ExecutorError):
                raise NotComputed(
                    f"the workers that computed it were lost ({error}): repeat the request"
                ) from error
            raise

    def close(self) -> None:
        """Cancel what is still being computed."""
        with self._lock:
            for parts in self._results.values():
                for part in parts:
                    part.cancel()

    def _parts(self, key: Hashable, submit: Submit) -> Sequence["Future[Any]"]:
        with self._lock:
            if key in self._results:
                self._results.move_to_end(key)
                return self._results[key]
            if sum(not _done(parts) for parts in self._results.values()) >= self._max_pending:
                raise Busy(f"{self._max_pending} results are being computed already, which is the limit")
            try:
                parts = self._results[key] = submit(self._workers)
            except ExecutorError as error:
                raise NotComputed(f"no worker can compute it now ({error}): repeat the request") from error
            done = (other for other, parts in self._results.items() if _done(parts) and other != key)
            for other in list(done)[: max(len(self._results) - MAX_RESULTS, 0)]:
                del self._results[other]
            return parts

    def _forget(self, key: Hashable, parts: Sequence["Future[Any]"]) -> None:
        """Forget a failed result, unless another request has already had it computed again."""
        with self._lock:
            if self._results.get(key) is parts:
                del self._results[key]


class _Call(NamedTuple):
    future: "Future[Any]"
    function: Callable[..., Any]
    arguments: tuple[Any, ...]


class _HalfOfTheWorkers:
    """Has as many calls computed at a time as half of the workers, at least one; the others wait here.

    An executor begins calls before the chunks of jobs. All calls at once would stop every job.
    """

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self._lock = threading.Lock()
        self._waiting: deque[_Call] = deque()
        self._limit, self._running = 1, 0

    def call(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """Run `function(*arguments)` on a worker as soon as it is its turn; may be called from any thread.

        Raises ExecutorError if it is its turn and there is no cluster.
        """
        self._limit = max(1, self._executor.workers() // 2)
        call = _Call(Future(), function, arguments)
        with self._lock:
            self._waiting.append(call)
        self._start()
        if call.future.done() and isinstance(error := call.future.exception(), ExecutorError):
            raise error
        return call.future

    def _start(self) -> None:
        while (call := self._next()) is not None:
            try:
                computed = self._executor.call(call.function, *call.arguments)
            except ExecutorError as error:
                self._end(call.future.set_exception, error)
                continue
            call.future.add_done_callback(partial(_cancel_too, computed))
            computed.add_done_callback(partial(self._finished, call.future))

    def _next(self) -> _Call | None:
        with self._lock:
            while self._waiting and self._running < self._limit:
                call = self._waiting.popleft()
                if not call.future.cancelled():
                    self._running += 1
                    return call
            return None

    def _finished(self, future: "Future[Any]", computed: "Future[Any]") -> None:
        if computed.cancelled():
            self._end(future.cancel)
        elif error := computed.exception():
            self._end(future.set_exception, error)
        else:
            self._end(future.set_result, computed.result())
        self._start()

    def _end(self, end: Callable[..., Any], *value: Any) -> None:
        with self._lock:
            self._running -= 1
        with suppress(InvalidStateError):  # cancelled meanwhile
            end(*value)


def _cancel_too(computed: "Future[Any]", future: "Future[Any]") -> None:
    if future.cancelled():
        computed.cancel()


def _done(parts: Sequence["Future[Any]"]) -> bool:
    return all(part.done() for part in parts)
