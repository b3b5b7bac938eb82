"""Jobs whose model is `auto`: a worker chooses the model, and the ledger keeps the choice.

The choice is made once, before the first chunk is submitted, so that one model computes the
whole job. A choice lost with its worker is repeated, with the same result.
"""

import logging
from collections import Counter
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from typing import Final

from service.jobs.ledger import Ledger
from service.jobs.model import JobRecord
from service.jobs.prepare import JobPreparer
from worker.analysis.model_selection import ModelChoice, choose, is_open, resolved
from worker.executors.base import Executor
from worker.executors.errors import ExecutorError, WorkerDied

log = logging.getLogger(__name__)

#: Workers that may die while choosing one model before the job fails.
MAX_WORKER_DEATHS: Final = 3


class ModelSelector:
    """Chooses models on the executor; used only by the supervisor's thread.

    `wake` is called, in any thread, when a worker has made a choice.
    """

    def __init__(
        self, ledger: Ledger, executor: Executor, preparer: JobPreparer, wake: Callable[[], None]
    ) -> None:
        self._ledger, self._executor, self._preparer, self._wake = ledger, executor, preparer, wake
        self._pending: dict[str, Future[ModelChoice]] = {}  # by job id
        self._worker_deaths: Counter[str] = Counter()

    @property
    def pending(self) -> int:
        """Jobs for which a worker is choosing."""
        return len(self._pending)

    def select(self, job: JobRecord) -> JobRecord | None:
        """The job with its model chosen; None until a worker has chosen one.

        Raises the errors of choosing.
        """
        if job.choice is not None or not is_open(self._preparer.prepare(job).submitted):
            return job
        future = self._pending.get(job.id)
        if future is None:
            self._begin(job)
            return None
        if not future.done():
            return None
        del self._pending[job.id]
        choice = self._result(job, future)
        return None if choice is None else self._save(job, choice)

    def _begin(self, job: JobRecord) -> None:
        try:
            future = self._executor.call(choose, self._preparer.prepare(job).submitted)
        except ExecutorError as error:
            log.warning("job %s: no worker can choose its model: %s", job.id, error)
            return  # the next sync tries again
        self._pending[job.id] = future
        future.add_done_callback(lambda _: self._wake())

    def _result(self, job: JobRecord, future: "Future[ModelChoice]") -> ModelChoice | None:
        """The choice; None if it must be repeated."""
        try:
            return future.result()
        except (ExecutorError, CancelledError) as error:
            log.warning("job %s: choosing its model failed: %s", job.id, error)
            self._worker_deaths[job.id] += isinstance(error, WorkerDied)
            if self._worker_deaths[job.id] < MAX_WORKER_DEATHS:
                return None
            del self._worker_deaths[job.id]
            raise

    def _save(self, job: JobRecord, choice: ModelChoice) -> JobRecord | None:
        """Write the choice to the ledger, with chunks for the cost of the chosen model."""
        submitted = self._preparer.prepare(job).submitted
        plan = self._preparer.plan(resolved(submitted, choice))
        with self._ledger.writing() as ledger:
            ledger.choose(job, choice.model_dump_json(), plan.chunk_shape, len(plan))
            chosen = ledger.find(job.id)
        if chosen is not None:
            self._preparer.seed(chosen, submitted, plan)
        return chosen
