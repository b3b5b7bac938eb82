"""The checks of `bounce doctor`: versions, cores, kernel cache, disk, ledger, stores, service, results."""

import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from functools import partial
from typing import Final, NamedTuple

from service.cli.options import plural
from service.client.errors import Refused, ServiceUnreachable
from service.client.transport import Transport, json_object
from service.errors import DataFolderBusy, LedgerUnusable, UnknownJob
from service.jobs.prepare import JobPreparer
from service.jobs.stores.opening import open_ledger
from service.jobs.stores.repair import describe, find_damage, repair, repair_metadata
from service.ledger import backup
from service.ledger.ledger import NOT_LOCAL, Ledger
from service.ledger.model import JobRecord
from service.ledger.paths import file_system, network_file_system, replaced_copies
from service.local import cores
from service.settings import Settings
from service.software import software
from worker import store
from worker.kernel_cache import default_root
from worker.ownership import NotOurs, check_unshared
from worker.spec.errors import BounceError

#: Bytes of free disk space below which jobs may soon fail.
FREE_BYTES: Final = 1 << 30


class Finding(NamedTuple):
    """One line of the report; `ok`: nothing needs attention."""

    subject: str
    text: str
    ok: bool = True


def examine(settings: Settings, url: str | None) -> list[Finding]:
    """All findings; a check that fails is a finding, too. url: of the service, None without one."""
    findings: list[Finding] = []
    for part in (_machine, _cache, _disk, _ledger, _stores):
        try:
            findings += list(part(settings))
        except Exception as error:  # noqa: BLE001 - every error is a finding
            findings.append(Finding(part.__name__.strip("_"), str(error) or type(error).__name__, ok=False))
    return [*findings, _service(url) if url else Finding("service", f"none on {settings.data}")]


def _machine(_: Settings) -> Iterator[Finding]:
    here = software()
    ours = f"bouncing-spring {here.release}, kernel version {here.kernel_version}"
    yield Finding("versions", f"{ours}, Python {here.python}, SQLite {backup.SQLITE_VERSION}")
    yield Finding("libraries", ", ".join(f"{name} {number}" for name, number in here.libraries.items()))
    yield Finding("cores", f"{cores()} of {os.cpu_count()}")


def _cache(_: Settings) -> Iterator[Finding]:
    root = default_root()
    try:
        check_unshared(root)
    except NotOurs as error:
        yield Finding("kernel cache", f"{error}: remove it", ok=False)
    else:
        compiled = sum(not file.suffix for file in root.glob("*/*-*"))  # one per kernel, see kernel_cache
        yield Finding("kernel cache", f"{root}, {compiled} compiled kernels")


def _disk(settings: Settings) -> Iterator[Finding]:
    for folder in settings.folders:
        existing = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
        free = shutil.disk_usage(existing).free
        text = f"{folder}: {free / 1e9:.1f} GB free ({file_system(existing)})"
        if os.access(existing, os.W_OK):
            yield Finding("disk", text, free >= FREE_BYTES)
        else:
            yield Finding("disk", f"{text}, cannot be written", ok=False)
    if network := network_file_system(settings.data):
        text = f"{settings.data} is on a network file system ({network}): {NOT_LOCAL}"
        yield Finding("disk", text, ok=False)


def _ledger(settings: Settings) -> Iterator[Finding]:
    path = settings.ledger_path
    if not path.exists():
        yield Finding("ledger", f"{path} is not there yet")
    elif not path.stat().st_size:
        yield Finding("ledger", f"{path} is empty", ok=False)
    else:
        contents = backup.inspect(path)
        held = f"{plural(contents.jobs, 'job')}, {plural(contents.chunks, 'done chunk')}"
        yield Finding("ledger", f"{path}: {held}, sound")
    if copies := replaced_copies(path):
        yield Finding("ledger", f"copies beside it: {', '.join(copy.name for copy in copies)}")


