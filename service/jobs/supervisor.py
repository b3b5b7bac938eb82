"""The thread that advances jobs. Everything that it holds in memory can be rebuilt from the ledger."""

import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager, suppress
from functools import partial
from queue import Empty, SimpleQueue
from typing import Final, NamedTuple, cast

from service.errors import LedgerUnavailable, LedgerUnusable
from service.jobs.prepare import JobPreparer, ModelChoices
from service.jobs.retry import FAILED_TRIES, Action, RetryPolicy
from service.jobs.run import ChunkMetrics, JobRun, text_of
from service.jobs.schedule import Job, Schedule, Waiting, by_remaining_work
from service.jobs.stores.deletion import remove_deleted, remove_if_deleted
from service.jobs.stores.opening import report_unknown
from service.jobs.stores.repair import Repair, repair
from service.ledger.ledger import Ledger
from service.ledger.model import JobRecord, JobState, summary_of
from service.ledger.transactions import Deletion, Unfinished
from service.settings import Settings
from worker import store
from worker.executors.base import Executor, ExecutorError
from worker.store import ChunkCoords
from worker.study import ChunkOptions, ChunkPaused, ChunkReport
from worker.study.chunks import SLICE_SECONDS

log = logging.getLogger(__name__)

#: With more workers than this, chunks pause less often in proportion: other jobs wait no longer for a worker.
WORKERS_TO_WAIT: Final = 4
#: The priority of a job's turn: above that of all other chunks, which is negative.
TURN_PRIORITY: Final = 0.0
#: Seconds for which later chunks of smaller jobs overtake a chunk that waits at the executor. For a job with
#: this many core-seconds left it is half, for smaller ones less.
PASSED_SECONDS: Final = 10.0
#: Number of runs abandoned after unforeseen errors with which a job fails.
MAX_BROKEN_RUNS: Final = 3
#: Seconds that a reader waits for the repair of damage that it found.
REPAIR_SECONDS: Final = 10.0
#: Seconds until stores that could not be removed are tried again.
RETRY_SECONDS: Final = 30.0
#: Part of a heartbeat between syncs while there are no workers, so that new workers soon get chunks.
IDLE_SHARE: Final = 0.25
#: The reason that readiness and jobs give.
SILENT_BUCKET: Final = "the bucket of the stores does not answer; jobs wait until it does; the log says why"

#: Errors whose text says enough: the log has no traceback of them.
_EXPLAINED: Final = (ExecutorError, LedgerUnusable, OSError, store.StoreError)


class Returned(NamedTuple):
    """A chunk has come back from the executor."""

    job_id: str
    chunk: int
    future: "Future[ChunkReport]"


#: Messages to the supervisor. It makes a call in its own thread. After a call, or None, the ledger has
#: changed.
Message = Returned | Callable[[], None] | None


