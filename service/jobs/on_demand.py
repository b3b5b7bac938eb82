"""Results that workers compute while a request waits, kept for the requests that follow.

A request that waits longer than a short time-out raises Pending, which the API answers with 202; the work
continues, and a later request for the same result gets it.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Future, wait
from typing import Any, Final

from service.errors import Busy, NotComputed
from worker.executors.base import Executor
from worker.executors.errors import ExecutorError

#: Results kept, those requested last.
MAX_RESULTS: Final = 64

#: Results computed at a time.
MAX_PENDING: Final = 4

#: Submits the parts of a result to an executor; may raise an ExecutorError.
Submit = Callable[[Executor], Sequence["Future[Any]"]]


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
        self._executor, self._max_pending, self._timeout = executor, max_pending, timeout
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
                parts = self._results[key] = submit(self._executor)
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


def _done(parts: Sequence["Future[Any]"]) -> bool:
    return all(part.done() for part in parts)
