"""The thread that advances jobs: starts them, keeps workers supplied with chunks, marks what is stored.

It sleeps until it is woken (a submission, a cancel, a chunk that came back) or a heartbeat has passed.
Whatever it holds in memory can be rebuilt from the ledger.
"""

import logging
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any, Final, NamedTuple

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
from worker.studies import Chunk
from worker.tasks import ChunkReport

log = logging.getLogger(__name__)

#: Chunks in flight of one job, however small they are.
MAX_IN_FLIGHT: Final = 64
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
    are what the ledger has marked. Stores are created under `store_lock`.

    `start`, `wake`, `invalidate` and `stop` may be called from any thread; all else runs in its own.
    """

    def __init__(
        self,
        ledger: Ledger,
        executor: Executor,
        settings: Settings,
        preparer: JobPreparer,
        is_verified: Callable[[str], bool] = lambda job_id: True,
        store_lock: AbstractContextManager[Any] | None = None,
    ) -> None:
        self._ledger, self._executor, self._settings = ledger, executor, settings
        self._preparer, self._is_verified = preparer, is_verified
        self._store_lock = store_lock or nullcontext()
        self._policy = RetryPolicy(settings.chunk_tries, settings.failed_chunks)
        self._selector = ModelSelector(ledger, executor, preparer, self.wake)
        self._inbox: SimpleQueue[Message] = SimpleQueue()
        self._runs: dict[str, JobRun] = {}
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
                self._step(self._receive())
            except Exception:  # such as a ledger that does not answer; the next step starts from its state
                pause = self._settings.heartbeat_seconds
                log.exception("supervisor step failed; retrying in %g s", pause)
                self._stop.wait(pause)
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

    def _step(self, messages: list[Message]) -> None:
        for message in messages:
            if isinstance(message, ChunkFinished):
                self._on_finished(message)
            elif isinstance(message, ChunksInvalidated) and message.job_id in self._runs:
                self._runs[message.job_id].invalidate(message.chunks)
        for run in list(self._runs.values()):
            self._save(run)
        if any(isinstance(message, Sync) for message in messages):
            self._sync()
        self._submit()
        for run in list(self._runs.values()):
            self._end(run)

    # Chunks that came back

    def _on_finished(self, finished: ChunkFinished) -> None:
        """Keep a chunk's report, or carry out what the retry policy decides about its error."""
        run, chunk = self._runs[finished.job_id], finished.chunk
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
        self._slots = self._settings.window * self._executor.workers()
        pause = self._settings.heartbeat_seconds * (1.0 if self._slots else IDLE_SHARE)
        self._next_sync = time.monotonic() + pause
        with self._ledger.reading() as ledger:
            unfinished = ledger.unfinished(self._settings.active_jobs)
        for job in unfinished:
            run = self._runs.get(job.id)
            if run is None:
                if self._is_verified(job.id):
                    with self._store_lock:
                        self._start_job(job.id)
            elif run.stopping != job.cancel_requested:
                self._set_stopping(run, job.cancel_requested)

    def _start_job(self, job_id: str) -> None:
        """Create a job's store and add the job to those that run; a job that cannot start fails."""
        job = self._ledger.find(job_id)
        if job is None:
            return
        try:
            selected = self._selector.select(job)
            if selected is None:
                return  # the selector wakes this thread when the model is chosen
            run = self._open(selected)
        except store.UNREACHABLE as error:
            log.warning("job %s cannot start yet, its bucket does not answer: %s", job_id, error)
            return  # the next sync tries again
        except LedgerUnavailable:
            raise  # no fault of the job: the step is retried
        except Exception as error:
            log.exception("job %s cannot start", job_id)
            self._finish(job_id, JobState.FAILED, f"the job cannot start: {type(error).__name__}: {error}")
            return
        if self._mark_running(job_id):
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

    def _mark_running(self, job_id: str) -> bool:
        """Whether the job may run: it may have been cancelled since the sync read the ledger."""
        with self._ledger.writing() as ledger:
            job = ledger.find(job_id)
            if job is None or job.state not in UNFINISHED:
                return False
            ledger.run(job, time.time())
            return True

    def _set_stopping(self, run: JobRun, stopping: bool) -> None:
        """Apply or revoke a cancel request, by the flag at the store that workers look at.

        The job ends when every chunk in flight has come back: only then can nothing write any more.
        """
        set_flag = store.set_cancelled if stopping else store.clear_cancelled
        set_flag(run.prepared.store_url)
        run.stopping = stopping

    def _end(self, run: JobRun) -> None:
        """End a job that has nothing in flight, nothing unsaved and nothing to submit."""
        state = run.final_state
        if state is None:
            return
        if self._finish(run.job.id, state, run.error if state is JobState.FAILED else None):
            del self._runs[run.job.id]
            log.info("job %s is %s", run.job.id, state)
        self.wake()  # a queued job may start, or a job whose cancel was revoked continue

    def _finish(self, job_id: str, state: JobState, error: str | None) -> bool:
        """Write a job's final state to the ledger; False if the job continues after all."""
        with self._ledger.writing() as ledger:
            job = ledger.find(job_id)
            if job is None or job.state not in UNFINISHED:
                return True
            if state is JobState.CANCELLED and not job.cancel_requested:
                return False
            if state is JobState.DONE and job.chunks_done < job.chunks_total:
                return False  # a damaged chunk has just been unmarked
            ledger.finish(job, state, time.time(), error)
            return True

    # Chunks to compute

    def _submit(self) -> None:
        """Fill the free slots, the job with the least work in flight first."""
        while True:
            runs = [run for run in self._runs.values() if self._has_free_slot(run)]
            if not runs or not self._send(min(runs, key=lambda run: (run.seconds_in_flight, run.job.seq))):
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
