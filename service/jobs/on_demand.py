"""Results that workers compute while a request waits, kept for later requests.

A request that waits longer than a short time-out raises Pending, which the API answers with 202. The work
continues, and a later request gets the result. The work stops when every client has left during a request or
has not asked for ABANDONED_SECONDS.
"""

import math
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Iterable, Sequence
from concurrent.futures import CancelledError, Future, InvalidStateError, wait
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, TypeAlias

from service.background import asker
from service.errors import Busy, NotComputed
from worker.executors.base import Executor, ExecutorError, WorkerLeft, timed

#: Limit on the results kept; the least recently requested ones are dropped.
MAX_RESULTS: Final = 64
#: Limit on the results computed at a time.
MAX_PENDING: Final = 4
#: Seconds without a request after which a client no longer counts: more than the minute between two requests
#: of a page in a hidden tab.
ABANDONED_SECONDS: Final = 75.0

#: Long-run share of the workers' time for calls while chunks of jobs are computed.
SHARE: Final = 1 / 16
#: Core-seconds of calls that may be computed beside jobs before the share applies: an audit of a sweep.
CREDIT_SECONDS: Final = 20.0
#: Seconds after the end of a call after which the first call of another result begins without credit.
REST_SECONDS: Final = 15.0
#: Seconds between two checks for abandoned results, and for calls whose turn has come.
LOOK_SECONDS: Final = 0.2


class Pending(Exception):
    """Workers are computing the result; `done` of `total` parts are finished."""

    def __init__(self, done: int, total: int) -> None:
        super().__init__(done, total)
        self.done, self.total = done, total


#: A part of a result, its call, and the result.
_Part: TypeAlias = "tuple[Future[Any], Sequence[Any], _Result]"


@dataclass
class _Result:
    """The parts of a result, and the clients that ask for it."""

    parts: Sequence["Future[Any]"]
    chunks: int  # chunks that were done when it was first asked for
    turn: float  # time at which it was asked for first, or began to compute its last part
    begun: bool = False
    askers: dict[object, float] = field(default_factory=dict)  # time of the last request, by connection

    @property
    def done(self) -> bool:
        return all(part.done() for part in self.parts)

    def is_awaited(self, now: float) -> bool:
        """Whether a client asked for it lately and has neither left nor received it."""
        return any(asked >= now - ABANDONED_SECONDS for asked in self.askers.values())

    def cancel(self) -> None:
        for part in self.parts:
            if part.cancel():
                part.set_running_or_notify_cancel()  # wakes those who wait


