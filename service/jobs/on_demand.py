"""Answers that workers compute for a request: awaited for a while, kept, and asked for again without loss.

A request that has waited long enough is told how far the workers are (202), which is no error.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Future, wait
from typing import Any, Final, Literal

from fastapi import Request, Response
from pydantic import BaseModel

from service.errors import Busy, NotComputed
from worker.executors.base import Executor
from worker.executors.errors import ExecutorError

#: Questions whose answers are kept, the last asked.
KEPT: Final = 64

#: Begins what an answer is put together from; may raise an ExecutorError.
Begin = Callable[[Executor], Sequence["Future[Any]"]]


#: Seconds after which it is worth to ask again.
RETRY_AFTER: Final = 1


class PartsView(BaseModel):
    """How far an answer is."""

    parts_done: int
    parts_total: int
    percent: float


class PendingView(BaseModel):
    """Workers are computing the answer: ask again after Retry-After."""

    state: Literal["running"] = "running"
    progress: PartsView


#: What the API document says of calls that may answer so.
RESPONSES: Final[dict[int | str, dict[str, Any]]] = {
    202: {"model": PendingView, "description": "Not computed yet: ask again after Retry-After"}
}


class Pending(Exception):
    """Workers are computing the answer; raised to the one handler below."""

    def __init__(self, done: int, total: int) -> None:
        super().__init__(done, total)
        self.done, self.total = done, total


def underway(_: Request, error: Exception) -> Response:
    """202 with how far the workers are."""
    assert isinstance(error, Pending)  # as it is registered
    parts = PartsView(
        parts_done=error.done, parts_total=error.total, percent=round(100.0 * error.done / error.total, 1)
    )
    content = PendingView(progress=parts).model_dump_json()
    return Response(content, 202, {"Retry-After": str(RETRY_AFTER)}, "application/json")


class OnDemandCache:
    """What workers answer. A request that gives up waiting leaves the work going for the next one."""

    def __init__(self, executor: Executor, places: int = 4, patience: float = 2.0) -> None:
        self._executor, self._places, self._patience = executor, places, patience
        self._asked: OrderedDict[Hashable, Sequence[Future[Any]]] = OrderedDict()
        self._lock = threading.Lock()

    def to(self, question: Hashable, begin: Begin) -> list[Any]:
        """The parts of the answer, as soon as all are there; `begin` is used if nobody asked before.

        Raises Pending if it takes longer than a request may wait, Busy if many others are being computed,
        NotComputed if the workers were lost, and what the work itself raised.
        """
        parts = self._parts(question, begin)
        done, left = wait(parts, timeout=self._patience)
        if left:
            raise Pending(len(done), len(parts))
        try:
            return [part.result() for part in parts]
        except BaseException as error:
            self._forget(question)
            if isinstance(error, ExecutorError):
                raise NotComputed(f"the workers that computed it were lost ({error}): ask again") from error
            raise

    def close(self) -> None:
        """Let go of what is still being computed."""
        with self._lock:
            for parts in self._asked.values():
                for part in parts:
                    part.cancel()

    def _parts(self, question: Hashable, begin: Begin) -> Sequence["Future[Any]"]:
        with self._lock:
            if question in self._asked:
                self._asked.move_to_end(question)
                return self._asked[question]
            if sum(not _done(parts) for parts in self._asked.values()) >= self._places:
                raise Busy(f"{self._places} answers are being computed already, at most so many at a time")
            try:
                parts = self._asked[question] = begin(self._executor)
            except ExecutorError as error:
                raise NotComputed(f"no worker is there to compute it ({error}): ask again") from error
            done = (one for one, parts in self._asked.items() if _done(parts) and one != question)
            for one in list(done)[: max(len(self._asked) - KEPT, 0)]:
                del self._asked[one]
            return parts

    def _forget(self, question: Hashable) -> None:
        with self._lock:
            self._asked.pop(question, None)


def _done(parts: Sequence["Future[Any]"]) -> bool:
    return all(part.done() for part in parts)
