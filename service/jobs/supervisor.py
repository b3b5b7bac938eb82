"""The thread that advances jobs. Everything that it holds in memory can be rebuilt from the ledger."""

import heapq
import logging
import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from typing import Final, NamedTuple, cast

from service.errors import LedgerUnavailable
from service.jobs.prepare import JobPreparer
from service.jobs.ready_queue import Rotation, chunk_seconds
from service.jobs.retry import FAILED_TRIES, Action, ChunkCounts, RetryPolicy
from service.jobs.run import JobRun, text_of
from service.ledger.ledger import Ledger
from service.ledger.model import UNFINISHED, JobRecord, JobState, summary_of
from service.ledger.transactions import Unfinished
from service.settings import Settings
from worker import store
from worker.analysis.model_selection import ModelChoice, choose, is_open, resolved
from worker.executors.base import ClusterState, Executor, ExecutorError, ReportMismatch, WorkerDied
from worker.store import StoreConflict
from worker.studies import Chunk
from worker.tasks import SLICE_SECONDS, ChunkOptions, ChunkPaused, ChunkReport

log = logging.getLogger(__name__)

#: Maximum chunks in flight, however small, of one job and those with less left to compute.
MAX_IN_FLIGHT: Final = 64
#: Limit on chunks in flight over all jobs, in multiples of one job's window.
MAX_TIMES_IN_FLIGHT: Final = 4
#: With more workers than this, chunks pause less often in proportion: other jobs' chunks wait equally long.
WORKERS_TO_WAIT: Final = 4
#: The priority of a job's turn: above that of all other chunks, which is negative.
TURN_PRIORITY: Final = 0.0
#: Seconds for which later chunks of smaller jobs overtake a chunk waiting at the executor; less if its own
#: job has less than a core-second left.
PASSED_SECONDS: Final = 10.0
#: Runs of a job abandoned after unforeseen errors before the job fails.
MAX_BROKEN_RUNS: Final = 3
#: Workers that may die while choosing one model before the job fails.
MAX_CHOICE_DEATHS: Final = 3
#: Without workers the ledger is synced after this share of a heartbeat, so that new workers get chunks soon.
IDLE_SHARE: Final = 0.25


class Message(NamedTuple):
    """Chunks have come back from the executor, or were unmarked in the ledger because of damage."""

    job_id: str
    chunks: Sequence[int]
    future: "Future[ChunkReport] | None" = None  # of the chunk that came back


