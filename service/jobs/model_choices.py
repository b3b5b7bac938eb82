"""Has workers choose the models of `auto` sweeps, before a job's first chunk."""

import logging
from collections import Counter
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from typing import Final

from service.jobs.prepare import JobPreparer
from service.ledger.ledger import Ledger
from service.ledger.model import JobRecord
from worker.analysis.model_selection import ModelChoice, choose, resolved
from worker.executors.base import Executor, ExecutorError, WorkerDied
from worker.sweep.specification import is_open

log = logging.getLogger(__name__)

#: Workers that may die while choosing one model before the job fails.
MAX_DEATHS: Final = 3


class ModelChoices:
    """The choices under way; calls `on_chosen` after each. Used by the supervisor's thread."""

    def __init__(
        self, ledger: Ledger, executor: Executor, preparer: JobPreparer, on_chosen: Callable[[], None]
    ) -> None:
        self._ledger, self._executor, self._preparer = ledger, executor, preparer
        self._on_chosen = on_chosen
        self._choosing: dict[str, Future[ModelChoice]] = {}  # by job id
        self._deaths: Counter[str] = Counter()  # of workers, by job id

    def __len__(self) -> int:
        return len(self._choosing)

    def chosen(self, job: JobRecord) -> JobRecord | None:
        """The job with its model; None until a worker has chosen it. Raises ExecutorError."""
        submitted = self._preparer.prepare(job).submitted
        if job.choice is not None or not is_open(submitted):
            return job
        try:
            if job.id not in self._choosing:
                self._choosing[job.id] = self._executor.call(choose, submitted)
                self._choosing[job.id].add_done_callback(lambda _: self._on_chosen())
            if not self._choosing[job.id].done():
                return None
            choice = self._choosing.pop(job.id).result()
        except (ExecutorError, CancelledError) as error:  # the next sync tries again
            log.warning("job %s: choosing its model failed: %s", job.id, error)
            self._deaths[job.id] += isinstance(error, WorkerDied)
            if self._deaths[job.id] < MAX_DEATHS:
                return None
            del self._deaths[job.id]
            raise
        plan = self._preparer.plan(resolved(submitted, choice))  # chunks for the cost of the chosen model
        with self._ledger.writing() as ledger:
            ledger.choose(job, choice.model_dump_json(), plan.chunk_shape, len(plan))
            return ledger.find(job.id)
