"""One job while it runs: chunks in flight, what came back, what is left. Knows no ledger and no store."""

from collections import Counter
from concurrent.futures import Future
from typing import Final, NamedTuple

import numpy as np

from service.frontier import NONE, Frontier
from service.jobs import DoneChunk, JobRecord, JobState
from worker.plan import Chunk, Plan
from worker.spec import SweepSpec
from worker.tasks import ChunkReport


class Settled(NamedTuple):
    """News from the executor: a chunk's future has come to its end."""

    job_id: str
    chunk: int
    future: "Future[ChunkReport]"


class Limits(NamedTuple):
    """How much a job may go wrong before it stops trying."""

    chunk_tries: int  # for a chunk whose worker was lost
    failed_chunks: int  # until no more are submitted


#: Stands for every failure after the first in the job's error.
_AND_MORE: Final = " (and {} more chunks failed)"


class Run:
    """The state of a running job; used by the supervisor's thread alone."""

    def __init__(self, job: JobRecord, spec: SweepSpec, plan: Plan, url: str, done: np.ndarray) -> None:
        self.job, self.spec, self.plan, self.url = job, spec, plan, url
        self.stopping = False  # a cancel is being carried out
        self.in_flight: dict[int, Future[ChunkReport]] = {}
        self.written: list[DoneChunk] = []  # not yet marked in the ledger
        self._frontier = Frontier(predecessors(plan), done)
        self._losses: Counter[int] = Counter()
        self._failures: list[str] = []

    def may_submit(self, limits: Limits) -> bool:
        """Whether a chunk of this job may be given to a worker now."""
        return self._goes_on(limits) and self._frontier.ready and not self.written

    def take(self) -> Chunk:
        """The next chunk to compute."""
        return self.plan.chunks[self._frontier.take()]

    def put_back(self, chunk: int) -> None:
        """A chunk was not computed, through no fault of its own."""
        self._frontier.put_back(chunk)

    def lost(self, chunk: int, why: str, limits: Limits) -> None:
        """A chunk's worker was lost: try again, though not for ever."""
        self._losses[chunk] += 1
        if self._losses[chunk] < limits.chunk_tries:
            self._frontier.put_back(chunk)
        else:
            self.failed(chunk, f"{why} ({limits.chunk_tries} times)")

    def failed(self, chunk: int, why: str) -> None:
        """A chunk cannot be computed; nor can those that wait for it. The others go on."""
        self._failures.append(f"{place(self.spec, self.plan.chunks[chunk])}: {why}")

    def marked(self) -> None:
        """What is written is in the ledger now."""
        self._frontier.complete(done.chunk for done in self.written)
        self.written.clear()

    def ending(self, limits: Limits) -> JobState | None:
        """The state the job ends in; None while there is something to wait for or to do."""
        if self.in_flight or self.written or self.may_submit(limits):
            return None
        if self._frontier.finished:
            return JobState.DONE
        return JobState.CANCELLED if self.stopping else JobState.FAILED

    @property
    def error(self) -> str | None:
        """What went wrong first, and how often after that."""
        if not self._failures:
            return None
        more = len(self._failures) - 1
        return self._failures[0] + (_AND_MORE.format(more) if more else "")

    def _goes_on(self, limits: Limits) -> bool:
        return not self.stopping and len(self._failures) < limits.failed_chunks


def predecessors(plan: Plan) -> np.ndarray:
    """(n,) the chunk that each waits for, or NONE: what `Chunk.after` says, without making the chunks."""
    return np.maximum(np.arange(len(plan)) - plan.lines, NONE)


def place(spec: SweepSpec, chunk: Chunk) -> str:
    """Where a chunk lies, for an error's text: `chunk 3 (up, gamma 1 to 1.5, omega 0.5, xi 0.26)`."""
    spans = [f"{axis} {_ends(spec, chunk, axis)}" for axis in ("gamma", "omega", "xi")]
    return f"chunk {chunk.index} ({', '.join([spec.directions[chunk.direction], *spans])})"


def _ends(spec: SweepSpec, chunk: Chunk, axis: str) -> str:
    low, high = getattr(chunk, axis)
    first, last = spec.axis_values(axis)[[low, high - 1]]
    return f"{first:g}" if low == high - 1 else f"{first:g} to {last:g}"
