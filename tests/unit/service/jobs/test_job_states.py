"""Jobs through any order of events: submit, compute, lose workers, cancel, delete, crash, restart, query.

`BOUNCE_TEST_CASES=500` for the long version.
"""

import os
import tempfile
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from scripted import Held, sweep, wait_for

from kernel.params import KERNEL_VERSION, Outcome
from service.errors import IllegalTransition, LedgerUnavailable, UnknownJob
from service.jobs.manager import JobManager
from service.ledger.ledger import Ledger
from service.ledger.model import UNFINISHED, JobRecord, JobState
from service.settings import Settings
from service.views import diagram
from service.views.selection import Stored
from worker import store
from worker.executors.base import ClusterLost, WorkerDied, WorkerLeft, WorkerLost
from worker.study import Chunk, ChunkReport
from worker.sweep import SweepSpec

CASES = int(os.environ.get("BOUNCE_TEST_CASES", "8"))
GAMMA = {"start": 0.5, "stop": 1.2, "num": 32}
RAMP = {"kind": "ramp", "axis": "gamma", "direction": "both"}
SWEEPS = (
    sweep("rest", gamma=GAMMA, settle=200),
    sweep("ramp", gamma=GAMMA, settle=200, xi=0.1, protocol=RAMP),
)
IDS = tuple(spec.job_id(KERNEL_VERSION) for spec in SWEEPS)
jobs = st.integers(0, len(SWEEPS) - 1)


class Workers(Held):
    """Executor that computes or loses chunks on request, and notes chunks submitted after they were done."""

    def __init__(self, ledger: Ledger) -> None:
        super().__init__()
        self.ledger, self.submitted_again = ledger, list[tuple[str, int]]()

    def submit(self, spec: SweepSpec, chunk: Chunk, store_url: str, *terms: Any) -> "Future[ChunkReport]":
        with suppress(LedgerUnavailable):  # after a crash
            job = self.ledger.find(spec.job_id(KERNEL_VERSION))
            if job is not None and self.ledger.done_mask(job)[chunk.index]:
                self.submitted_again.append((spec.name, chunk.index))
        return super().submit(spec, chunk, store_url, *terms)

    def lose(self, error: Exception) -> None:
        """The first chunk comes back with an error."""
        with self.lock:
            future, *_ = self.chunks.pop(0)
        if future.set_running_or_notify_cancel():
            future.set_exception(error)

    def in_flight(self, name: str | None = None) -> int:
        with self.lock:
            return sum(
                name in (None, spec.name) and not future.cancelled() for future, spec, *_ in self.chunks
            )


