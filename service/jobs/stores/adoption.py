"""Stores unknown to the ledger: found, and adopted as jobs from their own metadata.

An older copy of the ledger does not know the jobs accepted since. Their stores have everything else: the
specification, the division into chunks, and the chunks, each with its checksums.
"""

import json
import logging
import re
import time
from collections.abc import Iterator
from functools import partial
from typing import Any, Final, NamedTuple

from kernel.params import Outcome
from service.errors import NotAdoptable
from service.jobs.ledger import Ledger
from service.jobs.model import JobRecord, NewJob
from service.jobs.prepare import first_cells, parse_stored
from service.jobs.stores.marker import StoresMarker
from service.settings import Settings
from worker import store
from worker.analysis.model_selection import ModelChoice
from worker.schema import COMPUTED, Layout
from worker.spec.errors import SpecError
from worker.store import StoreError
from worker.studies import Plan, study_of
from worker.tasks import ChunkReport

log = logging.getLogger(__name__)

_STORE_NAME: Final = re.compile(r"([0-9a-f]{32})\.zarr")


class _Contents(NamedTuple):
    """What a store says about itself."""

    job: NewJob
    plan: Plan
    layout: Layout
    choice: str | None


def find_unknown(ledger: Ledger, settings: Settings) -> list[str]:
    """Sorted addresses of the stores without a job in the ledger, except those being removed.

    Raises OSError, or one of `store.UNREACHABLE`.
    """
    names = store.names_in(settings.stores_url)
    ids = [match[1] for name in names if (match := _STORE_NAME.fullmatch(name))]
    with ledger.reading() as reading:
        known = reading.ids() | {deletion.job_id for deletion in reading.deletions()}
    return [settings.store_of(job_id) for job_id in ids if job_id not in known]


def has_stores(settings: Settings) -> bool:
    """Whether there are stores at the settings' address; True if it does not answer."""
    try:
        names = store.names_in(settings.stores_url)
    except Exception as error:  # noqa: BLE001 - any reason not to answer
        log.warning("the stores cannot be listed: %s", error)
        return True
    return any(_STORE_NAME.fullmatch(name) for name in names)


def open_ledger(settings: Settings, adopting: bool = False) -> Ledger:
    """The ledger of the settings' data folder, its stores marked as its own.

    Raises as `Ledger` does, and LedgerUnusable if the stores are another ledger's.
    """
    ledger = Ledger(settings.ledger_path, partial(has_stores, settings))
    try:
        marker = StoresMarker(ledger, settings)
        marker.claim(adopting)
    except BaseException:
        ledger.close()
        raise
    ledger.guard(marker.check)
    return ledger


def adopt(ledger: Ledger, settings: Settings, job_id: str) -> JobRecord:
    """Adopt a store as the job that it claims to be; chunks that can be read whole are done.

    The job is done if all chunks are, else failed: resuming it computes the others. The store is not
    changed. Raises NotAdoptable if it is no whole store, or if the ledger knows the job.
    """
    url = settings.store_of(job_id)
    if ledger.find(job_id) is not None:
        raise NotAdoptable(f"{url}: the ledger knows this job")
    try:
        contents = _contents(url, job_id)
    except (StoreError, SpecError, LookupError, TypeError, ValueError) as error:
        reason = str(error).removeprefix(f"{url}: ")
        raise NotAdoptable(f"{url} cannot be adopted: {reason}") from error
    except RecursionError as error:
        raise NotAdoptable(f"{url} cannot be adopted: its metadata are nested too deeply") from error
    reports = list(_whole_chunks(url, contents))
    found = f"{len(reports)} of {contents.job.chunks_total} chunks were found whole in its store"
    with ledger.writing() as writing:
        writing.adopt(
            contents.job, reports, contents.choice, time.time(), f"adopted: {found}; resume it for the rest"
        )
        job = writing.find(job_id)
    assert job is not None
    return job


def _contents(url: str, job_id: str) -> _Contents:
    """Raises StoreError, SpecError, or the errors of reading unexpected attributes."""
    store.stored_forms(url, None)  # first: it reads only files, while zarr would wait for a pipe
    attrs = store.read_attrs(url)
    version = str(attrs["kernel_version"])
    spec = parse_stored(json.dumps(attrs["spec"]), version)
    if not attrs["job"] == spec.job_id(version) == job_id:
        raise ValueError(f"it says that it holds job {attrs['job']}, its sweep is {spec.job_id(version)}")
    study = study_of(spec)
    plan: Plan = study.plan(spec, tuple(attrs["chunk_shape"]))
    job = NewJob(
        id=job_id,
        name=spec.name,
        spec=json.dumps(spec.as_submitted()),
        kernel_version=version,
        chunk_shape=plan.chunk_shape,
        chunks_total=len(plan),
        cells_total=plan.cells,
        first_cells=first_cells(spec, plan),
    )
    layout = study.variables(spec, plan.chunk_shape)
    return _Contents(job, plan, layout, _choice(attrs.get("choice")))


def _choice(stored: Any) -> str | None:
    """The chosen model of an `auto` sweep; the timings of the choice are not stored."""
    if stored is None:
        return None
    rows = [{**row, "measured": None} for row in stored["table"]]
    return ModelChoice.model_validate_json(json.dumps({**stored, "table": rows})).model_dump_json()


def _whole_chunks(url: str, contents: _Contents) -> Iterator[ChunkReport]:
    """Reports of the chunks with readable arrays and an outcome for every cell."""
    for chunk in contents.plan:
        checksum = store.checksum_of(url, contents.layout, chunk)
        try:
            record = store.read_chunk(url, chunk, contents.layout.names, complete=True)
        except StoreError:
            continue
        counts = [int((record["outcome"] == outcome).sum()) for outcome in Outcome]
        if sum(counts) == chunk.cells and not counts[Outcome.MISSING]:
            computed = int(record[COMPUTED.name].sum()) if COMPUTED.name in record else None
            yield ChunkReport(chunk.index, chunk.cells, 0.0, 0.0, checksum, tuple(counts), computed)
