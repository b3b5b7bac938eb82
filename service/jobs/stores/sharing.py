"""Packs a store into a shared file, as text of a page, and imports it as a job of another ledger.

The file holds the bytes of the store, so that imported results are the same to the last bit. Chunks carry
seals.
"""

import json
import re
from base64 import b64decode, b64encode
from collections.abc import Callable
from hashlib import sha256
from typing import Any, Final

from pydantic import TypeAdapter

from kernel.params import KERNEL_VERSION
from service.errors import IllegalTransition, InvalidRequest, NotAdoptable
from service.jobs.stores.adoption import adopt
from service.jobs.stores.opening import find_unknown, id_of
from service.ledger.ledger import Ledger
from service.ledger.model import UNFINISHED, JobRecord, JobState
from service.settings import Settings
from service.software import checked_runs
from worker import store
from worker.spec.specification import Label
from worker.studies import from_stored, study_of
from worker.study import Layout, Plan
from worker.study.layout import structured_attributes
from worker.sweep import SweepSpec
from worker.sweep.plan import MAX_SHARD_BYTES
from worker.sweep.specification import is_open

#: Limits on the bytes of a store in a file, and of a chunk before compression, which is twice that of plans.
MOST_STORED: Final = 6_000_000
MOST_OF_A_CHUNK: Final = 2 * MAX_SHARD_BYTES
#: Limits on what is parsed, which needs thirty times its bytes: files of a store, each with a seal, and bytes
#: of its root, which has at most 100,000 numbers of 24 bytes.
MOST_FILES: Final = 250_000
MOST_PARSED: Final = 3_000_000

_OPENS: Final = '<script type="application/json" id="store" data-sha256="'
_BLOCK: Final = re.compile(f'{_OPENS}([0-9a-f]{{64}})">({{[^<{{[]*)</script>'.encode())  # one object
_SHOWS: Final = re.compile(rb'<script type="application/json" id="(shared|store)"')

_NAME, _RUNS = "name", "runs"  # of the job, beside the store's files

_DAMAGED: Final = "is damaged: its numbers are not those that were written; ask for the file again"
_NOT_SHARED: Final = "is not one that bounce share wrote"
_IN_PART: Final = (
    "shows a sweep, but holds only a part of its numbers, as they were too many or not complete: submit its "
    "specification to compute it, or ask for the store"
)


def packed(url: str, layout: Layout, plan: Plan, name: str, runs: str) -> str:
    """A store as an element of a page, with its checksum; empty if it is too large or not complete.

    name: of the job, which may differ from the name in the store. runs: the software that computed it.
    """
    files = {key: b64encode(text.encode()).decode() for key, text in ((_NAME, name), (_RUNS, runs))}
    size = 0
    for key in store.keys_of(layout, plan):
        content = store.read_key(url, key)
        size += len(content or b"")
        if content is None or size > MOST_STORED:
            return ""
        files[key] = b64encode(content).decode()
    text = json.dumps(files)
    return f'{_OPENS}{sha256(text.encode()).hexdigest()}">{text}</script>'


def import_shared(
    ledger: Ledger, settings: Settings, check: Callable[[Any], Plan], content: bytes
) -> tuple[JobRecord, bool]:
    """Import a shared file; its done job, and whether the job is new. Checks the numbers before storing them.

    check: refuses studies that the service would not accept. Raises InvalidRequest for a file that is not
    shared, thinned or damaged, SpecTooLarge, and IllegalTransition if the job exists but is not done.
    """
    files = _unpacked(content)
    try:
        if max(len(files[store.ROOT]), len(files.get(_RUNS, b""))) > MOST_PARSED:
            raise ValueError("more than a shared file holds")
        attrs = json.loads(files[store.ROOT])["attributes"]
        version, spec = str(attrs["kernel_version"]), from_stored(attrs["spec"])
        attrs = structured_attributes(attrs)
        given = TypeAdapter(Label).validate_python(files.pop(_NAME, spec.name.encode()).decode())
        runs = checked_runs(files.pop(_RUNS, b"[]"))
    except (AttributeError, LookupError, TypeError, ValueError, RecursionError) as error:
        raise InvalidRequest.of("file", _DAMAGED) from error
    if version != KERNEL_VERSION:
        rule = f"was computed by kernel version {version:.40}; this release computes version {KERNEL_VERSION}"
        raise InvalidRequest.of("file", f"{rule}: submit its specification to compute it anew")
    if not isinstance(spec, SweepSpec):
        raise InvalidRequest.of("file", _NOT_SHARED)
    check(spec)
    layout = _checked(files, spec, attrs)
    job_id = spec.job_id(KERNEL_VERSION)
    if (existing := ledger.find(job_id)) is not None:
        if existing.state is not JobState.DONE:
            way = "wait for it" if existing.state in UNFINISHED else "resume it"
            raise IllegalTransition(f"the job of this file is {existing.state} here: {way}, or delete it")
        return existing, False
    with ledger.writing() as writing:
        number = writing.newest_seq() + 1
        writing.continue_after(number)
    name = f"{number}-{job_id}"
    url = settings.store_of(f"{name}.zarr")
    try:
        store.restore(url, files, layout)
        job = adopt(ledger, settings, name, name=given, runs=runs)
    except NotAdoptable as error:
        store.remove(url)
        if ledger.find(job_id) is None:
            raise InvalidRequest.of("file", _DAMAGED) from error
        raise IllegalTransition("the sweep of this file was submitted meanwhile: import it again") from error
    except BaseException:
        store.remove(url)
        raise
    if job.state is not JobState.DONE:
        with ledger.writing() as writing:
            writing.delete(job)
        raise InvalidRequest.of("file", _DAMAGED)
    for other in find_unknown(ledger, settings):
        url = settings.store_of(other)
        if id_of(other) == job_id and store.ROOT not in store.names_in(url):  # of an interrupted import
            store.remove(url)
    return job, True


def _unpacked(content: bytes) -> dict[str, bytes]:
    """The files of the store within a page. Raises InvalidRequest."""
    block = _BLOCK.search(content)
    if block is None:
        shown = _SHOWS.search(content)
        rule = _NOT_SHARED if shown is None else _DAMAGED if shown[1] == b"store" else _IN_PART
        raise InvalidRequest.of("file", rule)
    if block[2].count(b":") > MOST_FILES or sha256(block[2]).hexdigest() != block[1].decode():
        raise InvalidRequest.of("file", _DAMAGED)
    try:
        return {str(key): b64decode(text, validate=True) for key, text in json.loads(block[2]).items()}
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise InvalidRequest.of("file", _NOT_SHARED) from error


def _checked(files: dict[str, bytes], spec: Any, attrs: dict[str, Any]) -> Layout:
    """The layout of a store's files, checked against their metadata. Raises InvalidRequest."""
    try:
        plan = study_of(spec).plan(spec, tuple(attrs["chunk_shape"]))
        layout: Layout = study_of(spec).variables(spec, plan.chunk_shape)
        choice = {name: attrs[name] for name in ("model", "choice")} if is_open(spec) else {}
        fits = len(plan) < len(files) and layout.chunk_bytes <= MOST_OF_A_CHUNK
        whole = fits and sorted(files) == sorted(store.keys_of(layout, plan))
        if whole and store.metadata_of(layout, choice).items() <= files.items():
            return layout
    except (LookupError, TypeError, ValueError) as error:
        raise InvalidRequest.of("file", _DAMAGED) from error
    raise InvalidRequest.of("file", _DAMAGED)
