"""Submit, compute, cancel, crash, restart, delete and query in any order: what is done stays done.

`BOUNCE_TEST_CASES=500` for the long version.
"""

import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from scripted import Held, sweep, wait_for

from kernel.params import KERNEL_VERSION, Outcome
from service.errors import IllegalTransition, UnknownJob
from service.jobs.ledger import Ledger
from service.jobs.manager import JobManager
from service.jobs.model import UNFINISHED, JobRecord, JobState
from service.results import diagram
from service.results.selection import Sweep
from service.settings import Settings
from worker import store

CASES = int(os.environ.get("BOUNCE_TEST_CASES", "8"))

SWEEPS = (
    sweep("rest", gamma={"start": 0.5, "stop": 1.2, "num": 12}, settle=5000),
    sweep("ramp", gamma={"start": 0.5, "stop": 1.2, "num": 12}, settle=5000, xi=0.1,
          protocol={"kind": "ramp", "axis": "gamma", "direction": "both"}),
)  # fmt: skip
jobs = st.integers(0, len(SWEEPS) - 1)


class Machine(RuleBasedStateMachine):
    """The service's threads run; the rules `compute` and `finish` compute chunks."""

    def __init__(self) -> None:
        super().__init__()
        self._folder = tempfile.TemporaryDirectory()
        self._settings = Settings(
            data=Path(self._folder.name), heartbeat_seconds=0.02, window_seconds=0, active_jobs=4
        )
        self.marked: dict[str, int] = {}  # the number of chunks last seen as done, by job

    @initialize()
    def start(self) -> None:
        self.held = Held()
        self.ledger = Ledger(self._settings.ledger_path)
        self.manager = JobManager(self.ledger, self.held, self._settings)
        self.manager.start()

    @rule(number=jobs)
    def submit(self, number: int) -> None:
        known = self._find(number)
        accepted = self.manager.submit(SWEEPS[number]).accepted
        if known is None:
            assert accepted
        elif known.state is JobState.DONE:
            assert not accepted

    @rule(chunks=st.integers(1, 9))
    def compute(self, chunks: int) -> None:
        for _ in range(chunks):
            if self.held.held():
                self.held.let_go()

    @rule(number=jobs)
    def finish(self, number: int) -> None:
        """Compute until a job ends; unless it was cancelled it ends done, with all outcomes stored."""
        job = self._find(number)
        if job is None or job.state not in UNFINISHED:
            return
        wait_for(lambda: self._computed_on(number))
        job = self._found(number)
        if job.state is JobState.DONE:
            assert job.chunks_done == job.chunks_total
            assert np.all(self._outcomes(number) != Outcome.MISSING)

    @rule(number=jobs)
    def cancel(self, number: int) -> None:
        job = self._find(number)
        try:
            self.manager.cancel(SWEEPS[number].job_id(KERNEL_VERSION))
        except UnknownJob:
            assert job is None
        except IllegalTransition:
            assert self._found(number).state in (JobState.DONE, JobState.FAILED)

    @rule(number=jobs)
    def delete(self, number: int) -> None:
        job = self._find(number)
        try:
            self.manager.delete(SWEEPS[number].job_id(KERNEL_VERSION))
        except UnknownJob:
            assert job is None
        except IllegalTransition:
            assert job is not None
        else:
            assert self._find(number) is None
            self.marked.pop(SWEEPS[number].job_id(KERNEL_VERSION), None)

    def _stop(self) -> None:
        """Stop as at the end of a process, with all threads."""
        self.manager.stop()
        for part in (self.manager._scrubber, self.manager._supervisor, self.manager._deleter):
            part._thread.join()

    @rule()
    def restart(self) -> None:
        self._stop()
        self.ledger.close()
        self.start()

    @rule()
    def crash(self) -> None:
        """The ledger closes first, while workers still compute their chunks."""
        self.ledger.close()
        while self.held.held():
            self.held.let_go()
        self._stop()
        self.start()

    @rule(number=jobs)
    def query(self, number: int) -> None:
        job = self._find(number)
        if job is None:
            return
        found = Sweep(SWEEPS[number], self._url(number), job.state is JobState.DONE)
        for direction in SWEEPS[number].directions:
            line = diagram.diagram(found, "gamma", {}, direction, 0.0, 10_000)
            assert line.complete or job.state is not JobState.DONE

    @invariant()
    def what_is_done_stays_done(self) -> None:
        if not hasattr(self, "ledger"):
            return
        for number, spec in enumerate(SWEEPS):
            job = self._find(number)
            if job is not None:
                assert job.chunks_done >= self.marked.get(job.id, 0), spec.name
                assert (job.state is JobState.DONE) <= (job.chunks_done == job.chunks_total)
                self.marked[job.id] = job.chunks_done

    def teardown(self) -> None:
        if hasattr(self, "manager"):
            self._stop()
            self.ledger.close()
        self._folder.cleanup()

    def _computed_on(self, number: int) -> bool:
        if self.held.held():
            self.held.let_go()
        return self._found(number).state not in UNFINISHED

    def _find(self, number: int) -> JobRecord | None:
        return self.ledger.find(SWEEPS[number].job_id(KERNEL_VERSION))

    def _found(self, number: int) -> JobRecord:
        job = self._find(number)
        assert job is not None
        return job

    def _url(self, number: int) -> str:
        return self._settings.store_of(SWEEPS[number].job_id(KERNEL_VERSION))

    def _outcomes(self, number: int) -> Any:
        return store.read_slice(self._url(number), ["outcome"], complete=True)["outcome"]


Machine.TestCase.settings = settings(
    max_examples=CASES, stateful_step_count=12, deadline=None, suppress_health_check=list(HealthCheck)
)
test_no_order_of_events_loses_anything = Machine.TestCase