class OnDemandCache:
    """Results computed by workers on request. Its methods may be called from any thread.

    timeout: seconds that a request waits. jobs_compute: returns the number of jobs' chunks in flight.

    At most half of the workers, at least one, compute calls, which an executor begins before the chunks of
    jobs. Beside jobs, calls use up a credit of CREDIT_SECONDS, which grows by SHARE of the workers' time.
    Without credit the next call waits: otherwise endless calls would keep half of the workers. The first call
    of a result waits at most REST_SECONDS after the end of another. Results take turns, call by call.
    """

    def __init__(
        self, executor: Executor, timeout: float = 2.0, jobs_compute: Callable[[], int] = lambda: 0
    ) -> None:
        self._executor, self._timeout, self._jobs_compute = executor, timeout, jobs_compute
        self._lock = threading.Lock()
        self._results: OrderedDict[Hashable, _Result] = OrderedDict()
        self._waiting: deque[_Part] = deque()
        self._ended = -math.inf  # when a call ended last
        self._workers = self._running = 0
        self._without_workers = -math.inf  # when there were none, the last time that somebody looked
        self._credit, self._credited = CREDIT_SECONDS, time.monotonic()
        self._look: threading.Timer | None = None
        self._closed = False

    def get(self, key: Hashable, calls: Sequence[Sequence[Any]], chunks: int = 0) -> list[Any]:
        """The results of `calls`, functions with their arguments, which are kept under `key`.

        chunks: number of stored chunks that they can read. With more of them the calls are computed again,
        unless a client waits for the results: else answers of a running job would begin again and again.
        Raises Pending after the time-out, Busy if too many results are being computed, NotComputed if no
        worker could compute them, and the errors of the calls.
        """
        client = asker()
        self._workers = self._executor.state().workers
        if not self._workers:
            self._without_workers = time.monotonic()
        result = self._asked(key, client.connection, calls, chunks)
        self._start()
        client.on_leave(partial(self._leave, key, client.connection))
        done, left = wait(result.parts, timeout=self._timeout)
        if left:
            raise Pending(len(done), len(result.parts))
        try:
            return [part.result() for part in result.parts]
        except BaseException as error:
            with self._lock:
                if self._results.get(key) is result:  # not restarted by another request
                    del self._results[key]
            if isinstance(error, ExecutorError | CancelledError):
                raise NotComputed(f"no worker has computed it ({error}): repeat the request") from error
            raise

    def note_delivered(self, keys: Iterable[Hashable]) -> None:
        """Note that this client has the results under these keys and waits for them no more."""
        for key in keys:
            self._leave(key, asker().connection)

    def close(self) -> None:
        """Cancel results still being computed. No other begins, as the executor ends, too."""
        with self._lock:
            self._closed = True
            results = list(self._results.values())
        for result in results:
            result.cancel()

    def _asked(
        self, key: Hashable, connection: object, calls: Sequence[Sequence[Any]], chunks: int
    ) -> _Result:
        """The result, a new one if none is kept, with the client among its askers. Raises Busy."""
        with self._lock:
            kept, now = self._results.get(key), time.monotonic()
            if kept is None or (kept.chunks != chunks and kept.done and not kept.is_awaited(now)):
                if sum(not result.done for result in self._results.values()) >= MAX_PENDING:
                    raise Busy(f"{MAX_PENDING} results are being computed already, which is the limit")
                done = [other for other, result in self._results.items() if result.done]
                for other in done[: max(len(self._results) + 1 - MAX_RESULTS, 0)]:
                    del self._results[other]
                result = self._results[key] = _Result([Future() for _ in calls], chunks, now)
                self._waiting.extend(
                    (part, call, result) for part, call in zip(result.parts, calls, strict=True)
                )
            self._results.move_to_end(key)
            result = self._results[key]
            result.askers[connection] = now
            if not result.done:
                self._look_later()
            return result

    def _leave(self, key: Hashable, connection: object) -> None:
        with self._lock:
            if key in self._results:
                self._results[key].askers.pop(connection, None)
        self._withdraw()

    def _look_later(self) -> None:
        if self._look is None and not self._closed:
            self._look = threading.Timer(LOOK_SECONDS, self._on_look)
            self._look.daemon = True
            self._look.start()

    def _on_look(self) -> None:
        """Forget the clients that have not asked lately, and begin calls."""
        until = time.monotonic() - ABANDONED_SECONDS
        with self._lock:
            self._look = None
            for result in self._results.values():
                result.askers = {who: asked for who, asked in result.askers.items() if asked >= until}
            if not all(result.done for result in self._results.values()):
                self._look_later()
        self._withdraw()
        self._start()

    def _withdraw(self) -> None:
        """Stop computing results without clients."""
        with self._lock:
            unwanted = [key for key, result in self._results.items() if not (result.askers or result.done)]
            withdrawn = [self._results.pop(key) for key in unwanted]
        for result in withdrawn:  # without the lock: callbacks of futures may begin other calls
            result.cancel()

    def _start(self) -> None:
        """Begin the calls whose turn has come."""
        while (part := self._next()) is not None:
            future, call, _ = part
            began = time.monotonic()
            try:
                computed = self._executor.call(timed, *call)
            except Exception as error:  # noqa: BLE001 - the caller gets the error
                computed = Future()
                computed.set_exception(error)
                self._end(part, began, computed)
                continue
            future.add_done_callback(partial(_cancel_too, computed))
            computed.add_done_callback(partial(self._on_computed, part, began))

    def _next(self) -> "_Part | None":
        """The next part; None if none may begin."""
        with self._lock:
            self._waiting = deque(part for part in self._waiting if not part[0].cancelled())
            if self._closed or not self._waiting or self._running >= max(1, self._workers // 2):
                return None
            now = time.monotonic()
            earned = SHARE * self._workers * (now - self._credited)
            self._credit, self._credited = min(self._credit + earned, CREDIT_SECONDS), now
            may_begin = list(self._waiting)
            if self._credit <= 0.0 and self._jobs_compute():
                rested = now >= self._ended + REST_SECONDS
                may_begin = [part for part in may_begin if rested and not part[2].begun]
            if not may_begin:
                return None
            part = min(may_begin, key=lambda part: part[2].turn)
            self._waiting.remove(part)
            part[2].begun, part[2].turn = True, now
            self._running += 1
            return part

    def _on_computed(self, part: _Part, began: float, computed: "Future[Any]") -> None:
        self._end(part, began, computed)
        self._start()

    def _end(self, part: _Part, began: float, computed: "Future[Any]") -> None:
        """End a part with the result or the error of its call, or have it wait for another worker."""
        future, _, result = part
        error = CancelledError() if computed.cancelled() else computed.exception()
        value, seconds = None, time.monotonic() - max(began, self._without_workers)
        if not error:
            value, seconds = computed.result()
        with self._lock:
            self._running, self._ended = self._running - 1, time.monotonic()
            if self._jobs_compute():  # a wait for workers or their chunks takes no time of theirs
                self._credit -= seconds
            if isinstance(error, WorkerLeft):  # else the other parts would be lost with this one
                self._waiting.appendleft(part)
                result.begun = False
                return
        with suppress(InvalidStateError):  # cancelled meanwhile
            if error:
                future.set_exception(error)
            else:
                future.set_result(value)


def _cancel_too(computed: "Future[Any]", future: "Future[Any]") -> None:
    if future.cancelled():
        computed.cancel()
