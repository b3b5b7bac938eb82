"""Sweeps within a time at a service: a thread computes their levels as jobs and has the last level audited.

Levels are plain jobs. A budget ends when the service stops; an unfinished level continues at the next start,
like any job.
"""

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, Final
from uuid import uuid4

from service.budget import check, within
from service.errors import Busy, IllegalTransition, RunFailed, ServiceError, UnknownJob
from service.jobs.manager import JobManager, Submission
from service.ledger.ledger import Ledger
from service.ledger.model import UNFINISHED, JobRecord, JobState
from worker.spec.errors import SpecError
from worker.sweep import SweepSpec
from worker.sweep.levels import Steps

log = logging.getLogger(__name__)

#: Limits on the budgets that go on at a time, and on those that are remembered.
MOST, KEPT = 8, 64
#: Two budgets of a sweep that end within this many seconds come from one request, repeated.
SAME_SECONDS: Final = 1.0
#: Seconds between two checks of a level.
LOOK_SECONDS: Final = 0.05
#: Share of the time left that a budget waits for the comparison of two levels.
COMPARING: Final = 0.1

#: The sentence of a job's audit; None if it takes longer than this many seconds.
Audit = Callable[[JobRecord, float], str | None]
#: The share of a level's cells where the level before it shows another mode; None if that cannot be read
#: within this many seconds.
Changed = Callable[[JobRecord, JobRecord, float], float | None]


class Budgets:
    """The budgets of a service. Its methods may be called from any thread."""

    def __init__(self, manager: JobManager, ledger: Ledger, audit: Audit, changed: Changed) -> None:
        self.manager, self.ledger, self.audit, self.changed = manager, ledger, audit, changed
        self.stopping = threading.Event()
        self._lock = threading.Lock()
        self._budgets: list[Budget] = []  # those that go on, the last begun first; then the others
        self.own = set[str]()  # ids of jobs that only budgets asked for, and so may cancel

    def begin(self, spec: Any, seconds: float, owner: str | None) -> "tuple[Submission, Budget]":
        """Begin a budget; its first submission, and the budget. A repeated request joins its budget.

        Raises SpecInvalid, Busy, and as `JobManager.submit`.
        """
        check(spec.protocol.kind, seconds)
        self.manager.check(spec)
        ends = time.monotonic() + seconds
        with self._lock:
            same = [budget for budget in self._budgets if budget.spec == spec]
            repeated = (old for old in same if not old.over and abs(old.ends - ends) < SAME_SECONDS)
            joined = budget = next(repeated, None)
            if budget is None:
                going = [budget for budget in self._budgets if not budget.over]
                if len(going) >= MOST:
                    raise Busy(f"{MOST} budgets go on already, which is the limit")
                known = next((old.steps for old in same if old.answer), None)
                budget = Budget(self, spec, seconds, owner, known)
                # without a thread it would count as one that goes on
                threading.Thread(target=budget.run, name="budget", daemon=True).start()
                self._budgets = [budget, *sorted(self._budgets, key=lambda old: old.over)][:KEPT]
        job, accepted = budget.first.result()
        return Submission(job, accepted and joined is None), budget

    def may_cancel(self, job_id: str) -> bool:
        """Whether only one budget needs a job."""
        with self._lock:
            users = [budget for budget in self._budgets if budget.computing == job_id]
        return job_id in self.own and len(users) <= 1

    def of(self, job_id: str, budget_id: str | None = None) -> "Budget | None":
        """The budget with this id that has this job as a level; by default the newest with this level."""
        with self._lock:
            with_level = (budget for budget in self._budgets if job_id in budget.levels)
            return next((budget for budget in with_level if budget_id in (None, budget.id)), None)

    def close(self) -> None:
        """Begin no further level."""
        self.stopping.set()


class Budget:
    """A sweep within a time, and its progress. In its own thread it is a `service.budget.Runner`."""

    def __init__(
        self, budgets: Budgets, spec: SweepSpec, seconds: float, owner: str | None, known: Steps | None
    ) -> None:
        self._budgets, self.spec, self._owner, self.id = budgets, spec, owner, uuid4().hex
        manager = budgets.manager
        self.seconds, self.is_done, self.took = manager.seconds, manager.is_done, manager.took
        self._began = time.monotonic()
        self.ends = self._began + seconds
        self.steps = known  # of the finest level that is done
        self.first: Future[Submission] = Future()
        self.levels: tuple[str, ...] = ()  # ids of their jobs
        self.doing = ""  # the present step, in words
        self._why = ""  # why no finer level came, unless time ran out
        self.computing: str | None = None  # id of the job of the present level
        self.answer: str | None = None  # id of the job of the finest level that is done
        self.error: str | None = None
        self.over = False

    @property
    def seconds_left(self) -> int:
        """Seconds until the time is over."""
        return 0 if self.over else max(round(self.ends - time.monotonic()), 0)

    def run(self) -> None:
        """Compute levels until the time is over."""
        seconds = self.ends - self._began
        try:
            answer = within(self.spec, seconds, self, self._show, began=self._began, known=self.steps)
            self.steps = answer.levels[-1].steps
        except Exception as error:  # shown by the request, or with the first level
            text = str(error)
            if not isinstance(error, SpecError | ServiceError):
                text = "it could not go on; the log says why"
                log.exception("a budget ends")
            if self.answer is None:
                self.error = text
            self.doing = f"no audit: {text}"
            if not self.first.done():
                self.first.set_exception(error)
        self.computing, self.over = None, True

    def _show(self, text: str, left: float) -> None:
        self.doing = text + self._why

    def compute(self, spec: SweepSpec, seconds: float) -> bool:
        deadline = time.monotonic() + seconds
        try:
            job, accepted = first = self._budgets.manager.submit(spec, owner=self._owner)
        except (SpecError, ServiceError):  # such as a full queue
            if self.answer is None:
                raise
            return False
        self.levels, self.computing = (*self.levels, job.id), job.id
        if accepted:
            self._budgets.own.add(job.id)
        if not self.first.done():
            self.first.set_result(first)
        record = self._ended(job, deadline)
        if record is None and self._budgets.may_cancel(job.id) and not self._budgets.stopping.is_set():
            with suppress(IllegalTransition, UnknownJob):  # it has just ended
                self._budgets.manager.cancel(job.id)
        self.computing = None
        if record is not None and record.state is JobState.DONE:
            self.answer = job.id
            return True
        if record is not None and self.answer is None:
            raise RunFailed(record.error or "the first level was cancelled")
        if record is not None:
            self._why = f"; a finer level is {record.state}{f': {record.error}' if record.error else ''}"
        return False

    def changed(self) -> float | None:
        before, last = map(self._budgets.ledger.find, self.levels[-2:])
        if before is None or last is None:
            return None
        return self._budgets.changed(last, before, COMPARING * (self.ends - time.monotonic()))

    def audit(self, seconds: float) -> str | None:
        job = self._budgets.ledger.find(self.answer or "")
        return None if job is None else self._budgets.audit(job, seconds)

    def _ended(self, job: JobRecord, deadline: float) -> JobRecord | None:
        """The job once it has ended; None at the deadline, or if the service stops. Raises RunFailed."""
        record: JobRecord | None = job
        while record is not None and record.state in UNFINISHED:
            if time.monotonic() > deadline or self._budgets.stopping.wait(LOOK_SECONDS):
                return None
            record = self._budgets.ledger.find(job.id)
        if record is None:
            raise RunFailed("a level was deleted")
        return record
