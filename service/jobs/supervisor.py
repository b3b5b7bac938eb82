"""The thread that advances jobs: starts them, keeps workers supplied with chunks, marks what is stored.

It sleeps until it is woken (a submission, a cancel, a chunk that came back) or a heartbeat has passed.
Whatever it holds in memory can be rebuilt from the ledger.
"""

import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from functools import partial
from queue import Empty, SimpleQueue
from typing import Final, NamedTuple

from service.errors import LedgerUnavailable
from service.jobs.ledger import Ledger
from service.jobs.model import UNFINISHED, JobRecord, JobState
from service.jobs.model_selection import ModelSelector
from service.jobs.prepare import JobPreparer
from service.jobs.retry import FAILED_TRIES, Action, RetryPolicy
from service.jobs.run import JobRun
from service.settings import Settings
from worker import store
from worker.executors.base import Executor
from worker.store import StoreConflict
from worker.studies import Chunk
from worker.tasks import ChunkReport

log = logging.getLogger(__name__)

#: Chunks in flight of one job, however small they are.
MAX_IN_FLIGHT: Final = 64
#: Runs of one job that may be given up after an unforeseen error, before the job fails.
MAX_BROKEN_RUNS: Final = 3
#: Without workers the ledger is synced after this share of a heartbeat, so that those that connect get
#: chunks soon.
IDLE_SHARE: Final = 0.25


class ChunkFinished(NamedTuple):
    """A chunk's future is done, with a report, an error or a cancellation."""

    job_id: str
    chunk: int
    future: "Future[ChunkReport]"


class ChunksInvalidated(NamedTuple):
    """Chunks were unmarked in the ledger: their stored bytes are damaged."""

    job_id: str
    chunks: Sequence[int]


class Sync(NamedTuple):
    """The ledger has changed."""


Message = ChunkFinished | ChunksInvalidated | Sync


