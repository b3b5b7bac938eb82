"""Results that workers compute while a request waits, kept for later requests.

A request that waits longer than a short time-out raises Pending, which the API answers with 202; the work
continues, and a later request for the same result gets it. It stops when every client that asked for it has
left during a request, or has not asked for ABANDONED_SECONDS. Jobs keep at least half of the workers, or of
a single one's time, and in the long run fifteen sixteenths of the workers' time.
"""

import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import CancelledError, Future, InvalidStateError, wait
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, NamedTuple, Protocol

from service.background import asker
from service.errors import Busy, NotComputed
from worker.executors.base import Executor, Result
from worker.executors.errors import ExecutorError

#: Number of results kept, the last requested.
MAX_RESULTS: Final = 64

#: Results computed at a time.
MAX_PENDING: Final = 4

#: Seconds without a request after which a result is dropped: longer than the minute between two requests of a
#: page in a hidden tab.
ABANDONED_SECONDS: Final = 75.0

#: Long-run share of the workers' time for calls while chunks of jobs are computed.
SHARE: Final = 1 / 16
#: Core-seconds of calls computed beside jobs before the share applies.
CREDIT_SECONDS: Final = 5.0
#: Seconds until calls that have used up their share are checked again.
LOOK_SECONDS: Final = 0.2


class Caller(Protocol):
    """Runs functions on workers: an executor, or the wrapper of one in `OnDemandCache`."""

    def call(self, function: Callable[..., Result], *arguments: Any) -> "Future[Result]":
        """Run `function(*arguments)` on a worker."""


#: Submits the parts of a result; may raise an ExecutorError.
Submit = Callable[[Caller], Sequence["Future[Any]"]]


class Pending(Exception):
    """Workers are computing the result; `done` of `total` parts are finished."""

    def __init__(self, done: int, total: int) -> None:
        super().__init__(done, total)
        self.done, self.total = done, total


class OnDemandCache:
    """Results computed by workers on request. Its methods may be called from any thread.

    `max_pending`: results that may be computed at a time; `timeout`: seconds that a request waits;
    `jobs_compute`: whether jobs have chunks to compute; `abandoned`: seconds without a request after which a
    client does not count.
    """

    def __init__(
        self,
        executor: Executor,
        max_pending: int = MAX_PENDING,
        timeout: float = 2.0,
        jobs_compute: Callable[[], bool] = lambda: False,
        abandoned: float = ABANDONED_SECONDS,
    ) -> None:
        self._workers = _ShareOfTheWorkers(executor, jobs_compute)
        self._max_pending, self._timeout, self._abandoned = max_pending, timeout, abandoned
        self._looks: threading.Timer | None = None
        self._closed = False
        self._results: OrderedDict[Hashable, _Result] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable, submit: Submit) -> list[Any]:
        """The parts of a result; calls `submit` if none is kept under `key`.

        Raises Pending after the time-out, Busy if too many results are being computed, NotComputed if there
        are no workers or they were lost, and the errors of the work itself.
        """
        client = asker()
        result = self._asked(key, client.connection, submit)
        client.on_leave(partial(self._leave, key, client.connection))
        done, left = wait(result.parts, timeout=self._timeout)
        if left:
            raise Pending(len(done), len(result.parts))
        try:
            return [part.result() for part in result.parts]
        except BaseException as error:
            with self._lock:
                if self._results.get(key) is result:  # no other request has restarted it
                    del self._results[key]
            if isinstance(error, ExecutorError | CancelledError):
                raise NotComputed(
                    f"the workers that computed it were lost ({error}): repeat the request"
                ) from error
            raise

    def close(self) -> None:
        """Cancel results still being computed."""
        with self._lock:
            self._closed = True
            if self._looks is not None:
                self._looks.cancel()
            for result in self._results.values():
                result.cancel()

    def _asked(self, key: Hashable, connection: object, submit: Submit) -> "_Result":
        """The result, begun if none is kept, with the client among those who ask for it."""
        with self._lock:
            if key not in self._results:
                if sum(not result.done for result in self._results.values()) >= self._max_pending:
                    raise Busy(f"{self._max_pending} results are being computed already, which is the limit")
                try:
                    self._results[key] = _Result(submit(self._workers), {})
                except ExecutorError as error:
                    raise NotComputed(
                        f"no worker can compute it now ({error}): repeat the request"
                    ) from error
                done = (other for other, result in self._results.items() if result.done and other != key)
                for other in list(done)[: max(len(self._results) - MAX_RESULTS, 0)]:
                    del self._results[other]
            self._results.move_to_end(key)
            result = self._results[key]
            if not result.done:
                result.askers[connection] = time.monotonic()
                self._look_later()
            return result

    def _leave(self, key: Hashable, connection: object) -> None:
        with self._lock:
            if key in self._results:
                self._results[key].askers.pop(connection, None)
        self._withdraw()

    def _look_later(self) -> None:
        if self._looks is None and not self._closed:
            self._looks = threading.Timer(self._abandoned / 4, self._look)
            self._looks.daemon = True
            self._looks.start()

    def _look(self) -> None:
        """Forget the clients that have not asked lately."""
        until = time.monotonic() - self._abandoned
        with self._lock:
            for result in self._results.values():
                result.askers = {one: asked for one, asked in result.askers.items() if asked >= until}
        self._withdraw()
        with self._lock:
            self._looks = None
            if not all(result.done for result in self._results.values()):
                self._look_later()

    def _withdraw(self) -> None:
        """Stop computing results without clients."""
        with self._lock:
            unwanted = [key for key, result in self._results.items() if not (result.askers or result.done)]
            withdrawn = [self._results.pop(key) for key in unwanted]
        for result in withdrawn:  # outside of the lock: callbacks of futures may begin other work
            result.cancel()


