"""FastAPI dependencies: the parts of the running service, the job named by a path, and JSON bodies."""

import asyncio
import hashlib
from collections import Counter
from collections.abc import AsyncIterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from typing import Annotated, Any

from fastapi import Depends, HTTPException, Request

from service.api.capacity import FEW_CHUNKS, SMALL_ANSWER, SMALL_CHUNKS, Capacity, Cost
from service.api.monitoring import Metrics
from service.api.progress_stream import ProgressStream
from service.background import Background, InThisProcess
from service.errors import Busy, InvalidRequest, TooLarge, UnknownJob
from service.formats import MOST_SHARED
from service.jobs.budgets import Budgets
from service.jobs.manager import JobManager
from service.jobs.on_demand import OnDemandCache
from service.ledger.ledger import Ledger
from service.ledger.model import JobRecord, JobState
from service.settings import Settings
from service.views import registry
from service.views.selection import BASE_MEMORY, Stored
from worker.spec.errors import Problem


@dataclass(frozen=True)
class Service:
    """The parts of the service that endpoints use; they live as long as the application runs."""

    settings: Settings
    ledger: Ledger
    manager: JobManager
    budgets: Budgets
    on_demand: OnDemandCache
    capacity: Capacity
    small_reads: Capacity
    background: Background
    listeners: asyncio.Semaphore
    imports: asyncio.Semaphore
    progress_stream: ProgressStream
    metrics: Metrics

    def audit_of(self, job: JobRecord) -> str | None:
        """The sentence of the job's last audit; None without one."""
        with self.ledger.reading() as ledger:
            return ledger.sentence(job, "audit")

    @cached_property
    def small(self) -> "Service":
        """This service for small reads: with their own capacity, and computing in this process."""
        return replace(self, capacity=self.small_reads, background=InThisProcess())


async def _service(request: Request) -> Service:  # async, because FastAPI would run a plain one in a thread
    service: Service = request.app.state.service
    return service


ServiceDep = Annotated[Service, Depends(_service)]


async def _owner(request: Request) -> Any:
    return request.state.token_name


#: The name of the caller's access token; None if it has no name, or none is required.
OwnerDep = Annotated[str | None, Depends(_owner)]


def find_job(job_id: str, service: ServiceDep) -> JobRecord:
    """The job named by a path. Raises UnknownJob."""
    job = service.ledger.find(job_id)
    if job is None:
        raise UnknownJob.of(job_id)
    return job


JobDep = Annotated[JobRecord, Depends(find_job)]


def tag(request: Request, *facts: object, weak: bool = False, headers: Any = None) -> None:
    """Give the response an ETag of these facts, which `middleware` adds if it succeeds.

    Raises HTTPException 304, with `headers`, if the client has this tag, by weak comparison.
    """
    own = f'"{hashlib.sha256(repr(facts).encode()).hexdigest()[:16]}"'
    request.state.tag = f"W/{own}" if weak else own
    candidates = request.headers.get("if-none-match", "").split(",")
    if not {"*", own}.isdisjoint(candidate.strip().removeprefix("W/") for candidate in candidates):
        raise HTTPException(304, headers=headers)


def _results_job(job: JobDep, service: ServiceDep, request: Request) -> JobRecord:
    """The job; tags the response if its results are final."""
    others = map(service.ledger.find, request.query_params.getlist("other"))
    jobs = [job, *filter(None, others)]  # the endpoint refuses others
    if all(read.state is JobState.DONE for read in jobs):
        # with the version these determine an answer
        facts = [(read.id, read.seq, read.created, read.name, service.audit_of(read)) for read in jobs]
        tag(request, *facts, request.app.version)
    return job


#: The job whose results are returned; a client that has them gets 304 before anything is read.
ResultsJob = Annotated[JobRecord, Depends(_results_job)]


def find_store_job(job_id: str, service: ServiceDep) -> JobRecord:
    """As `find_job`, but 410 for an unknown job: readers of zarr take 404 for a chunk of fill values."""
    try:
        return find_job(job_id, service)
    except UnknownJob as error:
        raise HTTPException(410, str(error)) from None


