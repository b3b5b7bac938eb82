"""A running job in memory: its queue, chunks in flight, unsaved reports and tries; and metrics of chunks.

Knows neither ledger nor store.
"""

import heapq
import time
import traceback
from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future
from functools import partial
from typing import Final

import numpy as np
import prometheus_client as prometheus
from numpy.typing import NDArray

from service.jobs.prepare import PreparedJob
from service.jobs.retry import FAILED_TRIES, Action, History, RetryPolicy
from service.ledger.model import Failure, JobRecord, JobState
from worker.executors.base import ExecutorError, ReportMismatch
from worker.study import ChunkReport, Plan

#: Characters of a traceback that are kept, from its end.
MAX_TRACEBACK: Final = 8_000

#: Number of the last steps of a ramp, in chunks, from which the time of the next ones is estimated.
RECENT: Final = 3
#: Most by which the table of costs may change that estimate, as long as few steps are done: most ramps begin
#: or end at rest, which takes less.
BY_TABLE: Final = 1.5
#: Pairs of a chunk to come and a chunk done up to which each is expected to take as long as those beside it.
PAIRS: Final = 100_000
#: Least time left, relative to the time taken: of chunks and runs that take longer than expected.
LEAST_LEFT: Final = 0.125
#: Chunks in a row up to which a run has the time left from the table of costs until it has a rate.
FEW: Final = 2


def scattered(count: int) -> NDArray[np.int64]:
    """The numbers below `count`, ordered by their reversed bits: so a map fills from coarse to fine."""
    numbers, place = np.arange(count), np.zeros(count, np.int64)
    for bit in range(count.bit_length()):
        place = 2 * place + ((numbers >> bit) & 1)
    return np.argsort(place)


class ReadyQueue:
    """The chunks of one job that are not done, in an order in which they can be computed; a few bytes each.

    lines: chunk i depends on chunk i - lines, if there is one. done (n,): which chunks are done.
    """

    def __init__(self, lines: int, done: NDArray[np.bool_]) -> None:
        self._lines, self.done = lines, done.copy()
        ready = np.concatenate([np.ones(min(lines, len(done)), np.bool_), done[:-lines]])
        initial = np.flatnonzero(ready & ~done)
        self._initial = initial[scattered(len(initial))]  # ready from the start
        self._initial_popped = 0  # number of these that were popped
        self._first: deque[int] = deque()  # requeued chunks that come before all others
        self._later: deque[int] = deque()  # ready since then: successors and requeued chunks
        self._popped: set[int] = set()  # neither requeued nor complete
        self.remaining = int(np.count_nonzero(~self.done))  # chunks that are not done

    @property
    def ready(self) -> int:
        """Number of chunks that can be popped."""
        return len(self._initial) - self._initial_popped + len(self._first) + len(self._later)

    def pop(self) -> int:
        """Take a chunk that can be computed now. Raises IndexError if none is ready.

        All lines of a ramp advance together: a long one left to the end would occupy a single worker.
        """
        if self._first:
            chunk = self._first.popleft()
        elif self._initial_popped == len(self._initial):
            chunk = self._later.popleft()
        else:
            self._initial_popped += 1
            chunk = int(self._initial[self._initial_popped - 1])
        self._popped.add(chunk)
        return chunk

    def requeue(self, chunk: int, *, first: bool) -> None:
        """Put a popped chunk that was not computed at the end of the queue, or before all others."""
        self._popped.discard(chunk)
        if self._can_run(chunk):
            (self._first if first else self._later).append(chunk)

    def complete(self, chunks: Iterable[int]) -> None:
        """Mark popped chunks as done; their successors become ready."""
        for chunk in chunks:
            self._popped.discard(chunk)
            if not self.done[chunk]:
                self.done[chunk] = True
                self.remaining -= 1
                successor = chunk + self._lines
                if successor < len(self.done) and self._can_run(successor):
                    self._later.append(successor)

    def invalidate(self, chunks: Iterable[int]) -> None:
        """Queue done chunks again; their successors wait for them again."""
        undone = [chunk for chunk in dict.fromkeys(chunks) if self.done[chunk]]
        if not undone:
            return
        self.done[undone] = False
        self.remaining += len(undone)
        initial = self._initial[self._initial_popped :]
        self._initial = initial[~np.isin(initial - self._lines, undone)]
        self._initial_popped = 0
        self._first = deque(filter(self._can_run, self._first))
        self._later = deque(filter(self._can_run, [*self._later, *undone]))

    def _can_run(self, chunk: int) -> bool:
        ready = chunk < self._lines or bool(self.done[chunk - self._lines])
        return ready and not self.done[chunk] and chunk not in self._popped


