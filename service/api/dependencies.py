"""FastAPI dependencies: the parts of the running service, the job named by a path, and JSON bodies."""

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from typing import Annotated, Any

from fastapi import Depends, Request

from service.api.capacity import (
    FEW_CHUNKS,
    SMALL_ANSWER,
    SMALL_CHUNKS,
    Capacity,
    Cost,
    ListenerLimit,
)
from service.api.monitoring import Metrics, Readiness
from service.api.progress_stream import ProgressStream
from service.background import Background, InThisProcess
from service.errors import InvalidRequest, UnknownJob, WrongMediaType
from service.jobs.ledger import Ledger
from service.jobs.manager import JobManager
from service.jobs.model import JobRecord, JobState
from service.jobs.on_demand import OnDemandCache
from service.results.selection import BASE_MEMORY, Stored, Sweep
from service.settings import Settings
from worker.spec import SweepSpec


@dataclass(frozen=True)
class Service:
    """The parts of the service that endpoints use; they live as long as the application runs."""

    settings: Settings
    ledger: Ledger
    manager: JobManager
    on_demand: OnDemandCache
    capacity: Capacity
    small_reads: Capacity
    background: Background
    listener_limit: ListenerLimit
    progress_stream: ProgressStream
    readiness: Readiness
    metrics: Metrics

    @cached_property
    def small(self) -> "Service":
        """This service for small reads: with the places that are theirs, computing in this process."""
        return replace(self, capacity=self.small_reads, background=InThisProcess())


async def _service(request: Request) -> Service:  # async, because FastAPI would run a plain one in a thread
    service: Service = request.app.state.service
    return service


ServiceDep = Annotated[Service, Depends(_service)]


async def _owner(request: Request) -> str | None:
    name: str | None = getattr(request.state, "token_name", None)
    return name


#: The name of the caller's access token; None if it has no name, or none is required.
OwnerDep = Annotated[str | None, Depends(_owner)]


def find_job(job_id: str, service: ServiceDep) -> JobRecord:
    """The job named by a path. Raises UnknownJob."""
    job = service.ledger.find(job_id)
    if job is None:
        raise UnknownJob.of(job_id)
    return job


JobDep = Annotated[JobRecord, Depends(find_job)]


def stored(service: Service, job: JobRecord) -> Stored[Any]:
    """What a job of any kind computes and where its results are."""
    prepared = service.manager.preparer.prepare(job)
    kind = Sweep if isinstance(prepared.spec, SweepSpec) else Stored
    done = job.state is JobState.DONE
    return kind(
        prepared.spec, prepared.store_url, done, job.kernel_version, job.repairing, job.id, job.chunks_done,
        prepared.forms,
    )  # fmt: skip


def sweep(service: Service, job: JobRecord) -> Sweep:
    """What a job computes and where its results are. Raises InvalidRequest for other kinds of study."""
    found = stored(service, job)
    if not isinstance(found, Sweep):
        kind = found.spec.protocol.kind
        raise InvalidRequest.of("job_id", f"must be a sweep; the protocol of this job is {kind}")
    return found


def cost_of_read(service: Service, job: JobRecord, memory: int, *along: str) -> Cost:
    """The cost of a read whose answer takes `memory` beside BASE_MEMORY, of all chunks along some dimensions.

    In every direction of a sweep.
    """
    layout = service.manager.preparer.prepare(job).layout
    sizes = [(len(layout.coordinates[dim]), layout.chunk_sizes[dim]) for dim in (*along, "direction")
             if dim in layout.chunk_sizes]  # fmt: skip
    chunks = prod(-(-length // size) for length, size in sizes)
    few = chunks <= FEW_CHUNKS and chunks * layout.chunk_bytes <= SMALL_CHUNKS
    return Cost(BASE_MEMORY + memory, few and memory <= SMALL_ANSWER)


async def reject_repeated_parameters(request: Request) -> None:
    """Refuse a query parameter given twice, of which only the last would count. Raises InvalidRequest."""
    counts = Counter(name for name, _ in request.query_params.multi_items())
    for name, count in counts.items():
        if count > 1:
            raise InvalidRequest.of(name, f"is given {count} times")


async def _json_body(request: Request) -> bytes:
    """The body, if declared as JSON, which forms of other web pages cannot do. Raises WrongMediaType."""
    coding = request.headers.get("content-encoding", "identity")
    if coding.lower() != "identity":
        raise WrongMediaType(
            f"the body is compressed (Content-Encoding: {coding[:40]}): send it uncompressed"
        )
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != "application/json":
        raise WrongMediaType("send the body as JSON, with the header Content-Type: application/json")
    return await request.body()


JsonBody = Annotated[bytes, Depends(_json_body)]
