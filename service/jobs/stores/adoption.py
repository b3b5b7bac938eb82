"""Adopts stores that the ledger does not know.

An older copy of the ledger lacks the jobs accepted since. Their stores have everything else: the
specification, the division into chunks, and the chunks, each with its seal.
"""

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from kernel.params import KERNEL_VERSION, KernelInputError, Outcome, checked_states
from service.errors import NotAdoptable
from service.jobs.prepare import new_job
from service.jobs.stores.opening import find_unknown, id_of
from service.ledger.ledger import Ledger
from service.ledger.model import JobRecord, JobState, NewJob
from service.settings import Settings
from worker import store
from worker.analysis.model_selection import ModelChoice, resolved
from worker.spec.errors import SpecError
from worker.studies import from_stored, study_of
from worker.study import Array, ChunkReport, Layout, Plan
from worker.study.chunks import report_of
from worker.sweep.specification import SweepSpec, is_open

#: Larger than any number of a cell: counts of flights and periods, and times in rad.
LARGEST: Final = 1e9

#: Outcomes of cells whose state is none that a motion continues from.
_WITHOUT_STATE: Final = (Outcome.MISSING, Outcome.UNRESOLVED, Outcome.DIVERGED)


def adopt(ledger: Ledger, settings: Settings, named: str, **labels: str) -> JobRecord:
    """Adopt a store as the job that it claims to be. Chunks that can be read whole are done.

    named: name or address of the store, or the id of its job, for the newest of the job's stores. The job is
    done if all chunks are, else failed: resuming it computes the others. labels: columns of the job that its
    store does not have. The store is not changed. Raises NotAdoptable if it is not a store of a job, or if
    the ledger knows the job.
    """
    job_id, named = id_of(Path(named).name), Path(named).name.removesuffix(".zarr")
    unknown = find_unknown(ledger, settings)
    same = (name for name in unknown if named in (id_of(name), name.removesuffix(".zarr")))
    name = next(same, f"{named}.zarr")
    url = settings.store_of(name)
    in_ledger = NotAdoptable(f"{url}: the ledger knows this job; delete it to adopt another store of it")
    if ledger.find(job_id) is not None:
        raise in_ledger
    try:
        job, layout, plan, choice = _contents(url, job_id)
    except (store.StoreError, SpecError, LookupError, TypeError, ValueError, RecursionError) as error:
        missing = isinstance(error, KeyError)
        reason = f"it has no attribute {error}" if missing else str(error).removeprefix(f"{url}: ")
        raise NotAdoptable(f"{url} cannot be adopted: {reason}") from error
    reports = _whole_chunks(url, layout, plan)
    now, state, lacking = time.time(), JobState.DONE, None
    if len(reports) < job.chunks_total:
        summary = f"{len(reports)} of {job.chunks_total} chunks were found whole in its store"
        state, lacking = JobState.FAILED, f"adopted: {summary}; resume it for the rest"
    with ledger.writing() as writing:
        if writing.find(job_id) is not None:
            raise in_ledger
        writing.insert(job, now, name)
        adopted = cast(JobRecord, writing.find(job_id))
        writing.update(
            adopted, state=state, started=now, finished=now, choice=choice, error=lacking, **labels
        )
        writing.mark_done(adopted, reports)
        return cast(JobRecord, writing.find(job_id))


def _contents(url: str, job_id: str) -> tuple[NewJob, Layout, Plan, str | None]:
    """Job, layout, plan and chosen model, from the store's attributes.

    Raises StoreError, SpecError, or the errors of unexpected attributes.
    """
    attrs = store.read_attrs(url)
    version = str(attrs["kernel_version"])
    spec = from_stored(json.dumps(attrs["spec"]))
    if not attrs["job"] == spec.job_id(version) == job_id:
        raise ValueError(f"it names job {attrs['job']}, its sweep is job {spec.job_id(version)}")
    plan: Plan = study_of(spec).plan(spec, tuple(attrs["chunk_shape"]))
    layout = study_of(spec).variables(spec, plan.chunk_shape)
    forms = store.stored_forms(url, None)
    outcome = forms["outcome"]
    if dict(zip(outcome.dims, outcome.chunks, strict=True)) != layout.chunk_sizes:
        raise ValueError(f"its attribute chunk_shape {attrs['chunk_shape']} is not that of its arrays")
    if version != KERNEL_VERSION:
        layout = layout.stored_as(forms)
    if lacking := sorted(set(layout.names) - set(forms)):
        raise ValueError(f"it has no array {', '.join(lacking)}")
    choice = _choice(attrs["choice"], spec) if is_open(spec) else None
    return new_job(spec, plan, version=version), layout, plan, choice


def _choice(stored: Any, spec: SweepSpec) -> str:
    """The chosen model of an `auto` sweep, without timings, which are not stored. Raises ValueError."""
    try:
        rows = [{**row, "measured": None} for row in stored["table"]]
        choice = ModelChoice.model_validate_json(json.dumps({**stored, "table": rows}))
        resolved(spec, choice)
    except (LookupError, TypeError, ValueError) as error:
        raise ValueError("its attribute choice is not the choice of a model") from error
    return choice.model_dump_json()


def _whole_chunks(url: str, layout: Layout, plan: Plan) -> list[ChunkReport]:
    """Reports of the chunks that can be read and have an outcome for every cell."""
    reports = []
    for chunk in plan:
        try:
            record = store.read_chunk(url, chunk, layout.names, complete=True)
        except store.StoreError:
            continue
        report = report_of(chunk, record, (0.0, 0.0))
        complete = len(report.outcomes) == len(Outcome) and not report.outcomes[Outcome.MISSING]
        if complete and all(_possible(array, record) for array in layout.arrays):
            reports.append(report)
    return reports


def _possible(array: Array, record: Mapping[str, NDArray[Any]]) -> bool:
    """Whether values are within the range of an array: a store may be written by others, with valid seals."""
    values = record[array.name]
    if "state" in array.dims:  # of cells, or of their attractors
        stopped = np.isin(record.get("attractor_outcome", record["outcome"]), _WITHOUT_STATE)
        try:
            checked_states(values[~stopped], int(np.sum(~stopped)))
        except KernelInputError:
            return False
    if (flags := array.attrs.get("flag_values")) is not None:
        return bool(np.isin(values, flags).all())
    if values.dtype.kind == "f":
        return bool((~np.isfinite(values) | (np.abs(values) < LARGEST)).all())
    least = -1 if array.name.startswith("next_") else 0
    return values.dtype.kind == "c" or bool(((values >= least) & (values < LARGEST)).all())