class Supervisor:
    """Computes the ledger's unfinished jobs on an executor until it is stopped.

    Each job has a bounded number of chunks in flight. Workers start first the waiting chunks of the job
    with the least work in flight, so that a small job overtakes a huge one.
    A job accepted before this start of the service runs once `is_verified` confirms that its stored chunks
    are what the ledger has marked; one whose address still has results of a deleted job waits for it to be
    free. `after_writing` removes the store of a job that was deleted while the store was created.

    `start`, `wake`, `invalidate` and `stop` may be called from any thread; all else runs in its own.
    """

    def __init__(
        self,
        ledger: Ledger,
        executor: Executor,
        settings: Settings,
        preparer: JobPreparer,
        is_verified: Callable[[str], bool] = lambda job_id: True,
        after_writing: Callable[[JobRecord], None] = lambda job: None,
    ) -> None:
        self._ledger, self._executor, self._settings = ledger, executor, settings
        self._preparer, self._is_verified = preparer, is_verified
        self._after_writing = after_writing
        self._policy = RetryPolicy(settings.chunk_tries, settings.failed_chunks)
        self._selector = ModelSelector(ledger, executor, preparer, self.wake)
        self._inbox: SimpleQueue[Message] = SimpleQueue()
        self._messages: deque[Message] = deque()  # received, and not yet taken in
        self._runs: dict[str, JobRun] = {}
        self._broken: Counter[str] = Counter()  # runs given up after an error of this module, by job
        self._slots = 0  # chunks that each job may have in flight
        self._next_sync = time.monotonic()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="supervisor", daemon=True)

    def start(self) -> None:
        """Start the thread, with the ledger's unfinished jobs."""
        self.wake()
        self._thread.start()

    def wake(self) -> None:
        """Have the ledger synced now. Call it after a change of the ledger."""
        self._inbox.put(Sync())

    def invalidate(self, job_id: str, chunks: Sequence[int]) -> None:
        """Have chunks computed again that were unmarked in the ledger."""
        self._inbox.put(ChunksInvalidated(job_id, chunks))
        self.wake()

    def stop(self, seconds: float) -> None:
        """Abandon what is in flight and end the thread, within `seconds`; unfinished jobs stay unfinished."""
        self._stop.set()
        self.wake()
        if self._thread.is_alive():
            self._thread.join(seconds)

    def _work(self) -> None:
        while not self._stop.is_set():
            try:
                self._messages.extend(self._receive())
                self._ledger.check()  # nothing is stored either while the ledger is not the one it was
                self._step()
            except LedgerUnavailable as error:  # the next step writes what this one could not
                pause = self._settings.heartbeat_seconds
                log.error("supervisor step failed; retrying in %g s: %s", pause, error)
                self._stop.wait(pause)
                self.wake()
            except Exception:
                log.exception("supervisor step failed")
                self._stop.wait(self._settings.heartbeat_seconds)
                self.wake()
        for run in self._runs.values():
            self._abandon(run)

    def _receive(self) -> list[Message]:
        """All messages that have arrived; waits for the first, or until the next sync is due."""
        try:
            messages = [self._inbox.get(timeout=max(self._next_sync - time.monotonic(), 0))]
        except Empty:
            return [Sync()]
        while not self._inbox.empty():
            messages.append(self._inbox.get())
        return messages if time.monotonic() < self._next_sync else [*messages, Sync()]

    def _step(self) -> None:
        """Messages change what is in memory; then the ledger gets it, now or in a later step.

        Raises LedgerUnavailable. Any other error concerns the job alone that it is of.
        """
        sync = False
        while self._messages:
            message = self._messages.popleft()
            if isinstance(message, Sync):
                sync = True
            elif message.job_id in self._runs:
                run = self._runs[message.job_id]
                with self._contained(run):
                    self._take(run, message)
        for run in list(self._runs.values()):
            with self._contained(run):
                self._save(run)
        if sync:
            self._sync()
        self._submit()
        for run in list(self._runs.values()):
            with self._contained(run):
                self._end(run)

    @contextmanager
    def _contained(self, run: JobRun) -> Iterator[None]:
        """Let an error end one job's run only. The next sync makes the run anew, from the ledger.

        Raises LedgerUnavailable, which is no job's fault.
        """
        try:
            yield
        except LedgerUnavailable:
            raise
        except Exception as error:
            log.exception("job %s: its run is given up and made anew from the ledger", run.job.id)
            self._abandon(run)
            self._runs.pop(run.job.id, None)
            self._broken[run.job.id] += 1
            if self._broken[run.job.id] >= MAX_BROKEN_RUNS:
                del self._broken[run.job.id]
                self._finish(run.job, JobState.FAILED, f"internal error: {type(error).__name__}: {error}")

    # Chunks that came back

    def _take(self, run: JobRun, message: ChunkFinished | ChunksInvalidated) -> None:
        if isinstance(message, ChunksInvalidated):
            run.invalidate(message.chunks)
        elif run.in_flight.get(message.chunk) is message.future:  # not one of a run that was given up
            self._on_finished(run, message)

    def _on_finished(self, run: JobRun, finished: ChunkFinished) -> None:
        """Keep a chunk's report, or carry out what the retry policy decides about its error."""
        chunk = finished.chunk
        run.remove_in_flight(chunk)
        error = _error_of(finished.future)
        if error is None:
            run.unsaved_reports.append(finished.future.result())
            return
        action, recompute_predecessor = self._policy.decide(error, run.history(chunk))
        if action in FAILED_TRIES:
            log.warning("job %s, chunk %d: %s: %s", run.job.id, chunk, type(error).__name__, error)
        if action is Action.PAUSE:
            self._slots = 0
        run.apply(chunk, action, error, recompute_predecessor)

    def _save(self, run: JobRun) -> None:
        """Write what has happened to a job's chunks to the ledger, in one transaction.

        The run keeps it until the transaction has succeeded, so that a later step can write it.
        """
        if run.has_unsaved:
            with self._ledger.writing() as ledger:
                ledger.mark_done(run.job, run.unsaved_reports)
                ledger.note_failures(run.job, run.unsaved_failures)
                unmarked = ledger.unmark(run.job, run.unsaved_damage)
            run.mark_saved()
            run.invalidate(unmarked)

    def _abandon(self, run: JobRun) -> None:
        """Cancel chunks that wait and make workers stop those they compute; the next start computes them."""
        for future in list(run.in_flight.values()):
            future.cancel()
        if run.in_flight:
            try:
                store.set_cancelled(run.prepared.store_url)
            except Exception:
                log.exception("job %s: cannot set the cancel flag of its store", run.job.id)

    # Jobs in the ledger

    def _sync(self) -> None:
        """Sync with the ledger: start queued jobs, apply or revoke cancel requests."""
        self._ledger.keep_reserve()
        self._slots = self._settings.window * self._executor.workers()
        pause = self._settings.heartbeat_seconds * (1.0 if self._slots else IDLE_SHARE)
        self._next_sync = time.monotonic() + pause
        with self._ledger.reading() as ledger:
            unfinished = ledger.unfinished(self._settings.active_jobs)
        for job in unfinished:
            if job.cancel_requested and job.id in self._runs:
                self._runs[job.id].stopping = True
        try:
            for job in unfinished:
                run = self._runs.get(job.id)
                if run is not None:
                    self._apply_cancel(run, job.cancel_requested)
                elif self._is_verified(job.id):
                    self._start_job(job.id)
        except store.UNREACHABLE as error:
            # The others' stores are in the same bucket: each would wait as long. The next sync tries again.
            log.warning("the bucket of the stores does not answer: %s", error)

    def _start_job(self, job_id: str) -> None:
        """Create a job's store and add the job to those that run; a job that cannot start fails.

        Raises one of `store.UNREACHABLE`.
        """
        with self._ledger.reading() as ledger:
            job = ledger.find(job_id)
            if job is None or ledger.is_occupied(job_id):
                return  # deleted meanwhile, or deleted before and not removed yet
        try:
            selected = self._selector.select(job)
            if selected is None:
                return  # the selector wakes this thread when the model is chosen
            run = self._open(selected)
        except store.UNREACHABLE as error:
            log.warning("job %s cannot start yet, its bucket does not answer: %s", job_id, error)
            raise
        except LedgerUnavailable:
            raise  # no fault of the job: the step is retried
        except Exception as error:
            log.exception("job %s cannot start", job_id)
            hint = "; bounce adopt takes in what is stored there" if isinstance(error, StoreConflict) else ""
            reason = f"the job cannot start: {type(error).__name__}: {error}{hint}"
            self._finish(job, JobState.FAILED, reason)
            return
        if self._mark_running(job):
            self._runs[job_id] = run
            log.info("job %s is running, %d of %d chunks done", job_id, job.chunks_done, job.chunks_total)

    def _open(self, job: JobRecord) -> JobRun:
        """A job whose model is chosen, its store created, nothing in flight.

        Raises SpecError, StoreError, OSError, or one of `store.UNREACHABLE`.
        """
        prepared = self._preparer.prepare(job)
        store.create(prepared.store_url, prepared.layout, prepared.attributes)
        store.clear_cancelled(prepared.store_url)
        return JobRun(job, prepared, self._ledger.done_mask(job), self._policy)

    def _mark_running(self, job: JobRecord) -> bool:
        """Whether the job may run: it may have been cancelled, or deleted, since its store was created."""
        with self._ledger.writing() as ledger:
            current = ledger.find(job.id)
            if current is not None and current.seq == job.seq and current.state in UNFINISHED:
                ledger.run(current, time.time())
                return True
        self._after_writing(job)
        return False

    def _apply_cancel(self, run: JobRun, requested: bool) -> None:
        """Apply or revoke a cancel request, by the flag at the store that workers look at.

        The job ends when every chunk in flight has come back: only then can nothing write any more. Where
        the flag cannot be set they are computed to their end; where it cannot be removed the job waits.
        Raises one of `store.UNREACHABLE`.
        """
        if run.flagged == run.stopping == requested:
            return
        try:
            (store.set_cancelled if requested else store.clear_cancelled)(run.prepared.store_url)
        except OSError as error:
            log.warning("job %s: its cancel flag cannot be changed, trying again: %s", run.job.id, error)
            return
        run.flagged = run.stopping = requested

    def _end(self, run: JobRun) -> None:
        """End a job that has nothing in flight, nothing unsaved and nothing to submit."""
        state = run.final_state
        if state is None:
            return
        if self._finish(run.job, state, run.error if state is JobState.FAILED else None):
            del self._runs[run.job.id]
            self._broken.pop(run.job.id, None)
            log.info("job %s is %s", run.job.id, state)
        self.wake()  # a queued job may start, or a job whose cancel was revoked continue

    def _finish(self, job: JobRecord, state: JobState, error: str | None) -> bool:
        """Write a job's final state to the ledger; False if the job continues after all."""
        with self._ledger.writing() as ledger:
            current = ledger.find(job.id)
            if current is None or current.seq != job.seq or current.state not in UNFINISHED:
                return True
            if state is JobState.CANCELLED and not current.cancel_requested:
                return False
            if state is JobState.DONE and current.chunks_done < current.chunks_total:
                return False  # a damaged chunk has just been unmarked
            ledger.finish(current, state, time.time(), error)
            return True

    # Chunks to compute

    def _submit(self) -> None:
        """Fill the free slots, the job with the least work in flight first."""
        while True:
            runs = [run for run in self._runs.values() if self._has_free_slot(run)]
            if not runs:
                return
            run = min(runs, key=lambda run: (run.seconds_in_flight, run.job.seq))
            with self._contained(run):
                if not self._send(run):
                    return

    def _has_free_slot(self, run: JobRun) -> bool:
        """Whether a job may have one more chunk in flight.

        A job of short chunks gets more slots, up to `window_seconds` of work: with few, it would wait for
        a chunk of a huge job again and again.
        """
        seconds = self._settings.window_seconds * self._slots / self._settings.window
        count = len(run.in_flight)
        full = count >= self._slots and (run.seconds_in_flight >= seconds or count >= MAX_IN_FLIGHT)
        return self._slots > 0 and not full and run.may_submit

    def _send(self, run: JobRun) -> bool:
        """Submit a job's next chunk to the executor; whether it was taken."""
        priority, chunk = -run.seconds_in_flight, run.pop()
        seconds = self._time_limit(run, chunk)
        try:
            future = self._executor.submit(
                run.prepared.spec, chunk, run.prepared.store_url, seconds=seconds, priority=priority
            )
        except Exception as error:  # noqa: BLE001 - whatever it is, the chunk can wait
            log.warning("the executor refused a chunk, retrying at the next sync: %s", error)
            run.requeue(chunk.index)
            self._slots = 0
            return False
        run.add_in_flight(chunk, future)
        future.add_done_callback(partial(self._post_finished, run.job.id, chunk.index))
        return True

    def _time_limit(self, run: JobRun, chunk: Chunk) -> float:
        """Seconds that a chunk may take from when it starts, before its worker is replaced."""
        return max(self._settings.chunk_seconds, self._settings.chunk_slack * run.longest_seconds(chunk))

    def _post_finished(self, job_id: str, chunk: int, future: "Future[ChunkReport]") -> None:
        self._inbox.put(ChunkFinished(job_id, chunk, future))


def _error_of(future: "Future[ChunkReport]") -> BaseException | None:
    """Why a future that is done has no report; None if it has one."""
    return CancelledError() if future.cancelled() else future.exception()
