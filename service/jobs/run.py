"""One job while it runs: chunks in flight, what came back, what is left. Knows no ledger and no store."""

import errno
import traceback
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import Future
from typing import Final, NamedTuple

import numpy as np

from service.jobs.model import DoneChunk, Failure, JobRecord, JobState
from service.jobs.ready_queue import NONE, ReadyQueue
from worker.cost import cell_seconds
from worker.executors.errors import ExecutorError
from worker.plan import Chunk, Plan
from worker.spec import SweepSpec
from worker.tasks import ChunkReport


class Limits(NamedTuple):
    """How much a job may go wrong before it stops trying."""

    chunk_tries: int  # for a chunk that fails or whose worker dies of it
    failed_chunks: int  # until no more are submitted
    chunk_seconds: float  # that any chunk may take
    chunk_slack: float  # times what its plan says, that a long one may take


#: Stands for every failure after the first in the job's error.
_AND_MORE: Final = " (and {} more chunks failed)"
#: A chunk's neighbours may take its worker with them so often before it is suspected itself.
MAX_COLLATERAL_LOSSES: Final = 10
#: Characters of a traceback that are kept, its end.
_TRACEBACK: Final = 8_000
#: Reasons why no other chunk of a job could be stored either.
FATAL_ERRNOS: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS})


class JobRun:
    """The state of a running job; used by the supervisor's thread alone."""

    def __init__(self, job: JobRecord, spec: SweepSpec, plan: Plan, url: str, done: np.ndarray) -> None:
        self.job, self.spec, self.plan, self.url = job, spec, plan, url
        self.stopping = False  # a cancel is being carried out
        self.in_flight: dict[int, Future[ChunkReport]] = {}
        self.written: list[DoneChunk] = []  # not yet marked in the ledger
        self._ready_queue = ReadyQueue(predecessors(plan), done)
        self._cell_seconds = cell_seconds(spec)
        self._cells_in_flight = 0
        self._tries: Counter[int] = Counter()
        self._collateral_losses: Counter[int] = Counter()
        self._failures: list[Failure] = []
        self._noted = 0  # of the failures, in the ledger
        self._fatal = False

    def may_submit(self, limits: Limits) -> bool:
        """Whether a chunk of this job may be given to a worker now."""
        return self._goes_on(limits) and self._ready_queue.ready and not self.written

    def take(self) -> Chunk:
        """The next chunk to compute."""
        return self.plan.chunks[self._ready_queue.take()]

    def seconds(self, chunk: Chunk, limits: Limits) -> float:
        """How long a chunk may take, from when it begins."""
        return max(limits.chunk_seconds, limits.chunk_slack * chunk.cells * self._cell_seconds)

    @property
    def load(self) -> float:
        """Core-seconds in flight, by the plan."""
        return self._cells_in_flight * self._cell_seconds

    def sent(self, chunk: Chunk, future: "Future[ChunkReport]") -> None:
        """A chunk was given to the executor."""
        self.in_flight[chunk.index] = future
        self._cells_in_flight += chunk.cells

    def came_back(self, chunk: int) -> None:
        """A chunk is no longer at the executor, whatever became of it."""
        del self.in_flight[chunk]
        self._cells_in_flight -= self.plan.chunks[chunk].cells

    def requeue(self, chunk: int) -> None:
        """A chunk was not computed, through no fault of its own."""
        self._ready_queue.requeue(chunk)

    def unlucky(self, chunk: int, error: BaseException, limits: Limits) -> None:
        """A chunk's worker died of a neighbour; only if that happens again and again is it suspected."""
        self._collateral_losses[chunk] += 1
        if self._collateral_losses[chunk] < MAX_COLLATERAL_LOSSES:
            self._ready_queue.requeue(chunk)
        else:
            self.failed(chunk, error, limits)

    def failed(self, chunk: int, error: BaseException, limits: Limits) -> None:
        """A chunk was not computed: try again, though not for ever.

        Given up, it keeps those that wait for it from being tried; the others go on.
        """
        self._tries[chunk] += 1
        self._fatal = self._fatal or (isinstance(error, OSError) and error.errno in FATAL_ERRNOS)
        if self._tries[chunk] < limits.chunk_tries and not self._fatal:
            self._ready_queue.requeue(chunk)
        else:
            where = describe_chunk(self.spec, self.plan.chunks[chunk])
            self._failures.append(_failure(chunk, where, error, self._tries[chunk]))

    def invalidate(self, chunks: Iterable[int]) -> None:
        """Chunks that were done are to be computed again."""
        self._ready_queue.invalidate(chunks)

    @property
    def news(self) -> bool:
        """Whether there is something that the ledger does not know."""
        return bool(self.written) or self._noted < len(self._failures)

    @property
    def failures(self) -> list[Failure]:
        """Those that the ledger does not know."""
        return self._failures[self._noted :]

    def marked(self) -> None:
        """What is written, and what failed, is in the ledger now."""
        self._ready_queue.complete(done.chunk for done in self.written)
        self.written.clear()
        self._noted = len(self._failures)

    def ending(self, limits: Limits) -> JobState | None:
        """The state the job ends in; None while there is something to wait for or to do."""
        if self.in_flight or self.news or self.may_submit(limits):
            return None
        if self._ready_queue.finished:
            return JobState.DONE
        return JobState.CANCELLED if self.stopping else JobState.FAILED

    @property
    def error(self) -> str | None:
        """What went wrong first, and how often after that."""
        if not self._failures:
            return None
        more = len(self._failures) - 1
        first = self._failures[0]
        tries = f" ({first.tries} times)" if first.tries > 1 else ""
        return f"{first.place}: {first.error}{tries}" + (_AND_MORE.format(more) if more else "")

    def _goes_on(self, limits: Limits) -> bool:
        return not self.stopping and not self._fatal and len(self._failures) < limits.failed_chunks


def _failure(chunk: int, where: str, error: BaseException, tries: int) -> Failure:
    """What is kept of an error; one that a process's death stands for has no traceback worth keeping."""
    notes = "".join(f" ({note})" for note in getattr(error, "__notes__", ()))
    if isinstance(error, ExecutorError):
        return Failure(chunk, where, f"{error}{notes}", None, tries)
    trace = "".join(traceback.format_exception(error))[-_TRACEBACK:]
    return Failure(chunk, where, f"{type(error).__name__}: {error}{notes}", trace, tries)


def predecessors(plan: Plan) -> np.ndarray:
    """(n,) the chunk that each waits for, or NONE: what `Chunk.after` says, without making the chunks."""
    return np.maximum(np.arange(len(plan)) - plan.lines, NONE)


def describe_chunk(spec: SweepSpec, chunk: Chunk) -> str:
    """Where a chunk lies, for an error's text: `chunk 3 (up, gamma 1 to 1.5, omega 0.5, xi 0.26)`."""
    spans = [f"{axis} {_ends(spec, chunk, axis)}" for axis in ("gamma", "omega", "xi")]
    return f"chunk {chunk.index} ({', '.join([spec.directions[chunk.direction], *spans])})"


def _ends(spec: SweepSpec, chunk: Chunk, axis: str) -> str:
    low, high = getattr(chunk, axis)
    first, last = spec.axis_values(axis)[[low, high - 1]]
    return f"{first:g}" if low == high - 1 else f"{first:g} to {last:g}"
