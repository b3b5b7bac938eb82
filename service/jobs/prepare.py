"""Prepares jobs: parses the specification, chooses the model and makes the plan, once."""

import json
import logging
import threading
from collections import Counter, OrderedDict
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

from kernel.params import KERNEL_VERSION
from service.errors import LedgerUnusable
from service.ledger.ledger import MEND, Ledger
from service.ledger.model import JobRecord, NewJob
from service.settings import Settings
from worker import store
from worker.analysis.model_selection import ModelChoice, choose, resolved
from worker.executors.base import Executor, ExecutorError, WorkerDied
from worker.studies import from_stored, study_of
from worker.study import Chunk, Cost, Layout, Plan, Study
from worker.sweep.specification import is_open

log = logging.getLogger(__name__)

#: Limits on the prepared jobs kept, and on the characters of their specifications together.
MAX_JOBS: Final = 128
MAX_SPEC_CHARS: Final = 8_000_000

#: Workers that may die while they choose a model before the job fails.
MAX_DEATHS: Final = 3


@dataclass(frozen=True)
class PreparedJob:
    """A job's specification and plan, and the address of its results."""

    submitted: Any  # the specification as submitted: the job's identity, recorded in the store
    spec: Any  # `submitted` with the chosen model in place of `auto`
    plan: Plan
    store_url: str
    attributes: Mapping[str, Any]  # of the store, beside the layout's: the chosen model
    outdated: bool = False  # another kernel version computed it, whose store may differ

    @property
    def study(self) -> Study:
        """The job's kind of study."""
        return study_of(self.submitted)

    @cached_property
    def layout(self) -> Layout:
        """The layout of the store."""
        today = self.study.variables(self.submitted, self.plan.chunk_shape)
        if not self.outdated:
            return today
        try:  # variables added since are not there, which is no damage
            stored = store.stored_forms(self.store_url, None)
        except store.StoreError:
            return today
        return today.stored_as(stored)

    @cached_property
    def forms(self) -> Mapping[str, store.ArrayForm] | None:
        """The forms of the arrays; None for an outdated job, whose forms only the store knows."""
        return None if self.outdated else store.forms_in(self.layout)

    @cached_property
    def metadata(self) -> Mapping[str, bytes] | None:
        """The store's metadata and coordinates by key; None for an outdated job."""
        return None if self.outdated else store.metadata_of(self.layout, self.attributes)

    @cached_property
    def cost(self) -> Cost:
        """The job's cost by the cost table."""
        return self.study.estimate(self.spec, self.plan)

    def read_file(self, key: str, *, complete: bool = False, begun: bool = False) -> bytes | None:
        """The checked bytes of a file of the store; None if it has none, or if the layout allows none.

        complete: whether everything was written, so that a missing file is damage. begun: whether a chunk
        was, so that missing metadata are. Raises StoreDamaged.
        """
        begun |= complete
        if not self.layout.has_key(key):
            return None
        if key.partition("/")[0] in self.layout.names and not key.endswith("zarr.json"):
            try:
                forms = store.stored_forms(self.store_url, self.forms)
                return store.read_file(self.store_url, key, forms, complete=complete)
            except store.StoreMissing as error:
                if begun:
                    raise store.StoreDamaged(str(error)) from error
                return None  # the store is created with the first chunk
        content = store.read_key(self.store_url, key)
        checked = begun or content is not None
        if checked and self.metadata is not None and content != self.metadata.get(key):
            raise store.StoreDamaged(f"{key}: is not what the store's specification says")
        return content

    def describe(self, chunk: Chunk) -> str:
        """A chunk's number and cells: `chunk 3 (up, gamma 1 to 1.5, omega 0.5, xi 0.26)`."""
        return f"chunk {chunk.index} ({self.layout.describe(chunk.slices)})"