@dataclass
class _Result:
    """The parts of a result, and when each client, by its connection, last asked for them."""

    parts: Sequence["Future[Any]"]
    askers: dict[object, float]

    @property
    def done(self) -> bool:
        return all(part.done() for part in self.parts)

    def cancel(self) -> None:
        for part in self.parts:
            if part.cancel():
                part.set_running_or_notify_cancel()  # wakes those who wait


class _Call(NamedTuple):
    future: "Future[Any]"
    function: Callable[..., Any]
    arguments: tuple[Any, ...]


class _ShareOfTheWorkers:
    """Limits concurrent calls to half of the workers, at least one; the others wait here.

    An executor begins calls before the chunks of jobs. All calls at once would stop every job, and endless
    calls would keep half of the workers. So beside jobs calls use up a credit of CREDIT_SECONDS, which
    grows by SHARE of the workers' time; without credit the next one waits.
    """

    def __init__(self, executor: Executor, jobs_compute: Callable[[], bool]) -> None:
        self._executor, self._jobs_compute = executor, jobs_compute
        self._lock = threading.Lock()
        self._waiting: deque[_Call] = deque()
        self._limit, self._running = 1, 0
        self._workers_count = 0
        self._credit, self._credited = CREDIT_SECONDS, time.monotonic()
        self._later: threading.Timer | None = None

    def call(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """Run `function(*arguments)` on a worker in its turn; may be called from any thread.

        Raises ExecutorError if its turn has come and there is no cluster.
        """
        self._workers_count = self._executor.workers()
        self._limit = max(1, self._workers_count // 2)
        call = _Call(Future(), function, arguments)
        with self._lock:
            self._waiting.append(call)
        self._start()
        if call.future.done() and isinstance(error := call.future.exception(), ExecutorError):
            raise error
        return call.future

    def _start(self) -> None:
        while (call := self._next()) is not None:
            began = time.monotonic()
            try:
                computed = self._executor.call(call.function, *call.arguments)
            except Exception as error:  # noqa: BLE001 - the caller gets the error
                self._end(began, call.future.set_exception, error)
                continue
            call.future.add_done_callback(partial(_cancel_too, computed))
            computed.add_done_callback(partial(self._finished, call.future, began))

    def _next(self) -> _Call | None:
        with self._lock:
            while self._waiting and self._running < self._limit:
                if self._waiting[0].future.cancelled():
                    self._waiting.popleft()
                elif self._may_begin():
                    self._running += 1
                    return self._waiting.popleft()
                else:
                    return None
            return None

    def _may_begin(self) -> bool:
        """Whether jobs leave a call its turn now; if not, check again later."""
        now = time.monotonic()
        earned = SHARE * self._workers_count * (now - self._credited)
        self._credit, self._credited = min(self._credit + earned, CREDIT_SECONDS), now
        if self._credit > 0.0 or not self._jobs_compute():
            return True
        if self._later is None:
            self._later = threading.Timer(LOOK_SECONDS, self._look_again)
            self._later.daemon = True
            self._later.start()
        return False

    def _look_again(self) -> None:
        with self._lock:
            self._later = None
        self._start()

    def _finished(self, future: "Future[Any]", began: float, computed: "Future[Any]") -> None:
        if computed.cancelled():
            self._end(began, future.cancel)
        elif error := computed.exception():
            self._end(began, future.set_exception, error)
        else:
            self._end(began, future.set_result, computed.result())
        self._start()

    def _end(self, began: float, end: Callable[..., Any], *value: Any) -> None:
        with self._lock:
            self._running -= 1
            if self._jobs_compute():
                self._credit -= time.monotonic() - began
        with suppress(InvalidStateError):  # cancelled meanwhile
            end(*value)


def _cancel_too(computed: "Future[Any]", future: "Future[Any]") -> None:
    if future.cancelled():
        computed.cancel()