class Machine(RuleBasedStateMachine):
    """The service's threads run; chunks come back when a rule says so."""

    def __init__(self) -> None:
        super().__init__()
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)  # of late writes
        self._settings = Settings(
            data=Path(self._folder.name), heartbeat_seconds=0.02, window_seconds=0, active_jobs=4
        )
        self.marked: dict[str, int] = {}  # chunks last seen as done, by job
        self.ended: dict[str, JobRecord] = {}  # jobs seen to end, until they are submitted again or deleted

    @initialize()
    def start(self) -> None:
        self.ledger = Ledger(self._settings.ledger_path)
        self.workers = Workers(self.ledger)
        self.manager = JobManager(self.ledger, self.workers, self._settings)
        self.manager.start()

    # Rules

    @rule(number=jobs)
    def submit(self, number: int) -> None:
        known = self._find(number)
        accepted = self.manager.submit(SWEEPS[number]).accepted
        if known is None:
            assert accepted
        elif known.state is JobState.DONE:
            assert not accepted
        if accepted:
            self.ended.pop(IDS[number], None)

    @rule(chunks=st.integers(1, 3))
    def compute(self, chunks: int) -> None:
        self._settle()
        for _ in range(min(chunks, self.workers.held())):
            self.workers.let_go()
        self._settle()

    @rule(error=st.sampled_from([WorkerDied, WorkerLost, WorkerLeft, ClusterLost]), all_=st.booleans())
    def lose(self, error: type[Exception], all_: bool) -> None:
        self._settle()
        for _ in range(self.workers.held() if all_ else min(self.workers.held(), 1)):
            self.workers.lose(error("gone"))

    @rule(number=jobs)
    def finish(self, number: int) -> None:
        """Compute until a job ends; one that is done has all outcomes stored."""
        job = self._find(number)
        if job is None or job.state not in UNFINISHED:
            return
        wait_for(lambda: self._computed_on(number))
        if self._found(number).state is JobState.DONE:
            assert np.all(self._outcomes(number) != Outcome.MISSING)

    @rule(number=jobs)
    def cancel(self, number: int) -> None:
        job = self._find(number)
        try:
            self.manager.cancel(IDS[number])
        except UnknownJob:
            assert job is None
        except IllegalTransition:
            assert self._found(number).state in (JobState.DONE, JobState.FAILED)

    @rule(number=jobs)
    def delete(self, number: int) -> None:
        job = self._find(number)
        try:
            self.manager.delete(IDS[number])
        except UnknownJob:
            assert job is None
        except IllegalTransition:
            assert job is not None
        else:
            assert self._find(number) is None
            self.marked.pop(IDS[number], None)
            self.ended.pop(IDS[number], None)

    @rule()
    def restart(self) -> None:
        self._stop()
        self.ledger.close()
        self.start()

    @rule()
    def crash(self) -> None:
        """The ledger closes first, while workers still compute their chunks."""
        self.ledger.close()
        while self.workers.held():
            self.workers.let_go()
        self._stop()
        self.start()

    @rule(number=jobs)
    def query(self, number: int) -> None:
        job = self._find(number)
        if job is None:
            return
        results = Stored(SWEEPS[number], self._url(number), job.state is JobState.DONE)
        line = diagram.compute(results, diagram.DiagramQuery())
        assert line.attrs["complete"] or job.state is not JobState.DONE

    # Invariants

    @invariant()
    def a_done_chunk_stays_done_and_is_not_computed_again(self) -> None:
        for job in self._jobs():
            assert job.chunks_done >= self.marked.get(job.id, 0)
            self.marked[job.id] = job.chunks_done
        assert not hasattr(self, "workers") or self.workers.submitted_again == []

    @invariant()
    def a_job_ends_once(self) -> None:
        for job in self._jobs():
            ended = self.ended.get(job.id)
            assert ended is None or (job.state, job.finished) == (ended.state, ended.finished)
            if job.state not in UNFINISHED:
                self.ended[job.id] = job

    @invariant()
    def counts_agree_with_the_chunks(self) -> None:
        for number in range(len(SWEEPS)):
            if hasattr(self, "ledger"):
                with self.ledger.reading() as reading:
                    job = reading.find(IDS[number])
                    if job is not None:
                        assert job.chunks_done == len(reading.done_chunks(job, 0, job.chunks_total))
                        assert (job.state is JobState.DONE) <= (job.chunks_done == job.chunks_total)
                        assert (job.chunks_done == job.chunks_total) == (job.cells_done == job.cells_total)

    @invariant()
    def nothing_of_an_ended_job_is_in_flight(self) -> None:
        for job in self._jobs():
            assert job.state in UNFINISHED or self.workers.in_flight(job.name) == 0

    def teardown(self) -> None:
        if hasattr(self, "manager"):
            self._stop()
            self.ledger.close()
        self._folder.cleanup()

    def _stop(self) -> None:
        """Stop as at the end of a process, with all threads."""
        self.manager.stop()
        self.manager.supervisor._thread.join()

    def _settle(self) -> None:
        """Until the service has taken in what came back, and submitted chunks of the unfinished jobs."""

        def is_settled() -> bool:
            unfinished = any(job.state in UNFINISHED for job in self._jobs())
            in_flight = self.workers.in_flight()
            return self.manager.supervisor.in_flight() == in_flight and (in_flight > 0 or not unfinished)

        wait_for(is_settled)

    def _computed_on(self, number: int) -> bool:
        if self.workers.held():
            self.workers.let_go()
        return self._found(number).state not in UNFINISHED

    def _jobs(self) -> list[JobRecord]:
        if not hasattr(self, "ledger"):  # before the first start
            return []
        return [job for number in range(len(SWEEPS)) if (job := self._find(number)) is not None]

    def _find(self, number: int) -> JobRecord | None:
        return self.ledger.find(IDS[number])

    def _found(self, number: int) -> JobRecord:
        job = self._find(number)
        assert job is not None
        return job

    def _url(self, number: int) -> str:
        return self._settings.store_of(self._found(number).store)

    def _outcomes(self, number: int) -> Any:
        return store.read_slice(self._url(number), ["outcome"], complete=True)["outcome"]


Machine.TestCase.settings = settings(
    max_examples=CASES, stateful_step_count=16, deadline=None, suppress_health_check=list(HealthCheck)
)
test_no_order_of_events_loses_anything = Machine.TestCase