def new_job(spec: Any, plan: Plan, owner: str | None = None, version: str = KERNEL_VERSION) -> NewJob:
    """A study as a job to accept."""
    return NewJob(
        id=spec.job_id(version),
        name=spec.name,
        spec=json.dumps(spec.as_submitted()),
        kernel_version=version,
        chunk_shape=plan.chunk_shape,
        chunks_total=len(plan),
        cells_total=plan.cells,
        first_cells=study_of(spec).first_cells(spec, plan),
        owner=owner,
    )


class JobPreparer:
    """Prepares jobs and keeps the last used. Its methods may be called from any thread."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._jobs: OrderedDict[Any, tuple[PreparedJob, int]] = OrderedDict()  # with the characters

    def plan(self, spec: Any) -> Plan:
        """The plan of a new study."""
        return study_of(spec).plan(spec, longest=self._settings.longest_chunk_seconds)

    def prepare(self, job: JobRecord) -> PreparedJob:
        """The prepared job, from the cache unless it was accepted again or its model was chosen since.

        Raises LedgerUnusable for a specification that is not the job's, or that this release refuses.
        """
        # `seq` distinguishes a job from a deleted one with its id; the others change with the chosen model
        key = job.id, job.seq, job.chunk_shape, job.choice
        with self._lock:  # held while preparing, so that simultaneous requests prepare a job once
            if key not in self._jobs:
                self._jobs[key] = (self._prepared(job), len(job.spec))
            self._jobs.move_to_end(key)
            while len(self._jobs) > 1 and (
                len(self._jobs) > MAX_JOBS or sum(chars for _, chars in self._jobs.values()) > MAX_SPEC_CHARS
            ):
                self._jobs.popitem(last=False)
            return self._jobs[key][0]

    def _prepared(self, job: JobRecord) -> PreparedJob:
        try:
            submitted, choice = from_stored(job.spec), choice_of(job)
            spec = submitted if choice is None else resolved(submitted, choice)
            plan = study_of(submitted).plan(submitted, job.chunk_shape)
        except (LookupError, TypeError, ValueError) as error:
            raise LedgerUnusable(f"this release cannot read the ledger's job {job.id}: {error}") from error
        if submitted.job_id(job.kernel_version) != job.id or len(plan) != job.chunks_total:
            rule = "its specification and chunks are not those of its id"
            raise LedgerUnusable(f"the ledger is damaged: job {job.id}: {rule}: {MEND}")
        return PreparedJob(
            submitted=submitted,
            spec=spec,
            plan=plan,
            store_url=self._settings.store_of(job.store),
            attributes={} if choice is None else {"model": choice.model, "choice": choice.reproducible()},
            outdated=job.outdated,
        )


def choice_of(job: JobRecord) -> ModelChoice | None:
    """The model chosen for a job; None before the choice, or if it names its model. Raises LedgerUnusable."""
    try:
        return None if job.choice is None else ModelChoice.model_validate_json(job.choice)
    except ValueError as error:
        raise LedgerUnusable(f"the ledger is damaged: job {job.id}: its choice is invalid: {MEND}") from error


class ModelChoices:
    """Has workers choose the models of `auto` sweeps before a job's first chunk.

    Calls `on_chosen` after each choice. Used only by the supervisor's thread.
    """

    def __init__(
        self, ledger: Ledger, executor: Executor, preparer: JobPreparer, on_chosen: Callable[[], None]
    ) -> None:
        self._ledger, self._executor, self._preparer = ledger, executor, preparer
        self._on_chosen = on_chosen
        self._choosing: dict[str, Future[ModelChoice]] = {}  # by job id
        self._deaths: Counter[str] = Counter()  # of workers, by job id

    def __len__(self) -> int:
        """Number of jobs that wait for a worker; a job whose model is chosen competes for a place."""
        return sum(not choice.done() for choice in self._choosing.values())

    def keep(self, job_ids: set[str]) -> None:
        """Forget the choices of all other jobs: they were cancelled or deleted."""
        for job_id in self._choosing.keys() - job_ids:
            self._choosing.pop(job_id).cancel()
        self._deaths = Counter({job_id: n for job_id, n in self._deaths.items() if job_id in job_ids})

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
