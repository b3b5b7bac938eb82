"""Results that workers compute while a request waits, kept for later requests.

A request that waits longer than a short time-out raises Pending, which the API answers with 202; the work
continues, and a later request for the same result gets it. Work that nobody has requested for
ABANDONED_SECONDS is dropped. Jobs keep at least half of the workers, or of a single one's time, and in the
long run fifteen sixteenths of the workers' time.
"""

import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Future, InvalidStateError, wait
from contextlib import suppress
from functools import partial
from typing import Any, Final, NamedTuple, Protocol

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
    `jobs_compute`: whether jobs have chunks to compute; `abandoned`: seconds without a request after
    which the parts of a result that have not begun are withdrawn.
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
        self._asked: dict[Hashable, float] = {}  # when each result that is computed was last asked for
        self._looks: threading.Timer | None = None
        self._closed = False
        self._results: OrderedDict[Hashable, Sequence[Future[Any]]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable, submit: Submit) -> list[Any]:
        """The parts of a result; calls `submit` if none is kept under `key`.

        Raises Pending after the time-out, Busy if too many results are being computed, NotComputed if there
        are no workers or they were lost, and the errors of the work itself.
        """
        parts = self._parts(key, submit)
        done, left = wait(parts, timeout=self._timeout)
        if left:
            self._give_up_unless_asked_again(key)
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
        """Cancel results still being computed."""
        with self._lock:
            self._closed = True
            if self._looks is not None:
                self._looks.cancel()
            for parts in self._results.values():
                for part in parts:
                    part.cancel()

    def _give_up_unless_asked_again(self, key: Hashable) -> None:
        with self._lock:
            self._asked[key] = time.monotonic()
            self._look_later()

    def _look_later(self) -> None:
        if self._looks is None and self._asked and not self._closed:
            self._looks = threading.Timer(self._abandoned / 4, self._look)
            self._looks.daemon = True
            self._looks.start()

    def _look(self) -> None:
        """Withdraw results that nobody has requested lately."""
        withdrawn: list[Future[Any]] = []
        with self._lock:
            self._looks = None
            for key, asked in list(self._asked.items()):
                if _done(self._results.get(key, ())):
                    del self._asked[key]
                elif time.monotonic() - asked > self._abandoned:
                    withdrawn += self._results.pop(key)
                    del self._asked[key]
            self._look_later()
        for part in withdrawn:  # outside of the lock: callbacks of futures may begin other work
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
        """Forget a failed result, unless another request has restarted it."""
        with self._lock:
            if self._results.get(key) is parts:
                del self._results[key]


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


def _done(parts: Sequence["Future[Any]"]) -> bool:
    return all(part.done() for part in parts)