def _stores(settings: Settings) -> Iterator[Finding]:
    """Stores that the ledger does not know, that are missing, and leftovers of deletions."""
    url, ledger = settings.stores_url, settings.ledger_path
    names = set(store.names_in(url))
    yield Finding("stores", f"{url}: {plural(sum(name.endswith('.zarr') for name in names), 'store')}")
    marker, known, lost = None, set[str](), list[str]()
    if ledger.exists():
        try:
            with backup.reading(ledger) as reading:
                (own, made), known = reading.marker(), reading.stores()
                lost = [job.store for job in reading.search() if job.chunks_done and job.store not in names]
        except LedgerUnusable:  # `_ledger` says why
            return
        marker = own if made else None
    if marker is not None and (stored := store.read_marker(url)) != marker:
        state = "is missing" if stored is None else "is another ledger's"
        yield Finding("stores", f"{url}: their marker {store.MARKER} {state}; see /readyz", ok=False)
    if lost:
        missing = f"{plural(len(lost), 'store')} missing, such as {lost[0]}"
        text = f"{missing}: put them back, or run bounce doctor --verify"
        yield Finding("stores", text, ok=False)
    for name in sorted(names):
        stem, _, rest = name.partition(".zarr")
        if f"{stem}.zarr" in known:
            continue
        if name.endswith(".zarr"):
            yield Finding("stores", f"{name} is unknown to the ledger: bounce adopt {stem}", ok=False)
        elif rest.startswith(store.DELETED):
            text = "is left over from a deletion; not in the ledger: remove it, or rename and adopt it"
            yield Finding("stores", f"{name} {text}", ok=False)


def verify(settings: Settings, job_id: str | None) -> Iterator[Finding]:
    """Read all results of a job, or of all jobs; damaged ones are computed again at the next start.

    Only names the damage while a service uses the folder, and where an earlier release did: its ledger stays
    as it is. Raises UnknownJob.
    """
    if not settings.ledger_path.exists():
        yield from _ledger(settings)
        yield from _stores(settings)
        return
    preparer = JobPreparer(settings)
    with ExitStack() as stack:
        ledger, hindrance = None, "a service uses the folder; verify again without it"
        if backup.is_earlier(settings.ledger_path):
            hindrance = "an earlier release's ledger; verify again once this one's service has run"
        else:
            with suppress(DataFolderBusy, OSError):  # the last on a read-only disk
                ledger = stack.enter_context(open_ledger(settings))
        reading = partial(backup.reading, settings.ledger_path) if ledger is None else ledger.reading
        with reading() as transaction:
            jobs = transaction.search()
        jobs = [job for job in jobs if job.id.startswith(job_id or "")]
        if job_id is not None and not jobs:
            raise UnknownJob.of(job_id)
        for job in jobs:
            with reading() as transaction:
                done = transaction.done_chunks(job, 0, job.chunks_total)
            yield Finding("job", *_verify(preparer, ledger or hindrance, job, done))


def _verify(preparer: JobPreparer, ledger: Ledger | str, job: JobRecord, done: list[int]) -> tuple[str, bool]:
    """Read a job's `done` chunks; a sentence on the damage, and whether there is none.

    ledger: what hinders its use, where it only is read.
    """
    try:
        prepared, mended = preparer.prepare(job), ""
        if isinstance(ledger, Ledger):
            store.sweep_leftovers(prepared.store_url)
            if done and (keys := repair_metadata(ledger, job, prepared)):
                mended = f"; metadata that differed are rewritten: {', '.join(keys)}"
        damaged = find_damage(prepared, done) if done else []
        if not damaged:
            sound = "chunk is sound" if len(done) == 1 else "chunks are sound"
            return f"{job.id}: {len(done)} {sound}{mended}", True
        if not isinstance(ledger, Ledger):
            fate = f"{ledger} to have them computed again"
            return f"{job.id}: damaged: {describe(prepared, damaged)}: {fate}", False
        return f"{job.id}: {repair(ledger, preparer, job.id, damaged).detail}", False
    except (store.StoreError, LedgerUnusable, OSError) as error:
        return f"{job.id}: {error}", False


def _service(url: str) -> Finding:
    try:
        with closing(Transport(url, None, timeout=5.0)) as service:
            document = json_object(service.get("/readyz"))
    except Refused as error:
        return Finding("service", f"{url} is not ready: {error}", ok=False)
    except BounceError as error:
        return Finding("service", str(error), ok=type(error) is ServiceUnreachable)
    notices = "; ".join(document.get("notices", []))
    return Finding("service", f"{url} is ready{': ' if notices else ''}{notices}", not notices)