class Supervisor:
    """Computes the ledger's unfinished jobs on an executor until it is stopped.

    The job with the least left to compute comes first, and a share of the workers' time goes to all jobs in
    turn (`Rotation`). Limits the chunks in flight. Chunks of larger jobs do not count: a smaller job
    overtakes them, but only for PASSED_SECONDS. At most `active_jobs` jobs are in memory. An idle job gives
    its place to another. A job whose address still has results of a deleted job waits until it is free.
    `after_writing` removes the store of a job that was deleted while the store was created.

    `start`, `in_flight`, `tally`, `cluster`, `wake`, `invalidating` and `stop` may be used from any thread;
    the rest runs in its own.
    """

    def __init__(
        self,
        ledger: Ledger,
        executor: Executor,
        settings: Settings,
        preparer: JobPreparer,
        after_writing: Callable[[JobRecord], None] = lambda job: None,
    ) -> None:
        self._ledger, self._executor, self._settings = ledger, executor, settings
        self._preparer = preparer
        self._after_writing = after_writing
        self._policy = RetryPolicy(settings.chunk_tries, settings.failed_chunks)
        self.tally = ChunkCounts()
        self.cluster = ClusterState(connected=True, workers=1)  # as the last sync found it
        self.remaining_seconds = 0.0  # core-seconds of unfinished jobs, by the cost table
        self._choosing: dict[str, Future[ModelChoice]] = {}  # a worker chooses the model, by job id
        self._deaths: Counter[str] = Counter()  # of workers that chose a model, by job id
        self._inbox: SimpleQueue[Message | None] = SimpleQueue()  # None: the ledger has changed
        self._messages: deque[Message | None] = deque()  # received but not processed
        self._runs: dict[str, JobRun] = {}
        self._broken: Counter[str] = Counter()  # runs abandoned after an unforeseen error, by job
        self._waiting: dict[str, Unfinished] = {}  # by job id, in order, as the last sync found them
        self._core_seconds: dict[str, float] = {}  # of each unfinished job as a whole, by the cost table
        self._rotation = Rotation(SLICE_SECONDS)
        self._invalidating: list[str] = []  # the job of each caller of `invalidating`
        self._slots = 0  # limit on chunks in flight
        self._next_sync = time.monotonic()
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

    @contextmanager
    def invalidating(self, job_id: str) -> Iterator[list[int]]:
        """Have chunks computed again: the caller unmarks them in the ledger, adds them to the list, and
        removes their bytes.

        No run of the job begins meanwhile. It would find them unmarked, and its new results would be removed
        with the old ones.
        """
        chunks: list[int] = []
        self._invalidating.append(job_id)
        try:
            yield chunks
        finally:
            self._invalidating.remove(job_id)
            if chunks:
                self._inbox.put(Message(job_id, chunks))
            self.wake()

    def stop(self, seconds: float) -> None:
        """Abandon chunks in flight and end the thread within `seconds`; unfinished jobs stay unfinished."""
        self._stop.set()
        self.wake()
        if self._thread.is_alive():
            self._thread.join(seconds)

    def _work(self) -> None:
        while not self._stop.is_set():
            try:
                self._receive()
                self._ledger.check()  # nothing is stored either while the ledger is replaced
                self._step()
            except Exception as error:  # the next step writes the rest
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
            if message is None:
                sync = True
            elif (run := self._runs.get(message.job_id)) is not None:
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
        """Let an error, except of the ledger, end only one job's run; the next sync rebuilds it."""
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

    def _take(self, run: JobRun, message: Message) -> None:
        """Keep a chunk's report, or handle its error."""
        future, [chunk, *_] = message.future, message.chunks
        if future is None:
            run.queue.invalidate(message.chunks)
            return
        if run.in_flight.get(chunk) is not future:  # from an abandoned run
            return
        error = CancelledError() if future.cancelled() else future.exception()
        report = None if error else future.result()
        if report is not None and (mismatch := _mismatch(run.prepared.plan[chunk], report)):
            error, report = mismatch, None
        if isinstance(error, ChunkPaused):
            run.add_slice(chunk, error.seconds)
        # The rotation counts at most a slice.
        seconds = report.seconds if report else run.chunk_seconds
        seconds = min(math.inf if isinstance(error, ChunkPaused) else seconds, self._rotation.slice_seconds)
        if chunk in run.turns:
            self._rotation.end_turn(run.turns[chunk], seconds)
        else:
            self._rotation.earn(seconds)
        run.remove_in_flight(chunk)
        if report is not None:
            run.add_report(report)
            self.tally.add_computed(report.seconds)
            return
        if isinstance(error, store.StoreDamaged):
            prepared = run.prepared
            with suppress(OSError, *store.UNREACHABLE):  # the next try reports the error
                store.repair_metadata(prepared.store_url, prepared.layout, prepared.attributes)
        self._on_error(run, chunk, cast(BaseException, error))

    def _on_error(self, run: JobRun, chunk: int, error: BaseException) -> None:
        """Carry out the retry policy's decision on a chunk without a report."""
        action, recompute_predecessor = self._policy.decide(error, run.history(chunk))
        self.tally.returned[action.value, type(error).__name__] += 1
        if action in FAILED_TRIES:
            log.warning("job %s, chunk %d: %s", run.job.id, chunk, text_of(error))
        if action is Action.PAUSE:
            self._slots = 0
        run.apply(chunk, action, error, recompute_predecessor)

    def _save(self, run: JobRun) -> None:
        """Write the changes of a job's chunks to the ledger; until that succeeds the run keeps them."""
        if run.has_unsaved or run.unsaved_seconds:
            if run.unsaved_reports:
                store.sync_folders(run.prepared.store_url, run.prepared.layout)
            with self._ledger.writing() as ledger:
                ledger.mark_done(run.job, run.unsaved_reports)
                ledger.note_paused(run.job, run.unsaved_seconds)
                ledger.note_failures(run.job, run.unsaved_failures)
                unmarked = ledger.unmark(run.job, run.unsaved_damage) if run.unsaved_damage else []
            run.mark_saved()
            run.queue.invalidate(unmarked)

    def _abandon(self, run: JobRun) -> None:
        """Cancel waiting chunks and make workers stop the others; the next start computes them."""
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
        cluster = self.cluster = self._executor.state()
        # Without workers as for one: a cluster that can grow starts some for waiting chunks.
        self._slots = self._settings.window * max(cluster.workers, 1) if cluster.connected else 0
        # Among many workers one is free soon, however long each is busy.
        self._rotation.slice_seconds = max(SLICE_SECONDS, cluster.workers * SLICE_SECONDS / WORKERS_TO_WAIT)
        pause = self._settings.heartbeat_seconds * (1.0 if cluster.workers else IDLE_SHARE)
        self._next_sync = time.monotonic() + pause
        for submitting in self._runs.values():
            submitting.refused = False
        with self._ledger.reading() as ledger:
            unfinished = ledger.unfinished(self._settings.max_queue)
        try:
            for job in unfinished:
                run = self._runs.get(job.id)
                if run is not None:
                    self._apply_cancel(run, job.cancel_requested)
                elif job.cancel_requested:
                    self._start_job(job.id)  # it ends at once
        except store.UNREACHABLE as error:
            # The other stores are in the same bucket and would wait too. The next sync tries again.
            log.warning("the bucket of the stores does not answer: %s", error)
        self._update_waiting(unfinished)
        if cluster.connected and not cluster.workers:  # none of these will begin
            for future in [x for run in self._runs.values() if run.stopped for x in run.in_flight.values()]:
                future.cancel()
        runs, waiting = self._runs.values(), self._waiting.values()
        seconds = sum(run.remaining_seconds for run in runs) + sum(job.remaining_seconds for job in waiting)
        self.remaining_seconds, at_once = seconds, sum(run.at_once for run in runs) + len(waiting)
        # Rounded to two digits, so that it rarely changes.
        self._executor.ask_for(float(f"{seconds:.1e}"), int(float(f"{at_once:.1e}")))

    def _update_waiting(self, unfinished: Sequence[Unfinished]) -> None:
        """Sort the jobs that may start, and update the rotation."""
        estimates = self._core_seconds
        self._core_seconds = {job.id: estimates.get(job.id) or self._estimate(job.id) for job in unfinished}
        waiting = [
            job._replace(
                chunk_seconds=chunk_seconds(
                    self._core_seconds[job.id] / job.chunks_total, job.core_seconds, job.timed
                )
            )
            for job in unfinished
            if job.id not in self._runs
        ]
        self._waiting = {job.id: job for job in sorted(waiting, key=_order)}
        self._rotation.update({job.id: job.owner for job in sorted(unfinished, key=lambda job: job.seq)})

    def _estimate(self, job_id: str) -> float:
        """Core-seconds of a whole job, at most; 0 if it cannot be prepared, which its start will report."""
        job = self._ledger.find(job_id)
        try:
            return 0.0 if job is None else self._preparer.prepare(job).cost.upper_core_seconds
        except Exception:  # noqa: BLE001 - it concerns this job alone
            return 0.0

    def _start_job(self, job_id: str) -> None:
        """Run a job, or fail it if it cannot start. Raises one of `store.UNREACHABLE`."""
        with self._ledger.reading() as ledger:
            job = ledger.find(job_id)
            if job is None or ledger.is_occupied(job_id):
                return  # deleted meanwhile, or an earlier deletion is not complete
        try:
            if (chosen := self._chosen(job)) is None:
                return  # this thread is woken when the model is chosen
            run = self._open(chosen)
        except store.UNREACHABLE as error:
            log.warning("job %s cannot start yet, its bucket does not answer: %s", job_id, error)
            raise
        except LedgerUnavailable:
            raise  # not the job's fault: the step is retried
        except Exception as error:
            self._ledger.check()  # nor is a disk that cannot be written
            log.exception("job %s cannot start", job_id)
            hint = "; bounce adopt takes in what is stored there" if isinstance(error, StoreConflict) else ""
            reason = f"the job cannot start: {type(error).__name__}: {error}{hint}"
            self._finish(job, JobState.FAILED, reason)
            return
        if job_id in self._invalidating:  # it starts later; checked after the run has read the marked chunks
            return
        with self._ledger.writing() as ledger:  # it may have been cancelled or deleted meanwhile
            current = ledger.find(job_id)
            may_run = current is not None and current.seq == job.seq and current.state in UNFINISHED
            if may_run:
                ledger.run(cast(JobRecord, current), time.time())
        if may_run:
            self._runs[job_id] = run
            log.info("job %s is running, %d of %d chunks done", job_id, job.chunks_done, job.chunks_total)
        else:
            self._after_writing(job)

    def _chosen(self, job: JobRecord) -> JobRecord | None:
        """The job with its model, which a worker chooses before the first chunk; None until it has."""
        submitted = self._preparer.prepare(job).submitted
        if job.choice is not None or not is_open(submitted):
            return job
        try:
            if job.id not in self._choosing:
                self._choosing[job.id] = self._executor.call(choose, submitted)
                self._choosing[job.id].add_done_callback(lambda _: self.wake())
            if not self._choosing[job.id].done():
                return None
            choice = self._choosing.pop(job.id).result()
        except (ExecutorError, CancelledError) as error:  # the next sync tries again
            log.warning("job %s: choosing its model failed: %s", job.id, error)
            self._deaths[job.id] += isinstance(error, WorkerDied)
            if self._deaths[job.id] < MAX_CHOICE_DEATHS:
                return None
            del self._deaths[job.id]
            raise
        plan = self._preparer.plan(resolved(submitted, choice))  # chunks for the cost of the chosen model
        with self._ledger.writing() as ledger:
            ledger.choose(job, choice.model_dump_json(), plan.chunk_shape, len(plan))
            return ledger.find(job.id)

    def _open(self, job: JobRecord) -> JobRun:
        """The run of a job with a chosen model, and its store. Raises SpecError, StoreError, OSError."""
        prepared = self._preparer.prepare(job)
        store.create(prepared.store_url, prepared.layout, prepared.attributes)
        store.clear_cancelled(prepared.store_url)
        store.sweep_leftovers(prepared.store_url)
        paused = store.checkpoints_in(prepared.store_url)
        return JobRun(job, prepared, self._ledger.done_mask(job), self._policy, paused)

    def _apply_cancel(self, run: JobRun, requested: bool) -> None:
        """Apply or revoke a cancel request by the store's flag. Raises one of `store.UNREACHABLE`."""
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
        with suppress(OSError):  # else leftovers of killed workers are removed at the next start
            store.sweep_leftovers(run.prepared.store_url)
        if self._finish(run.job, state, summary_of(run.failures) if state is JobState.FAILED else None):
            del self._runs[run.job.id]
            self._broken.pop(run.job.id, None)
            log.info("job %s is %s", run.job.id, state)
        self.wake()  # a queued job may start, or one whose cancel was revoked may continue

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
        """Submit chunks until enough are in flight: of the job whose turn is due, else of the smallest."""
        while self._slots > 0 and not self._stop.is_set():
            run = self._next_in_turn()
            is_turn = run is not None
            run = run or self._next_smallest()
            if run is None:
                return
            with self._contained(run):
                self._send(run, is_turn)

    def _next_in_turn(self) -> JobRun | None:
        """The job whose turn is due. Turns take at most half of the workers."""
        turns = sum(len(run.turns) for run in self._runs.values())
        turn_limit = max(self._slots // (2 * self._settings.window), 1)
        if turns >= turn_limit or len(self._rotation) == 1 or not self._rotation.is_due(0.0):
            return None
        for job_id in self._rotation:
            run, job = self._runs.get(job_id), self._waiting.get(job_id)
            if run is not None and run.may_submit:
                return run if self._rotation.is_due(run.chunk_seconds) else None
            if run is None and job is not None:
                if not self._rotation.is_due(job.chunk_seconds) or not self._make_room(math.inf):
                    return None
                run = self._start_waiting(job)
                if run is not None:
                    return run
        return None

    def _next_smallest(self) -> JobRun | None:
        """The job with the least left to compute among those that may submit a chunk."""
        runs = sorted(self._runs.values(), key=_order)
        count = sum(len(run.in_flight) for run in runs)
        seconds = sum(len(run.in_flight) * run.chunk_seconds for run in runs)
        if self._is_full(count / MAX_TIMES_IN_FLIGHT, seconds / MAX_TIMES_IN_FLIGHT):
            return None
        count, seconds, has_room = 0, 0.0, True  # in flight for jobs with less left
        jobs: list[list[JobRun | Unfinished]] = [[*runs], [*self._waiting.values()]]
        for job in heapq.merge(*jobs, key=_order):
            if isinstance(job, JobRun):
                count += len(job.in_flight)
                seconds += len(job.in_flight) * job.chunk_seconds
                if self._is_full(count, seconds):
                    return None
                if job.may_submit:
                    return job
            elif has_room and job.id in self._waiting:
                has_room = self._make_room(job.remaining_seconds)
                if has_room and (started := self._start_waiting(job)) is not None:
                    return started
        return None

    def _make_room(self, remaining_seconds: float) -> bool:
        """Make room in memory for a job with this much left; an idle job with more left leaves."""
        if len(self._runs) + len(self._choosing) < self._settings.active_jobs:
            return True
        idle = [run for run in self._runs.values() if run.is_idle and run.may_submit]
        leaving = max(idle, key=_order, default=None)
        if leaving is None or leaving.remaining_seconds <= remaining_seconds < math.inf:
            return False
        del self._runs[leaving.job.id]
        self.wake()  # the next sync finds it waiting
        return True

    def _start_waiting(self, job: Unfinished) -> JobRun | None:
        """Start a waiting job; None if it cannot submit a chunk before the next sync."""
        del self._waiting[job.id]
        try:
            self._start_job(job.id)
        except store.UNREACHABLE:
            self._waiting.clear()  # the other stores are in the same bucket: wait for the next sync
            return None
        run = self._runs.get(job.id)
        return run if run is not None and run.may_submit else None

    def _is_full(self, count: float, seconds: float) -> bool:
        """Whether `count` chunks of `seconds` core-seconds in all are enough: of short ones more are sent."""
        enough = self._settings.window_seconds * self._slots / self._settings.window
        return count >= self._slots and (seconds >= enough or count >= MAX_IN_FLIGHT)

    def _send(self, run: JobRun, is_turn: bool) -> None:
        """Submit a job's next chunk. After an error the job submits nothing until the next sync."""
        waits = PASSED_SECONDS * min(run.remaining_seconds, 1.0)
        priority = TURN_PRIORITY if is_turn else -(time.monotonic() + waits)
        chunk = run.prepared.plan[run.queue.pop()]
        cost = run.prepared.cost
        longest = cost.upper_core_seconds / cost.cells * chunk.cells
        try:
            future = self._executor.submit(
                run.prepared.spec,
                chunk,
                run.prepared.store_url,
                seconds=max(self._settings.chunk_seconds, self._settings.chunk_slack * longest),
                priority=priority,
                options=ChunkOptions(self._rotation.slice_seconds, begins=chunk.index not in run.begun),
            )
        except Exception as error:  # noqa: BLE001 - the retry policy decides
            log.warning("the executor refused a chunk, retrying at the next sync: %s", error)
            run.refused = True
            self._on_error(run, chunk.index, error)
            return
        run.add_in_flight(chunk.index, future)
        if is_turn:
            run.turns[chunk.index] = run.chunk_seconds
            self._rotation.begin_turn(run.job.id, run.chunk_seconds)
        message = Message(run.job.id, [chunk.index], future)
        future.add_done_callback(lambda _: self._inbox.put(message))


def _order(job: "JobRun | Unfinished") -> tuple[float, int]:
    """The order of jobs: by their remaining work."""
    return job.remaining_seconds, job.seq


def _mismatch(chunk: Chunk, report: ChunkReport) -> ReportMismatch | None:
    """The error of a report that is not this chunk's."""
    if (report.index, report.cells, sum(report.outcomes)) == (chunk.index, chunk.cells, chunk.cells):
        return None
    return ReportMismatch(
        f"the worker reported chunk {report.index} of {report.cells} cells, "
        f"not chunk {chunk.index} of {chunk.cells}"
    )