class ChunkTimes:
    """The seconds that chunks of a run took, and an estimate of the seconds left."""

    def __init__(self, plan: Plan, by_table: float) -> None:
        """by_table: seconds of a chunk by the table of costs."""
        self._plan, self._ramp, self.by_table = plan, plan.ramp is not None, by_table
        self._turns = plan.ramp is not None and len(plan.directions) == 2
        self._took = np.full((len(plan) // plan.lines, plan.lines), np.nan)  # s, of reported chunks
        self._began: float | None = None  # time of the first reports; before, kernels compile
        self._before = 0.0  # s that the chunks of the first reports took

    @property
    def mean(self) -> float:
        """Mean seconds of the chunks done; by the table of costs without any."""
        return self.by_table if self._began is None else float(np.nanmean(self._took))

    def note(self, reports: Sequence[ChunkReport], now: float) -> None:
        """Note the seconds that reported chunks took."""
        for report in reports:
            self._took.flat[report.index] = report.seconds
        if self._began is None and reports:
            self._began, self._before = now, float(np.nansum(self._took))

    def left(
        self, to_come: NDArray[np.bool_], now: float, at_once: int, elapsed: Mapping[int, float]
    ) -> float | None:
        """Seconds that the chunks `to_come` (chunks,) will take at the present rate; None without a rate.

        at_once: the most chunks that are computed at a time, which limits the rate: chunks that are reported
        soon after the first ones began with them. elapsed: seconds since chunks in flight began.
        A chunk on the way back of a ramp is expected to take as long as on the way there. Any other is
        expected to take as long as the newest chunks: on a ramp those of the last RECENT steps, else all. On
        a ramp the table of costs counts too, the less the more steps are done. Without a ramp the last chunks
        are expected to take as long as those beside them in the grid, and the last worker decides.
        """
        took = self._took
        if self._began is None:
            return None
        newest = np.flatnonzero(~np.isnan(took).all(axis=1))[-1]
        recent = np.nanmean(took[max(newest + 1 - RECENT, 0) : newest + 1])
        counted = np.nansum(took) - self._before
        if counted < recent or counted == 0.0:  # one small chunk says little about those beside it
            return None
        expected = np.where(np.isnan(took), took[::-1], took) if self._turns else took.copy()
        if self._ramp:
            done = (newest + 1) / len(took)
            mixed = done * recent + (1.0 - done) * self.by_table
            recent = min(max(mixed, recent / BY_TABLE), recent * BY_TABLE)
        expected[np.isnan(expected)] = recent
        last = np.flatnonzero(to_come)
        if self._ramp or len(last) * np.count_nonzero(~np.isnan(took)) > PAIRS:
            return float(expected.ravel()[last].sum() * max((now - self._began) / counted, 1.0 / at_once))
        seconds = dict(zip(last.tolist(), self._as_beside(last), strict=True))
        under_way = [
            max(seconds.pop(i) - each, each * LEAST_LEFT) for i, each in elapsed.items() if i in seconds
        ]
        ends = (under_way + [0.0] * at_once)[:at_once]
        heapq.heapify(ends)
        for each in seconds.values():
            heapq.heapreplace(ends, ends[0] + each)
        return float(max(ends) * max(at_once * (now - self._began) / (counted + sum(elapsed.values())), 1.0))

    def _as_beside(self, chunks: NDArray[np.int64]) -> NDArray[np.float64]:
        """Seconds expected of chunks from those done: a mean weighted by their distance to the power -5."""
        took = self._took.ravel()
        done = np.flatnonzero(~np.isnan(took))
        places, others = (np.stack(np.unravel_index(i, self._plan.counts), axis=-1) for i in (chunks, done))
        weights = ((places[:, None] - others) ** 2).sum(axis=-1) ** -2.5
        return np.average(np.broadcast_to(took[done], weights.shape), axis=-1, weights=weights)


class JobRun:
    """The state of a running job; used only by the supervisor's thread.

    done (chunks,): which chunks the ledger has marked. paused: chunks with a checkpoint.
    """

    def __init__(
        self,
        job: JobRecord,
        prepared: PreparedJob,
        done: NDArray[np.bool_],
        policy: RetryPolicy,
        paused: Iterable[int] = (),
    ) -> None:
        self.job, self.prepared, self.id, self.seq = job, prepared, job.id, job.seq
        self.stopping = job.cancel_requested  # a cancel is being carried out
        self.flagged = False  # its store has the cancel flag
        self.refused = False  # the executor refused a chunk; nothing is submitted until the next sync
        self.in_flight: dict[int, Future[ChunkReport]] = {}
        self._since: dict[int, float] = {}  # when chunks in flight got a worker
        self._sliced: Counter[int] = Counter()  # milliseconds of their paused slices
        self.turns: dict[int, float] = {}  # estimated seconds of chunks in flight as the job's turn
        self.unsaved_reports: list[ChunkReport] = []  # of stored chunks that are not marked yet
        self._policy = policy
        self.begun = set(paused)  # chunks that may have a checkpoint
        plan = prepared.plan
        self.queue = ReadyQueue(plan.lines, done)
        self._estimate = prepared.cost.upper_core_seconds / len(plan)  # of a chunk, by the cost table
        self._paused_seconds = self.unsaved_seconds = 0.0  # of paused slices; missing from the ledger
        self._times = ChunkTimes(plan, prepared.cost.core_seconds / len(plan))
        self._began, self._to_come = time.monotonic(), self.queue.remaining  # at the start
        self.delayed = 0.0  # s for which all workers computed jobs that come first
        self._tries: Counter[int] = Counter()
        self._collateral_losses: Counter[int] = Counter()
        self.unsaved_damage: set[int] = set()  # chunks to unmark: their stored end states are damaged
        self.failures: list[Failure] = []
        self.unsaved_failures: list[Failure] = []
        self._fatal = False

    # Submitting

    @property
    def may_submit(self) -> bool:
        """Whether a chunk may be submitted now. Not while results wait for the ledger: they could be lost."""
        return self._has_ready and not self.refused and not self.has_unsaved

    @property
    def stopped(self) -> bool:
        """Whether no further chunk is submitted: the job is being cancelled, or has failed."""
        return self.stopping or self._fatal or len(self.failures) >= self._policy.failed_chunks

    @property
    def _has_ready(self) -> bool:
        """Whether there is a chunk to submit now or later."""
        return not self.stopped and self.queue.ready > 0

    def add_slice(self, chunk: int, seconds: float) -> None:
        """Note the seconds of a slice after which a chunk paused."""
        self._sliced[chunk] += round(1e3 * seconds)
        self._paused_seconds += seconds
        self.unsaved_seconds += seconds

    @property
    def chunk_seconds(self) -> float:
        """Core-seconds of a chunk by the cost table, or of the paused slices per chunk if that is more."""
        done = len(self.prepared.plan) - self.queue.remaining
        return max(self._estimate, self._paused_seconds / (1 + done))

    @property
    def remaining_seconds(self) -> float:
        """Core-seconds of the remaining chunks."""
        return self.queue.remaining * self.chunk_seconds

    @property
    def expected_seconds(self) -> float:
        """Core-seconds of the remaining chunks, as long as those done, or by the cost table."""
        return self.queue.remaining * self._times.mean

    def seconds_left(self, workers: int, ahead: float = 0.0) -> float | None:
        """Estimated seconds until the job is done, with its unsaved reports.

        ahead: core-seconds of the jobs that come first.
        Without a rate it is the rest of what the table of costs says, if few chunks follow each other on this
        number of workers, else None, as without workers.
        """
        now = time.monotonic()
        self._times.note(self.unsaved_reports, now - self.delayed)
        to_come = ~self.queue.done
        to_come[[report.index for report in self.unsaved_reports]] = False
        at_once = max(min(workers, self.prepared.plan.lines), 1)
        self._since = {chunk: self._since.get(chunk, now) for chunk in [*self.in_flight][:at_once]}
        elapsed = {chunk: now - since + 1e-3 * self._sliced[chunk] for chunk, since in self._since.items()}
        left = self._times.left(to_come, now - self.delayed, at_once, elapsed)
        in_a_row = -(-self._to_come // at_once)
        if left is None and workers and in_a_row <= FEW:
            taken = max(now - self.delayed - self._began, 0.0)
            left = max(in_a_row * self._times.by_table - taken, taken * LEAST_LEFT)
        return None if left is None else left + ahead / max(workers, 1)

    @property
    def at_once(self) -> int:
        """Number of chunks that could be computed at once now."""
        return len(self.in_flight) + (self.queue.ready if self._has_ready else 0)

    @property
    def is_idle(self) -> bool:
        """Whether the run has nothing in memory and can be rebuilt from the ledger without loss."""
        counted = any(self._tries.values()) or any(self._collateral_losses.values())
        return not (self.in_flight or self.has_unsaved or self.stopping or self.failures or counted)

    # Chunks that came back without a report, or with another's

    def mismatch(self, chunk: int, report: ChunkReport) -> ReportMismatch | None:
        """The error of a report that does not belong to this chunk; None if it does."""
        cells = self.prepared.plan[chunk].cells
        if (report.index, report.cells, sum(report.outcomes)) == (chunk, cells, cells):
            return None
        return ReportMismatch(
            f"the worker reported chunk {report.index} of {report.cells} cells, not chunk {chunk} of {cells}"
        )

    def history(self, chunk: int) -> History:
        """The history of a chunk for the retry policy."""
        return History(
            tries=self._tries[chunk],
            collateral_losses=self._collateral_losses[chunk],
            has_predecessor=self.prepared.plan[chunk].after is not None,
            stopping=self.stopping,
            fatal=self._fatal,
        )

    def apply(
        self, chunk: int, action: Action, error: BaseException, recompute_predecessor: bool = False
    ) -> None:
        """Carry out the policy's decision on a chunk: count it, then requeue the chunk or record its failure.

        Chunks that depend on a given-up chunk are not tried; the others continue.
        """
        predecessor = self.prepared.plan[chunk].after
        if recompute_predecessor and predecessor is not None:
            self.unsaved_damage.add(predecessor)
        self._collateral_losses[chunk] += action is Action.COLLATERAL
        self._tries[chunk] += action in FAILED_TRIES
        self._fatal = self._fatal or action is Action.FATAL
        if action in (Action.GIVE_UP, Action.FATAL):
            # no traceback for a worker's death: it would be the executor's own
            lines = [] if isinstance(error, ExecutorError) else traceback.format_exception(error)
            trace = "".join(lines)[-MAX_TRACEBACK:] or None
            place = self.prepared.describe(self.prepared.plan[chunk])
            failure = Failure(chunk, place, text_of(error), trace, self._tries[chunk])
            self.failures.append(failure)
            self.unsaved_failures.append(failure)
        else:
            # a refused chunk also goes first: it should use up its own tries, not those of every chunk
            self.queue.requeue(chunk, first=action is Action.CONTINUE or self.refused)

    # Saving to the ledger

    @property
    def has_unsaved(self) -> bool:
        """Whether there are reports, failures or damaged chunks missing from the ledger."""
        return bool(self.unsaved_reports or self.unsaved_failures or self.unsaved_damage)

    def mark_saved(self) -> None:
        """Note that all reports, failures and damaged chunks are in the ledger."""
        self.queue.complete(report.index for report in self.unsaved_reports)
        self.begun.difference_update(report.index for report in self.unsaved_reports)
        self.unsaved_reports.clear()
        self.unsaved_seconds = 0.0
        self.unsaved_damage.clear()
        self.unsaved_failures.clear()

    # The end

    @property
    def final_state(self) -> JobState | None:
        """The state in which the job ends; None while chunks are in flight, unsaved or ready."""
        if self.in_flight or self.has_unsaved or self._has_ready:
            return None
        if not self.queue.remaining:
            return JobState.DONE
        return JobState.CANCELLED if self.stopping else JobState.FAILED


def text_of(error: BaseException) -> str:
    """An error as text, with its notes: the cells and the worker."""
    notes = "".join(f" ({note})" for note in getattr(error, "__notes__", ()))
    if isinstance(error, OSError) and error.strerror:  # such as a full disk
        return f"{error.strerror}{notes}"
    kind = "" if isinstance(error, ExecutorError) else f"{type(error).__name__}: "
    return f"{kind}{error}{notes}"


class ChunkMetrics:
    """Metrics of the chunks returned since the start. Whoever serves them registers them."""

    def __init__(self) -> None:
        meaning = "Seconds of workers for each chunk computed since the start."
        seconds = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
        self.durations = prometheus.Histogram(
            "bounce_chunk_duration_seconds", meaning, buckets=seconds, registry=None
        )
        counter = partial(prometheus.Counter, registry=None)
        self.computed = counter("bounce_chunks_computed", "Chunks computed since the start.")
        self.seconds = counter("bounce_chunk_seconds", "Seconds of workers for the chunks computed.")
        self.damaged = counter("bounce_chunks_damaged", "Stored chunks found damaged since the start.")
        meaning = "Chunks that came back without a result, by action and kind of error."
        self.returned = counter("bounce_chunks_returned", meaning, ["action", "error"])

    def add_computed(self, seconds: float) -> None:
        """Count a chunk that came back with a report."""
        self.computed.inc()
        self.seconds.inc(seconds)
        self.durations.observe(seconds)
