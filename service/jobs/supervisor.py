"""The one thread that moves jobs on: picks them up, keeps workers supplied, marks what is written.

It sleeps until it is rung for (a submission, a cancel, a chunk that came back) or a heartbeat has passed.
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
from typing import Any, Final

from service.jobs.ledger import Ledger
from service.jobs.messages import ChunkFinished, ChunksInvalidated, Message, done_of, error_of
from service.jobs.model import UNFINISHED, JobState
from service.jobs.model_selection import ModelSelector
from service.jobs.prepare import opened
from service.jobs.run import JobRun, Limits
from service.settings import Settings
from worker import store
from worker.executors.base import Executor
from worker.executors.errors import ClusterLost, WorkerLost
from worker.store import StoreDamaged
from worker.tasks import ChunkCancelled, ChunkReport, PredecessorMissing

log = logging.getLogger(__name__)


#: Chunks of one job, however small.
MOST_IN_FLIGHT: Final = 64
#: Of a heartbeat, from one look for workers to the next while there are none.
IDLE_SHARE: Final = 0.25


class Supervisor:
    """Computes the ledger's unfinished jobs on an executor until it is stopped.

    Each job has a small window of chunks in flight, and of those that wait at the workers the
    ones begin first whose job has the least work in flight, so that a small job passes a huge one.
    A job from an earlier life of the service goes on when `cleared` says that what is marked as
    done of it is really there. Stores are made under the lock `making`.
    """

    def __init__(
        self,
        ledger: Ledger,
        executor: Executor,
        settings: Settings,
        cleared: Callable[[str], bool] = lambda job_id: True,
        making: AbstractContextManager[Any] | None = None,
    ) -> None:
        self._ledger, self._executor, self._settings = ledger, executor, settings
        self._cleared, self._making = cleared, making or nullcontext()
        self._limits = Limits(
            settings.chunk_tries, settings.failed_chunks, settings.chunk_seconds, settings.chunk_slack
        )
        self._inbox: SimpleQueue[Message] = SimpleQueue()
        self._selector = ModelSelector(ledger, executor, self.wake)
        self._runs: dict[str, JobRun] = {}
        self._places = 0  # for chunks in flight, of each job
        self._next_look = time.monotonic()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="supervisor", daemon=True)

    def start(self) -> None:
        """Begin, with what the ledger has unfinished."""
        self.wake()
        self._thread.start()

    def wake(self) -> None:
        """Say that the ledger has news. From any thread."""
        self._inbox.put(None)

    def invalidated(self, job_id: str, chunks: Sequence[int]) -> None:
        """Say that chunks are no longer marked in the ledger. From any thread."""
        self._inbox.put(ChunksInvalidated(job_id, chunks))
        self.wake()

    def stop(self, seconds: float) -> None:
        """Let go of what is in flight and end, in at most so long; unfinished jobs stay so in the ledger."""
        self._stop.set()
        self.wake()
        if self._thread.is_alive():
            self._thread.join(seconds)

    def _work(self) -> None:
        while not self._stop.is_set():
            try:
                self._turn(self._news())
            except Exception:  # the ledger may be out of reach; nothing is lost by trying again
                log.exception("the supervisor stumbled; it goes on in %g s", self._settings.heartbeat_seconds)
                self._stop.wait(self._settings.heartbeat_seconds)
                self.wake()
        for run in self._runs.values():
            self.abandon(run)

    def abandon(self, run: JobRun) -> None:
        """Take back what has not begun, and let the workers drop what has: it goes on at the next start."""
        for future in list(run.in_flight.values()):
            future.cancel()
        if run.in_flight:
            try:
                store.set_cancelled(run.url)
            except Exception:
                log.exception("job %s: its workers cannot be told to stop", run.job.id)

    def _news(self) -> list[Message]:
        """All that has come in; sleeps until there is something or it is time to look round."""
        try:
            news: list[Message] = [self._inbox.get(timeout=max(self._next_look - time.monotonic(), 0))]
        except Empty:
            return [None]
        while not self._inbox.empty():
            news.append(self._inbox.get())
        return news if time.monotonic() < self._next_look else [*news, None]

    def _turn(self, news: list[Message]) -> None:
        for one in news:
            if isinstance(one, ChunkFinished):
                self.on_finished(one)
            elif isinstance(one, ChunksInvalidated) and one.job_id in self._runs:
                self._runs[one.job_id].invalidate(one.chunks)
        for run in list(self._runs.values()):
            self._mark(run)
        if None in news:
            self.sync()
        self._submit()
        for run in list(self._runs.values()):
            self._end(run)

    # What came back

    def on_finished(self, settled: ChunkFinished) -> None:
        """Sort a chunk that came back into written, to be done again, or failed."""
        run, chunk = self._runs[settled.job_id], settled.chunk
        run.came_back(chunk)
        error = error_of(settled.future)
        if error is None:
            run.written.append(done_of(settled.future))
        elif isinstance(error, ChunkCancelled | CancelledError):
            run.requeue(chunk)
        elif isinstance(error, ClusterLost):
            run.requeue(chunk)
            self._places = 0  # until the next look finds workers
        elif isinstance(error, WorkerLost):
            run.unlucky(chunk, error, self._limits)
        elif run.stopping:
            run.requeue(chunk)
        else:
            log.warning("job %s, chunk %d: %s: %s", run.job.id, chunk, type(error).__name__, error)
            before = run.plan.chunks[chunk].after
            if before is not None and isinstance(error, StoreDamaged | PredecessorMissing):
                run.invalidate(self._unmark(run, [before]))
            run.failed(chunk, error, self._limits)

    def _mark(self, run: JobRun) -> None:
        """Chunks are written; now say so, in one transaction."""
        if run.news:
            with self._ledger.writing() as ledger:
                ledger.mark_done(run.job, run.written)
                ledger.note_failures(run.job, run.failures)
            run.marked()

    def _unmark(self, run: JobRun, chunks: Sequence[int]) -> Sequence[int]:
        """Note in the ledger that chunks are to be computed again."""
        with self._ledger.writing() as ledger:
            return ledger.unmark(run.job, chunks)

    # What the ledger wants

    def sync(self) -> None:
        """Pick up jobs that wait, stop those that shall stop, let go on those that after all shall."""
        self._places = self._settings.window * self._executor.workers()
        # Workers that come back shall not have to wait for work.
        pause = self._settings.heartbeat_seconds * (1.0 if self._places else IDLE_SHARE)
        self._next_look = time.monotonic() + pause
        with self._ledger.reading() as ledger:
            unfinished = ledger.unfinished(self._settings.active_jobs)
        for brief in unfinished:
            run = self._runs.get(brief.id)
            if run is None:
                if self._cleared(brief.id):
                    with self._making:
                        self._pick_up(brief.id)
            elif run.stopping != brief.cancel_requested:
                self._stop_or_go_on(run, stop=brief.cancel_requested)

    def _pick_up(self, job_id: str) -> None:
        """Make a job's store and give it a place among the running."""
        job = self._ledger.find(job_id)
        if job is None:
            return
        try:
            settled = self._selector.settled(job)
            if settled is None:
                return  # it rings
            run = opened(settled, self._ledger, self._settings)
        except store.UNREACHABLE as error:
            log.warning("job %s cannot begin yet, its bucket does not answer: %s", job_id, error)
            return  # until the next look
        except Exception as error:
            log.exception("job %s cannot begin", job_id)
            self._finish(job_id, JobState.FAILED, f"the job cannot begin: {type(error).__name__}: {error}")
            return
        if self._mark_running(job_id):
            self._runs[job_id] = run
            log.info("job %s runs, %d of %d chunks done", job_id, job.chunks_done, job.chunks_total)

    def _mark_running(self, job_id: str) -> bool:
        """Whether the job may run: it may have been cancelled since it was seen in the queue."""
        with self._ledger.writing() as ledger:
            job = ledger.find(job_id)
            if job is None or job.state not in UNFINISHED:
                return False
            ledger.run(job, time.time())
            return True

    def _stop_or_go_on(self, run: JobRun, stop: bool) -> None:
        """Tell the workers of a job by the mark at its store.

        Every chunk in flight still comes back: only then is it sure that nothing writes any more.
        """
        mark = store.set_cancelled if stop else store.clear_cancelled
        mark(run.url)
        run.stopping = stop

    # What comes next

    def _submit(self) -> None:
        """Fill the free places, the job with the least work in flight first."""
        while True:
            able = [run for run in self._runs.values() if self._has_place(run)]
            if not able or not self._send(min(able, key=lambda run: (run.load, run.job.seq))):
                return

    def _has_place(self, run: JobRun) -> bool:
        """Whether a job may have one more chunk in flight: many small ones, or a job of such would wait for
        a huge one's chunk again and again.
        """
        seconds = self._settings.window_seconds * self._places / self._settings.window
        count = len(run.in_flight)
        enough = count >= self._places and (run.load >= seconds or count >= MOST_IN_FLIGHT)
        return self._places > 0 and not enough and run.may_submit(self._limits)

    def _send(self, run: JobRun) -> bool:
        """Give a job's next chunk to the executor; whether it took it."""
        priority, chunk = -run.load, run.take()
        seconds = run.seconds(chunk, self._limits)
        try:
            future = self._executor.submit(run.spec, chunk, run.url, seconds=seconds, priority=priority)
        except Exception as error:  # noqa: BLE001 - whatever it is, the chunk can wait
            log.warning("the executor takes no chunk: %s; it is tried again soon", error)
            run.requeue(chunk.index)
            self._places = 0  # until the next look
            return False
        run.sent(chunk, future)
        future.add_done_callback(partial(self._came_back, run.job.id, chunk.index))
        return True

    def _came_back(self, job_id: str, chunk: int, future: "Future[ChunkReport]") -> None:
        self._inbox.put(ChunkFinished(job_id, chunk, future))

    def _end(self, run: JobRun) -> None:
        """End a job that has nothing left to do or to wait for."""
        state = run.ending(self._limits)
        if state is None:
            return
        if self._finish(run.job.id, state, run.error if state is JobState.FAILED else None):
            del self._runs[run.job.id]
            log.info("job %s is %s", run.job.id, state)
        self.wake()  # one that waits may have its place; one whose cancel was taken back goes on

    def _finish(self, job_id: str, state: JobState, error: str | None) -> bool:
        """Write the end of a job down; False if it shall go on after all."""
        with self._ledger.writing() as ledger:
            job = ledger.find(job_id)
            if job is None or job.state not in UNFINISHED:
                return True
            if state is JobState.CANCELLED and not job.cancel_requested:
                return False
            if state is JobState.DONE and job.chunks_done < job.chunks_total:
                return False  # a chunk was found damaged just now
            ledger.finish(job, state, time.time(), error)
            return True