def _store_job(job_id: str, service: ServiceDep, request: Request) -> JobRecord:
    return _results_job(find_store_job(job_id, service), service, request)


#: The job whose store is read.
StoreJob = Annotated[JobRecord, Depends(_store_job)]


def stored(service: Service, job: JobRecord) -> Stored[Any]:
    """The study of a job of any kind, and where its results are."""
    return registry.stored(job, service.manager.preparer.prepare(job))


def cost_of_read(service: Service, job: JobRecord, memory: int, *along: str) -> Cost:
    """The cost of a read whose answer takes `memory` beside BASE_MEMORY.

    It reads all chunks along some dimensions, in every direction of a sweep.
    """
    layout = service.manager.preparer.prepare(job).layout
    dims = layout.chunk_sizes.keys() & {*along, "direction"}
    chunks = prod(-(-len(layout.coordinates[dim]) // layout.chunk_sizes[dim]) for dim in dims)
    few = chunks <= FEW_CHUNKS and chunks * layout.chunk_bytes <= SMALL_CHUNKS
    return Cost(BASE_MEMORY + memory, few and memory <= SMALL_ANSWER)


async def check_parameters(request: Request) -> None:
    """Refuse a parameter or key given twice, of which only one would count, and any where none is taken.

    Unknown ones beside others are refused by their models. Raises InvalidRequest.
    """
    counts = Counter(name for name, _ in request.query_params.multi_items())
    counts["idempotency-key"] += len(request.headers.getlist("idempotency-key"))
    for name, count in counts.items():
        if count > 1:
            raise InvalidRequest.of(name, f"is given {count} times")
    route, rule = request.scope["route"], "is not a parameter here; there are none"
    if route.path.startswith("/v1/") and not route.dependant.query_params:  # a probe or a link may have any
        for name in request.query_params:
            raise InvalidRequest(f"{name}: {rule}", [Problem(name, rule, "unknown")])


async def _json_body(request: Request, service: ServiceDep) -> bytes:
    rule = "send the body as JSON, with the header Content-Type: application/json"
    _check_declared(request, "application/json", rule)
    hint = "; an evenly spaced axis is shorter as a range with start, stop and num"
    return await _body(request, service, service.settings.max_body_bytes, hint)


async def _page_body(request: Request, service: ServiceDep) -> AsyncIterator[bytes]:
    """A shared file, few at a time: each takes much memory."""
    _check_declared(
        request, "application/octet-stream",
        "send the file as it is, with the header Content-Type: application/octet-stream",
    )  # fmt: skip
    try:
        async with asyncio.timeout(service.settings.turn_seconds):
            await service.imports.acquire()
    except TimeoutError:
        raise Busy("other files are being imported: repeat the request") from None
    try:
        yield await _body(request, service, MOST_SHARED)
    finally:
        service.imports.release()


def _check_declared(request: Request, kind: str, rule: str) -> None:
    """Raise HTTPException unless the body has this media type, which forms of web pages cannot send."""
    coding = request.headers.get("content-encoding", "identity")
    if coding.lower() != "identity":
        compressed = f"the body is compressed (Content-Encoding: {coding[:40]}): send it uncompressed"
        raise HTTPException(415, compressed)
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != kind:
        raise HTTPException(415, rule)


async def _body(request: Request, service: ServiceDep, most: int, hint: str = "") -> bytes:
    """The body. Raises HTTPException if it is late, and TooLarge before reading all of a long one."""
    seconds = service.settings.body_seconds
    declared, body = request.headers.get("content-length", ""), bytearray()
    size = int(declared[:20]) if declared.isdecimal() else 0
    try:
        async with asyncio.timeout(seconds):
            pieces = request.stream()
            while size <= most:
                body += await anext(pieces)
                size = max(size, len(body))
    except StopAsyncIteration:
        return bytes(body)
    except TimeoutError:
        raise HTTPException(408, f"the body did not arrive within {seconds:g} s") from None
    raise TooLarge(f"the body is longer than {most:,} bytes{hint}")


JsonBody = Annotated[bytes, Depends(_json_body)]
PageBody = Annotated[bytes, Depends(_page_body)]
