"""What `bounce doctor` looks at: versions, cores, kernel cache, disk, ledger, stores, service."""

import os
import shutil
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import httpx2

from service.ledger import backup
from service.ledger.ledger import NOT_LOCAL
from service.ledger.paths import copies_of, file_system, network_file_system
from service.local import cores
from service.settings import Settings
from service.software import software
from worker import store
from worker.kernel_cache import default_root
from worker.ownership import NotOurs, check_unshared

#: Bytes of free disk space below which jobs may soon fail.
FREE_BYTES: Final = 1 << 30


class Finding(NamedTuple):
    """One line of the report; `ok`: nothing needs attention."""

    subject: str
    text: str
    ok: bool = True


def examine(settings: Settings, url: str) -> list[Finding]:
    """All findings; a check that fails is a finding, too."""
    parts: tuple[Callable[[Settings], Iterator[Finding]], ...] = (_machine, _cache, _disk, _ledger, _stores)
    findings = [finding for part in parts for finding in _contained(part, settings)]
    return [*findings, _service(url)]


def _contained(part: Callable[[Settings], Iterator[Finding]], settings: Settings) -> list[Finding]:
    try:
        return list(part(settings))
    except Exception as error:  # noqa: BLE001 - whatever is wrong is what is asked for
        return [Finding(part.__name__.strip("_"), str(error) or type(error).__name__, ok=False)]


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
        there = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
        free = shutil.disk_usage(there).free
        text = f"{folder}: {free / 1e9:.1f} GB free ({file_system(there)})"
        yield Finding("disk", text, free >= FREE_BYTES)
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
        yield Finding("ledger", f"{path}: {contents.jobs} jobs, {contents.chunks} done chunks, sound")
    if copies := copies_of(path):
        yield Finding("ledger", f"copies beside it: {', '.join(copy.name for copy in copies)}")


def _stores(settings: Settings) -> Iterator[Finding]:
    """Stores that the ledger does not know, and what is left of deletions that it does not record."""
    place, ledger = settings.stores_url, settings.ledger_path
    names = store.names_in(place)
    yield Finding("stores", f"{place}: {sum(name.endswith('.zarr') for name in names)} stores")
    ours, known = None, set[str]()
    if ledger.exists():
        ours, known = backup.marker_of(ledger), backup.known_ids(ledger)
    if ours is not None and (there := store.read_marker(place)) != ours:
        state = "is missing" if there is None else "is another ledger's"
        yield Finding("stores", f"{place}: their marker {store.MARKER} {state}; see /readyz", ok=False)
    for name in names:
        job_id, _, rest = name.partition(".zarr")
        if job_id not in known and name.endswith(".zarr"):
            yield Finding("stores", f"{name} is unknown to the ledger: bounce adopt {job_id}", ok=False)
        elif job_id not in known and rest.startswith(".deleted-"):
            text = "is left of a deletion that the ledger does not know: remove it, or rename and adopt it"
            yield Finding("stores", f"{name} {text}", ok=False)


def _service(url: str) -> Finding:
    try:
        answer = httpx2.get(f"{url}/readyz", timeout=5.0, trust_env=False)
        document = answer.json()
    except (httpx2.HTTPError, ValueError) as error:
        return Finding("service", f"none at {url} ({type(error).__name__})")
    if answer.status_code != 200:
        return Finding("service", f"{url} is not ready: {document.get('detail')}", ok=False)
    notices = "; ".join(document.get("notices", []))
    return Finding("service", f"{url} is ready{': ' if notices else ''}{notices}", not notices)
