"""A job prepared to run or to be read: its specification parsed, its plan made, once per job.

Supervisor, scrubber and every request for results need the same four values of a job.
`JobPreparer` creates them once and keeps them; a submission passes in its specification and plan.
"""

import json
import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

from kernel.params import KERNEL_VERSION
from service.jobs.model import JobRecord, NewJob
from service.settings import Settings
from worker import store
from worker.analysis.model_selection import ModelChoice, resolved
from worker.cost import Cost
from worker.refinement import first_round
from worker.schema import Layout
from worker.studies import Chunk, Plan, from_json, parse, study_of
from worker.tasks import Study

#: Prepared jobs kept, the last used, and the maximum characters of their specifications together.
MAX_JOBS: Final = 128
MAX_SPEC_CHARS: Final = 8_000_000

#: Fields of a sweep with stricter rules than under kernel version 1; no reader of results uses them.
BOUNDED_SINCE: Final = ("settle_tolerance", "name")

#: What a prepared job depends on. `seq` distinguishes a job from a deleted one with the same id; the chunk
#: shape and the choice change when the model of an `auto` sweep is chosen.
_Key = tuple[str, int, tuple[int, ...], str | None]


@dataclass(frozen=True)
class PreparedJob:
    """A job's specification and plan, and the location of its results."""

    job_id: str
    submitted: Any  # the study's specification: the job's identity, recorded in the store
    spec: Any  # `submitted` with the chosen model in place of `auto`
    plan: Plan
    store_url: str
    attributes: Mapping[str, Any]  # of the store: the chosen model, the same for the same sweep
    outdated: bool = False  # computed by another kernel version, whose store may differ

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
        try:  # without variables added since: their absence is no damage
            there = store.stored_forms(self.store_url, None)
        except store.StoreError:
            return today
        return replace(today, arrays=tuple(array for array in today.arrays if array.name in there))

    @cached_property
    def forms(self) -> Mapping[str, store.ArrayForm] | None:
        """The forms of the arrays; None for an outdated job, whose store alone knows."""
        return None if self.outdated else store.forms_in(self.layout)

    @cached_property
    def metadata(self) -> Mapping[str, bytes] | None:
        """Metadata and coordinates of the store by key; None for an outdated job."""
        return None if self.outdated else store.metadata_of(self.layout, self.attributes)

    @property
    def core_seconds(self) -> float:
        """Core-seconds of the whole job, by the cost table."""
        return self._cost.core_seconds

    @cached_property
    def cell_seconds(self) -> float:
        """Mean core-seconds of a cell, by the cost table."""
        return self._cost.core_seconds / self._cost.cells

    @cached_property
    def longest_cell_seconds(self) -> float:
        """Core-seconds of a cell that settles for as long as allowed, by the cost table."""
        return (self._cost.longest_core_seconds or self._cost.core_seconds) / self._cost.cells

    @cached_property
    def _cost(self) -> Cost:
        return self.study.estimate(self.spec, self.plan)

    def read_file(self, key: str) -> bytes | None:
        """The store's bytes under a key, if they are what the job stores there; None without any.

        Raises StoreDamaged.
        """
        if not self.layout.has_key(key):
            return None
        if key.partition("/")[0] in self.layout.names and not key.endswith("zarr.json"):
            forms = store.stored_forms(self.store_url, self.forms)
            return store.read_file(self.store_url, key, forms)
        content = store.read_key(self.store_url, key)
        if content is not None and self.metadata is not None and content != self.metadata.get(key):
            raise store.StoreDamaged(f"{key}: is not what the store's specification says")
        return content

    def describe(self, chunk: Chunk) -> str:
        """A chunk's number and cells: `chunk 3 (up, gamma 1 to 1.5, omega 0.5, xi 0.26)`."""
        return f"chunk {chunk.index} ({self.layout.describe(chunk.slices)})"


def new_job(spec: Any, plan: Plan, owner: str | None = None, version: str = KERNEL_VERSION) -> NewJob:
    """A study as a job to accept."""
    refine = getattr(spec, "refine", None)
    return NewJob(
        id=spec.job_id(version),
        name=spec.name,
        spec=json.dumps(spec.as_submitted()),
        kernel_version=version,
        chunk_shape=plan.chunk_shape,
        chunks_total=len(plan),
        cells_total=plan.cells,
        first_cells=0 if refine is None else first_round(spec.shape[1:], plan.chunk_shape, refine),
        owner=owner,
    )


class JobPreparer:
    """Prepares jobs and keeps the last used. Its methods may be called from any thread."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._jobs: OrderedDict[_Key, tuple[PreparedJob, int]] = OrderedDict()  # with the characters
        self._chars = 0

    def plan(self, spec: Any) -> Plan:
        """The plan of a new study."""
        plan: Plan = study_of(spec).plan(spec, longest=self._settings.longest_chunk_seconds)
        return plan

    def prepare(self, job: JobRecord) -> PreparedJob:
        """The job, prepared; again after it was accepted again or its model was chosen.

        Raises SpecError for a specification that this version does not accept.
        """
        with self._lock:  # held while preparing, so that simultaneous requests prepare a job once
            known = self._jobs.get(_key(job))
            if known is not None:
                self._jobs.move_to_end(_key(job))
                return known[0]
            return self._keep(job, parse_stored(job.spec, job.kernel_version), None)

    def seed(self, job: JobRecord, submitted: Any, plan: Plan) -> None:
        """Keep what the caller has already prepared of the job.

        `submitted`: the parsed `job.spec`; `plan`: in chunks of `job.chunk_shape`.
        """
        with self._lock:
            self._keep(job, submitted, plan)

    def _keep(self, job: JobRecord, submitted: Any, plan: Plan | None) -> PreparedJob:
        choice = choice_of(job)
        prepared = PreparedJob(
            job_id=job.id,
            submitted=submitted,
            spec=submitted if choice is None else resolved(submitted, choice),
            plan=_plan(job, submitted) if plan is None else plan,
            store_url=self._settings.store_of(job.id),
            attributes={} if choice is None else {"model": choice.model, "choice": choice.reproducible()},
            outdated=job.outdated,
        )
        _, replaced = self._jobs.pop(_key(job), (None, 0))
        self._jobs[_key(job)] = (prepared, len(job.spec))
        self._chars += len(job.spec) - replaced
        while len(self._jobs) > 1 and (len(self._jobs) > MAX_JOBS or self._chars > MAX_SPEC_CHARS):
            _, (_, chars) = self._jobs.popitem(last=False)
            self._chars -= chars
        return prepared


def choice_of(job: JobRecord) -> ModelChoice | None:
    """The model chosen for a job; None if it names its model, and until the choice is made."""
    return None if job.choice is None else ModelChoice.model_validate_json(job.choice)


def _key(job: JobRecord) -> _Key:
    return job.id, job.seq, job.chunk_shape, job.choice


def parse_stored(text: str, kernel_version: str) -> Any:
    """A job's specification; for an outdated job by the rules of its time, so that it can be read.

    Raises SpecError.
    """
    if kernel_version == KERNEL_VERSION:
        return from_json(text)
    fields = json.loads(text)
    kept = {name: fields.pop(name) for name in BOUNDED_SINCE if name in fields}
    spec = parse(fields)
    return spec.model_copy(update=kept) if kept else spec


def _plan(job: JobRecord, spec: Any) -> Plan:
    plan: Plan = study_of(spec).plan(spec, job.chunk_shape)
    return plan
