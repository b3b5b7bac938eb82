"""Which stores are a ledger's: their marker, and the adoption of stores that the ledger does not know.

The marker is a file beside the stores. A file system that is not mounted looks like an empty folder:
everything would be computed again beneath it. Another data folder with the same stores would remove results
that it does not own.

An older copy of the ledger does not know the jobs accepted since. Their stores have everything else: the
specification, the division into chunks, and the chunks, each with its checksums.
"""

import json
import logging
import re
import time
from functools import partial
from typing import Any, Final

from kernel.params import Outcome
from service.errors import LedgerUnavailable, LedgerUnusable, NotAdoptable
from service.jobs.prepare import new_job, parse_stored
from service.ledger.ledger import Ledger
from service.ledger.model import JobRecord, NewJob
from service.settings import Settings
from worker import store
from worker.analysis.model_selection import ModelChoice, is_open, resolved
from worker.schema import COMPUTED
from worker.spec import SweepSpec
from worker.spec.errors import SpecError
from worker.studies import Plan, study_of
from worker.tasks import ChunkReport, report_of

log = logging.getLogger(__name__)

_STORE_NAME: Final = re.compile(r"([0-9a-f]{32})\.zarr")
#: Seconds for which a bucket's marker, once seen, is assumed to exist.
REMEMBERED_SECONDS: Final = 10.0
_UNREADABLE: Final[tuple[type[Exception], ...]] = (OSError, *store.UNREACHABLE)


class StoresMarker:
    """The marker of one ledger's stores."""

    def __init__(self, ledger: Ledger, settings: Settings) -> None:
        self._ledger, self._settings, self._url = ledger, settings, settings.stores_url
        self._within_data = settings.stores is None  # no other data folder has them
        self._remembered = REMEMBERED_SECONDS if store.in_bucket(self._url) else 0.0
        self._checked = float("-inf")

    def claim(self, adopting: bool = False) -> None:
        """Mark the stores of a ledger that has not marked any, or that adopts them.

        Raises LedgerUnusable if they are another ledger's. If it cannot write the marker, `fault` reports
        that.
        """
        with self._ledger.reading() as reading:
            ours, made = reading.marker()
        try:
            there = store.read_marker(self._url)
            if there not in (None, "", ours) and (made or not self._within_data):
                raise LedgerUnusable(self._foreign(str(there)))
            # Left empty by a power cut, it is ours where the ledger knows every store beside it.
            emptied = there == "" and not find_unknown(self._ledger, self._settings)
            if there != ours and (adopting or not made or emptied):
                store.write_marker(self._url, ours)
            elif there != ours:
                return
        except _UNREADABLE as error:
            log.warning("%s cannot be marked as this ledger's: %s", self._url, error)
            return
        if not made:
            with self._ledger.writing() as writing:
                writing.note_marked()

    def check(self) -> None:
        """Raise LedgerUnavailable unless the stores are this ledger's and both folders can be written."""
        self._check_marker()
        folders = {"the data folder": str(self._settings.data), "the folder of the stores": self._url}
        for folder, place in folders.items():
            if reason := store.write_fault(place):
                raise LedgerUnavailable(f"{folder} cannot be written: {reason}")

    def _check_marker(self) -> None:
        if time.monotonic() - self._checked < self._remembered:
            return
        with self._ledger.reading() as reading:
            ours, made = reading.marker()
        if not made:
            return
        try:
            there = store.read_marker(self._url)
        except _UNREADABLE as error:
            if store.in_bucket(self._url):
                return  # any use of the bucket raises its error
            reason = getattr(error, "strerror", None) or type(error).__name__
            raise LedgerUnavailable(f"the folder of the stores cannot be read: {reason}") from error
        if not there:
            raise LedgerUnavailable(
                f"the stores are not there: their marker {store.MARKER} is missing, as where a file system "
                "is not mounted; mount it, or if these are the stores, stop the service and run "
                "bounce adopt --all"
            )
        if there != ours:
            raise LedgerUnavailable(self._foreign(there))
        self._checked = time.monotonic()

    def _foreign(self, there: str) -> str:
        return (
            f"the stores are another data folder's: {store.MARKER} beside them names the ledger "
            f"{there[:32]!a}; set BOUNCE_STORES to another folder, or, if that data folder is gone for good, "
            f"remove {store.MARKER} and run bounce adopt --all"
        )


