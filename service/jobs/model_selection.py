"""Jobs whose model is `auto`: a worker chooses it, and the ledger remembers the choice.

It is made before the first chunk is given to anybody and never again, so that all of a job is
computed by one model. A choice lost on the way is made anew, and comes out the same.
"""

import logging
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future
from typing import Any, Final

from pydantic import BaseModel, Field

from service.jobs.ledger import Ledger
from service.jobs.model import JobRecord
from worker.analysis.model_selection import Choice, choose, resolved
from worker.executors.base import Executor
from worker.executors.errors import ExecutorError, WorkerDied
from worker.plan import make_plan
from worker.spec import SweepSpec

log = logging.getLogger(__name__)

#: Workers that may be lost over one choice.
TRIES: Final = 3


class RungView(BaseModel):
    """One model beside the exact contact, over a sample of the sweep's cells; deviations in rad."""

    model: str
    cost: float = Field(description="core-µs a cell and plate period, by the table that decides")
    measured: float | None = Field(description="the same, as it went while choosing")
    median: float | None = Field(description="deviation of flight times; null where some cell has none")
    percentile_95: float | None
    cells: int
    resting: int = Field(0, description="of them on the plate throughout, which a closed form answers")


class ChoiceView(BaseModel):
    """The model that was chosen for a sweep whose own is `auto`."""

    model: str
    reason: str
    tolerance: float
    table: list[RungView]


class ModelSelector:
    """Choices under way; used by the supervisor's thread alone. `wake` is called when one has come in."""

    def __init__(self, ledger: Ledger, executor: Executor, wake: Callable[[], None]) -> None:
        self._ledger, self._executor, self._wake = ledger, executor, wake
        self._under_way: dict[str, Future[Choice]] = {}
        self._losses: Counter[str] = Counter()

    def settled(self, job: JobRecord) -> JobRecord | None:
        """The job, its model decided; None while a worker is choosing, or nobody is there to.

        Raises what choosing raised.
        """
        if job.choice is not None or SweepSpec.from_json(job.spec).model.kind != "auto":
            return job
        future = self._under_way.get(job.id)
        if future is None:
            self._ask(job)
            return None
        if not future.done():
            return None
        del self._under_way[job.id]
        choice = self._answer(job, future)
        return None if choice is None else self._remember(job, choice)

    def _ask(self, job: JobRecord) -> None:
        try:
            future = self._executor.call(choose, SweepSpec.from_json(job.spec))
        except ExecutorError as error:
            log.warning("nobody can choose a model for job %s: %s", job.id, error)
            return  # until the next look
        self._under_way[job.id] = future
        future.add_done_callback(lambda _: self._wake())

    def _answer(self, job: JobRecord, future: "Future[Choice]") -> Choice | None:
        """What was chosen; None if it is to be chosen again."""
        try:
            return future.result()
        except (ExecutorError, CancelledError) as error:
            log.warning("choosing a model for job %s: %s", job.id, error)
            self._losses[job.id] += isinstance(error, WorkerDied)
            if self._losses[job.id] < TRIES:
                return None
            del self._losses[job.id]
            raise

    def _remember(self, job: JobRecord, choice: Choice) -> JobRecord | None:
        spec = resolved(SweepSpec.from_json(job.spec), choice)
        plan = make_plan(spec)
        with self._ledger.writing() as ledger:
            ledger.choose(job, choice.model_dump_json(), plan.chunk_shape, len(plan))
            return ledger.find(job.id)


def choice_of(job: JobRecord) -> Choice | None:
    """What was chosen for a job; None for one that names its model, and while nothing is chosen."""
    return None if job.choice is None else Choice.model_validate_json(job.choice)


def computed_spec(job: JobRecord) -> SweepSpec:
    """The sweep as it is computed: a chosen model in the place of `auto`."""
    spec, choice = SweepSpec.from_json(job.spec), choice_of(job)
    return spec if choice is None else resolved(spec, choice)


def attributes_of(job: JobRecord) -> Mapping[str, Any]:
    """What a store says of the choice, the same for the same sweep."""
    choice = choice_of(job)
    return {} if choice is None else {"model": choice.model, "choice": choice.lasting()}