class Supervisor:
    """Computes the ledger's unfinished jobs on an executor until it is stopped, and maintains their stores.

    `Schedule` decides which job submits the next chunk to the executor's limited places. There, later chunks
    of smaller jobs overtake a chunk for at most PASSED_SECONDS.

    `start`, `in_flight`, `metrics`, `cluster`, `remaining_seconds`, `unknown_stores`, `bucket_fault`, `wake`,
    `look_again`, `repair` and `stop` may be used from any thread. The rest runs in the supervisor's own.
    """

    def __init__(self, ledger: Ledger, executor: Executor, settings: Settings, preparer: JobPreparer) -> None:
        self._ledger, self._executor, self._settings = ledger, executor, settings
        self._preparer = preparer
        self._policy = RetryPolicy(settings.chunk_tries, settings.failed_chunks)
        self._choices = ModelChoices(ledger, executor, preparer, self.wake)
        self._schedule = Schedule(
            settings.window, settings.window_seconds, settings.active_jobs, SLICE_SECONDS
        )
        self.metrics = ChunkMetrics()
        self.cluster = executor.state()  # as of the last sync
        self.remaining_seconds = 0.0  # core-seconds of unfinished jobs, by the cost table
        self.unknown_stores: Sequence[str] | None = None  # names that the ledger did not know
        self.bucket_fault: str | None = None  # why the stores cannot be used, until a sync can list them
        self._inbox: SimpleQueue[Message] = SimpleQueue()
        self._messages: deque[Message] = deque()  # received but not processed
        self._runs: dict[str, JobRun] = {}
        self._broken: Counter[str] = Counter()  # runs abandoned after an unforeseen error, by job
        self._core_seconds: dict[str, float] = {}  # of each unfinished job as a whole, by the cost table
        self._removals_due = self._next_sync = time.monotonic()
        self._remover = threading.Thread()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="supervisor", daemon=True)

    def start(self) -> None:
        """Start the thread, with the ledger's unfinished jobs."""
        self.wake()
        self._thread.start()

    def in_flight(self) -> int:
        """Number of jobs' chunks at the executor."""
        return sum(len(run.in_flight) for run in list(self._runs.values()))

    def wake(self) -> None:
        """Sync with the ledger now. Call it after changing the ledger."""
        self._inbox.put(None)

    def look_again(self) -> None:
        """Look for the stores that the ledger does not know again, if there were any."""
        if self.unknown_stores:
            self.unknown_stores = None
            self.wake()

    def repair(self, job_id: str, damaged: Sequence[ChunkCoords]) -> Repair:
        """Have a store repaired, as `stores.repair.repair`. Raises LedgerUnavailable."""
        self._ledger.check()
        if self._stop.is_set():
            raise LedgerUnavailable("the service ends")
        repaired: Future[Repair] = Future()
        self._inbox.put(partial(self._repair, job_id, damaged, repaired))
        try:
            return repaired.result(REPAIR_SECONDS)
        except TimeoutError:
            return Repair("stored results are damaged; their repair waits for others")

    def stop(self, seconds: float) -> None:
        """Abandon chunks in flight and end the threads within `seconds`; unfinished jobs stay unfinished."""
        self._stop.set()
        self.wake()
        deadline = time.monotonic() + seconds
        for thread in (self._thread, self._remover):
            if thread.is_alive():
                thread.join(max(deadline - time.monotonic(), 0.1))

    def _work(self) -> None:
        while not self._stop.is_set():
            try:
                self._receive()
                self._ledger.check()  # fails while the stores are missing: nothing may be stored
                self._step()
            except Exception as error:  # the next step continues
                pause = self._settings.heartbeat_seconds
                is_defect = not isinstance(error, LedgerUnavailable)
                log.error("supervisor step failed; retrying in %g s: %s", pause, error, exc_info=is_defect)
                self._stop.wait(pause)
                self.wake()
        for run in self._runs.values():
            self._abandon(run)

    def _receive(self) -> None:
        """Wait for a message, or until the next sync is due."""
        with suppress(Empty):
            self._messages.append(self._inbox.get(timeout=max(self._next_sync - time.monotonic(), 0)))
            while True:
                self._messages.append(self._inbox.get_nowait())
        if time.monotonic() >= self._next_sync:
            self._messages.append(None)

    def _step(self) -> None:
        """Apply messages to the state in memory, then save it to the ledger. Raises LedgerUnavailable."""
        sync = False
        while self._messages:
            message = self._messages.popleft()
            if isinstance(message, Returned):
                if (run := self._runs.get(message.job_id)) is not None:
                    with self._contained(run):
                        self._take(run, message)
                continue
            sync = True
            if message is not None:
                message()
        for run in list(self._runs.values()):
            with self._contained(run):
                self._save(run)
        if sync:
            self._sync()
        self._submit()
        for run in list(self._runs.values()):
            with self._contained(run):
                self._end(run)

    def _repair(self, job_id: str, damaged: Sequence[ChunkCoords], repaired: "Future[Repair]") -> None:
        """Repair a store, in this thread, where no run of the job begins meanwhile."""
        try:
            result = repair(self._ledger, self._preparer, job_id, damaged)
        except Exception as error:  # noqa: BLE001 - for the reader
            repaired.set_exception(error)
            return
        if result.unmarked:
            log.error("job %s: %s", job_id, result.detail)
        self.metrics.damaged.inc(len(result.unmarked))
        if (run := self._runs.get(job_id)) is not None:
            run.queue.invalidate(result.unmarked)
        repaired.set_result(result)

    @contextmanager
    def _contained(self, run: JobRun) -> Iterator[None]:
        """Let an error, except one of the ledger, end only this run; the next sync rebuilds it."""
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
                self._fail(run.job, f"internal error: {type(error).__name__}: {error}")

    # Chunks that came back

    def _take(self, run: JobRun, returned: Returned) -> None:
        """Keep a chunk's report, or handle its error."""
        _, chunk, future = returned
        if run.in_flight.get(chunk) is not future:  # from an abandoned run
            return
        error = CancelledError() if future.cancelled() else future.exception()
        report = None if error else future.result()
        if report is not None and (mismatch := run.mismatch(chunk, report)):
            error, report = mismatch, None
        if isinstance(error, ChunkPaused):
            run.add_slice(chunk, seconds := error.seconds)
        elif report is not None:
            seconds = report.seconds - report.paused_seconds
        else:
            seconds = min(run.chunk_seconds, self._schedule.rotation.slice_seconds)
        self._schedule.rotation.count(seconds, run.turns.pop(chunk, None))
        for other in self._runs.values():
            if by_remaining_work(run) < by_remaining_work(other):
                other.delayed += seconds / max(self.cluster.workers, 1)
        del run.in_flight[chunk]
        if report is not None:
            run.unsaved_reports.append(report)
            self.metrics.add_computed(report.seconds)
            return
        if isinstance(error, store.StoreDamaged):
            with suppress(OSError, store.Unreachable):  # the next try reports the error
                store.repair_metadata(run.prepared.store_url, run.prepared.layout, run.prepared.attributes)
        self._on_error(run, chunk, cast(BaseException, error))

    def _on_error(self, run: JobRun, chunk: int, error: BaseException) -> None:
        """Carry out the retry policy's decision on a chunk without a report."""
        action, recompute_predecessor = self._policy.decide(error, run.history(chunk))
        self.metrics.returned.labels(action.value, type(error).__name__).inc()
        if action in FAILED_TRIES:
            trace = None if isinstance(error, _EXPLAINED) else error
            text = f"{text_of(error)} {getattr(error, 'filename', None) or ''}".rstrip()
            log.warning("job %s, chunk %d: %s", run.job.id, chunk, text, exc_info=trace)
        if action is Action.PAUSE:
            self._schedule.slots = 0
            if isinstance(error, store.Unreachable):
                self._note_silent_bucket()
        run.apply(chunk, action, error, recompute_predecessor)

    def _save(self, run: JobRun) -> None:
        """Write the changes of a job's chunks to the ledger; until that succeeds the run keeps them."""
        if run.has_unsaved or run.unsaved_seconds:
            if run.unsaved_reports:
                store.sync_folders(run.prepared.store_url, run.prepared.layout)
            with self._ledger.writing() as ledger:
                ledger.mark_done(run.job, run.unsaved_reports, self._seconds_left(run))
                ledger.note_paused(run.job, run.unsaved_seconds)
                ledger.note_failures(run.job, run.unsaved_failures)
                unmarked = ledger.unmark(run.job, run.unsaved_damage) if run.unsaved_damage else []
            run.mark_saved()
            run.queue.invalidate(unmarked)

    def _note_silent_bucket(self) -> None:
        """Say that the bucket does not answer, until a sync can list its stores again."""
        self.unknown_stores, self.bucket_fault = None, SILENT_BUCKET

    def _seconds_left(self, run: JobRun) -> float | None:
        """Estimated seconds until a job is done, after the jobs with less left to compute."""
        others: list[Job] = [*self._runs.values(), *self._schedule.waiting.values()]
        smaller = [other for other in others if by_remaining_work(other) < by_remaining_work(run)]
        return run.seconds_left(self.cluster.workers, sum(other.expected_seconds for other in smaller))

    def _abandon(self, run: JobRun) -> None:
        """Cancel waiting chunks and have workers stop the others. The next start computes them."""
        for future in list(run.in_flight.values()):
            future.cancel()
        if run.in_flight:
            try:
                store.set_cancelled(run.prepared.store_url)
            except Exception:
                log.exception("job %s: cannot set the cancel flag of its store", run.job.id)

    # Jobs in the ledger

    def _sync(self) -> None:
        """Sync with the ledger: find jobs to start, apply cancel requests, and remove deleted stores."""
        self._ledger.keep_reserve()
        cluster = self.cluster = self._executor.state()
        # one worker's places if there are none: waiting chunks make a cluster grow
        self._schedule.slots = self._settings.window * max(cluster.workers, 1) if cluster.connected else 0
        # among many workers one is soon free even with long slices
        slice_seconds = SLICE_SECONDS * max(1.0, cluster.workers / WORKERS_TO_WAIT)
        self._schedule.rotation.slice_seconds = slice_seconds
        pause = self._settings.heartbeat_seconds * (1.0 if cluster.workers else IDLE_SHARE)
        self._next_sync = time.monotonic() + pause
        for submitting in self._runs.values():
            submitting.refused = False
        with self._ledger.reading() as ledger:
            unfinished = ledger.unfinished(self._settings.max_queue)
            deletions = ledger.deletions()
        self._remove(deletions)
        self._choices.keep({job.id for job in unfinished})
        try:
            if self.unknown_stores is None:
                self.unknown_stores = report_unknown(self._ledger, self._settings)
                self.bucket_fault = None
            for job in unfinished:
                run = self._runs.get(job.id)
                if run is not None:
                    self._apply_cancel(run, job.cancel_requested)
                elif job.cancel_requested:
                    self._start_job(job.id)  # it ends at once
        except store.Unreachable as error:
            # the other stores are in the same bucket; the next sync tries again
            log.warning("the bucket of the stores does not answer: %s", error)
            self._note_silent_bucket()
        self._update_waiting(unfinished)
        if cluster.connected and not cluster.workers:  # none of these will begin
            for future in [x for run in self._runs.values() if run.stopped for x in run.in_flight.values()]:
                future.cancel()
        runs, waiting = self._runs.values(), self._schedule.waiting.values()
        seconds = sum(run.remaining_seconds for run in runs) + sum(job.remaining_seconds for job in waiting)
        self.remaining_seconds, at_once = seconds, sum(run.at_once for run in runs) + len(waiting)
        # rounded to two digits, so that they rarely change
        self._executor.ask_for(float(f"{seconds:.1e}"), int(float(f"{at_once:.1e}")))

    def _remove(self, deletions: Sequence[Deletion]) -> None:
        """Remove stores of deleted jobs in another thread, which wakes this one at the end."""
        if not deletions or self._remover.is_alive() or time.monotonic() < self._removals_due:
            return

        def remove() -> None:
            complete = remove_deleted(self._ledger, self._settings, deletions, self._stop)
            self._removals_due = time.monotonic() + (0.0 if complete else RETRY_SECONDS)
            self.wake()

        self._remover = threading.Thread(target=remove, name="remover", daemon=True)
        self._remover.start()

    def _update_waiting(self, unfinished: Sequence[Unfinished]) -> None:
        """Pass the jobs that may start, and the owners of all, to the schedule."""
        estimates = self._core_seconds
        self._core_seconds = {job.id: estimates.get(job.id) or self._estimate(job.id) for job in unfinished}
        waiting = []
        for job in unfinished:
            if job.id not in self._runs:
                seconds = self._core_seconds[job.id] / job.chunks_total
                remaining = (job.chunks_total - job.chunks_done) * seconds
                waiting.append(Waiting(job.id, job.seq, seconds, remaining))
        owners = {job.id: job.owner for job in sorted(unfinished, key=lambda job: job.seq)}
        self._schedule.update(waiting, owners)

    def _estimate(self, job_id: str) -> float:
        """Upper estimate of a job's core-seconds; 0 if it cannot be prepared, which its start reports."""
        job = self._ledger.find(job_id)
        try:
            return 0.0 if job is None else self._preparer.prepare(job).cost.upper_core_seconds
        except Exception:  # noqa: BLE001 - it concerns this job alone
            return 0.0

    def _start_job(self, job_id: str) -> None:
        """Run a job, or fail it if it cannot start. Raises `store.Unreachable`."""
        job = self._ledger.find(job_id)
        if job is None:
            return  # it was deleted
        try:
            if (chosen := self._choices.chosen(job)) is None:
                return  # this thread is woken when the model is chosen
            run = self._open(chosen)
        except store.Unreachable as error:
            log.warning("job %s cannot start yet, its bucket does not answer: %s", job_id, error)
            raise
        except LedgerUnavailable:
            raise  # not the job's fault: the step is retried
        except Exception as error:
            self._ledger.check()  # a disk that cannot be written is not the job's fault either
            log.error("job %s cannot start: %s", job_id, error, exc_info=not isinstance(error, _EXPLAINED))
            self._fail(job, f"the job cannot start: {type(error).__name__}: {error}")
            return
        with self._ledger.writing() as ledger:  # it may have been cancelled or deleted
            current = ledger.unfinished_record(job)
            if current is not None:
                ledger.run(current, time.time(), self._seconds_left(run))
        if current is not None:
            self._runs[job_id] = run
            log.info("job %s is running, %d of %d chunks done", job_id, job.chunks_done, job.chunks_total)
        else:
            remove_if_deleted(self._ledger, job)

    def _open(self, job: JobRecord) -> JobRun:
        """The run of a job with a chosen model, and its store. Raises LedgerUnusable, StoreError, OSError."""
        prepared = self._preparer.prepare(job)
        store.create(prepared.store_url, prepared.layout, prepared.attributes)
        store.clear_cancelled(prepared.store_url)
        store.sweep_leftovers(prepared.store_url)
        paused = store.checkpoints_in(prepared.store_url)
        return JobRun(job, prepared, self._ledger.done_mask(job), self._policy, paused)

    def _apply_cancel(self, run: JobRun, requested: bool) -> None:
        """Apply or revoke a cancel request by the store's flag. Raises `store.Unreachable`."""
        run.stopping = run.stopping or requested
        if run.flagged == run.stopping == requested:
            return
        try:
            (store.set_cancelled if requested else store.clear_cancelled)(run.prepared.store_url)
        except OSError as error:
            log.warning("job %s: its cancel flag cannot be changed, trying again: %s", run.job.id, error)
            return
        run.flagged = run.stopping = requested

    def _end(self, run: JobRun) -> None:
        """End a job with nothing in flight, unsaved, or to submit."""
        state = run.final_state
        if state is None:
            return
        with suppress(OSError, store.Unreachable):  # else leftovers stay until `bounce doctor --verify`
            store.sweep_leftovers(run.prepared.store_url, done=state is JobState.DONE)
        error = summary_of(run.failures) if state is JobState.FAILED else None
        with self._ledger.writing() as ledger:
            ended = ledger.end(run.job, state, time.time(), error)
        if ended:
            del self._runs[run.job.id]
            self._broken.pop(run.job.id, None)
            log.info("job %s is %s", run.job.id, state)
        self.wake()  # a queued job may start, or one whose cancel was revoked may continue

    def _fail(self, job: JobRecord, error: str) -> None:
        with self._ledger.writing() as ledger:
            ledger.end(job, JobState.FAILED, time.time(), error)

    # Chunks to compute

    def _submit(self) -> None:
        """Submit chunks as the schedule says, until enough are in flight."""
        while not self._stop.is_set() and (due := self._schedule.next(self._runs, len(self._choices))):
            if due.leaving is not None:
                del self._runs[due.leaving.id]
                self.wake()  # the next sync finds it waiting
            if due.job.id in self._schedule.waiting:
                self._start_waiting(due.job.id)
            run = self._runs.get(due.job.id)
            if run is not None and run.may_submit:
                with self._contained(run):
                    self._send(run, due.is_turn)

    def _start_waiting(self, job_id: str) -> None:
        """Start a waiting job, unless its bucket does not answer."""
        del self._schedule.waiting[job_id]
        try:
            self._start_job(job_id)
        except store.Unreachable:
            self._note_silent_bucket()
            self._schedule.waiting.clear()  # the other stores are in the same bucket: wait for the next sync

    def _send(self, run: JobRun, is_turn: bool) -> None:
        """Submit a job's next chunk. After an error the job submits nothing until the next sync."""
        waits = PASSED_SECONDS * run.remaining_seconds / (run.remaining_seconds + PASSED_SECONDS)
        priority = TURN_PRIORITY if is_turn else -(time.monotonic() + waits)
        chunk = run.prepared.plan[run.queue.pop()]
        cost = run.prepared.cost
        longest = cost.upper_core_seconds / cost.cells * chunk.cells
        options = ChunkOptions(
            self._schedule.rotation.slice_seconds,
            begins=chunk.index not in run.begun,
            seconds=max(self._settings.chunk_seconds, self._settings.chunk_slack * longest),
            priority=priority,
        )
        try:
            future = self._executor.submit(run.prepared.spec, chunk, run.prepared.store_url, options)
        except Exception as error:  # noqa: BLE001 - the retry policy decides
            log.warning("the executor refused a chunk, retrying at the next sync: %s", error)
            run.refused = True
            self._on_error(run, chunk.index, error)
            return
        run.in_flight[chunk.index] = future
        run.begun.add(chunk.index)
        if is_turn:
            run.turns[chunk.index] = run.chunk_seconds
            self._schedule.rotation.begin_turn(run.job.id, run.chunk_seconds)
        returned = Returned(run.job.id, chunk.index, future)
        future.add_done_callback(lambda _: self._inbox.put(returned))