def find_unknown(ledger: Ledger, settings: Settings) -> list[str]:
    """Sorted addresses of the stores without a job in the ledger, except those being removed.

    Raises OSError, or one of `store.UNREACHABLE`.
    """
    with ledger.reading() as reading:
        known = reading.ids() | {deletion.job_id for deletion in reading.deletions()}
    return [settings.store_of(job_id) for job_id in _stored_ids(settings) if job_id not in known]


def _stored_ids(settings: Settings) -> list[str]:
    names = store.names_in(settings.stores_url)
    return [match[1] for name in names if (match := _STORE_NAME.fullmatch(name))]


def has_stores(settings: Settings) -> bool:
    """Whether there are stores at the settings' address; True if it does not answer."""
    try:
        return bool(_stored_ids(settings))
    except Exception as error:  # noqa: BLE001 - any reason not to answer
        log.warning("the stores cannot be listed: %s", error)
        return True


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
        job, spec, plan, choice = _contents(url, job_id)
    except (store.StoreError, SpecError, LookupError, TypeError, ValueError, RecursionError) as error:
        missing = isinstance(error, KeyError)
        reason = f"it has no attribute {error}" if missing else str(error).removeprefix(f"{url}: ")
        raise NotAdoptable(f"{url} cannot be adopted: {reason}") from error
    reports = _whole_chunks(url, spec, plan)
    found = f"{len(reports)} of {job.chunks_total} chunks were found whole in its store"
    with ledger.writing() as writing:
        writing.adopt(job, reports, choice, time.time(), f"adopted: {found}; resume it for the rest")
        adopted = writing.find(job_id)
    assert adopted is not None
    return adopted


def _contents(url: str, job_id: str) -> tuple[NewJob, Any, Plan, str | None]:
    """What a store says about itself: job, specification, plan and chosen model.

    Raises StoreError, SpecError, or the errors of reading unexpected attributes.
    """
    attrs = store.read_attrs(url)
    version = str(attrs["kernel_version"])
    spec = parse_stored(json.dumps(attrs["spec"]), version)
    if not attrs["job"] == spec.job_id(version) == job_id:
        raise ValueError(f"it says that it holds job {attrs['job']}, its sweep is {spec.job_id(version)}")
    plan: Plan = study_of(spec).plan(spec, tuple(attrs["chunk_shape"]))
    outcome, layout = (
        store.stored_forms(url, None)["outcome"],
        study_of(spec).variables(spec, plan.chunk_shape),
    )
    if dict(zip(outcome.dims, outcome.chunks, strict=True)) != layout.chunk_sizes:
        raise ValueError(f"its attribute chunk_shape {attrs['chunk_shape']} is not that of its arrays")
    choice = _choice(attrs["choice"], spec) if is_open(spec) else None
    return new_job(spec, plan, version=version), spec, plan, choice


def _choice(stored: Any, spec: SweepSpec) -> str:
    """The chosen model of an `auto` sweep; the timings of the choice are not stored. Raises ValueError."""
    try:
        rows = [{**row, "measured": None} for row in stored["table"]]
        choice = ModelChoice.model_validate_json(json.dumps({**stored, "table": rows}))
        resolved(spec, choice)
    except (LookupError, TypeError, ValueError) as error:
        raise ValueError("its attribute choice is not the choice of a model") from error
    return choice.model_dump_json()


def _whole_chunks(url: str, spec: Any, plan: Any) -> list[ChunkReport]:
    """Reports of the chunks with readable arrays and an outcome for every cell."""
    layout, reports = study_of(spec).variables(spec, plan.chunk_shape), []
    for chunk in plan:
        stored = store.digest_of(url, layout, chunk)
        try:
            record = store.read_chunk(url, chunk, layout.names, complete=True)
        except store.StoreError:
            continue
        computed = int(record[COMPUTED.name].sum()) if COMPUTED.name in record else None
        report = report_of(chunk, record, stored, (0.0, 0.0), computed)
        if len(report.outcomes) == len(Outcome) and not report.outcomes[Outcome.MISSING]:
            reports.append(report)
    return reports
