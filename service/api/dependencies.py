"""What every call works with: the service's parts, the job that a path names, and how a job is answered."""

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request, Response

from service.api import schemas
from service.api.capacity import ConcurrencyLimit
from service.api.metrics import Metrics
from service.api.progress_stream import ProgressStream
from service.api.readiness import Health
from service.errors import InvalidRequest, UnknownJob, WrongMediaType
from service.jobs.ledger import Ledger
from service.jobs.manager import JobManager
from service.jobs.model import UNFINISHED, Failure, JobRecord, JobState
from service.jobs.on_demand import OnDemandCache
from service.results.selection import Sweep
from service.settings import Settings
from worker.spec import SweepSpec


@dataclass(frozen=True)
class Service:
    """What the calls work with; lives as long as the application runs."""

    settings: Settings
    ledger: Ledger
    manager: JobManager
    health: Health
    watch: ProgressStream
    metrics: Metrics
    exports: ConcurrencyLimit
    trajectories: ConcurrencyLimit
    answers: OnDemandCache


async def _service(request: Request) -> Service:  # async: a plain one would take a thread for nothing
    service: Service = request.app.state.service
    return service


TheService = Annotated[Service, Depends(_service)]


def job_of(job_id: str, service: TheService) -> JobRecord:
    """The job that a path names. Raises UnknownJob."""
    job = service.ledger.find(job_id)
    if job is None:
        raise UnknownJob.of(job_id)
    return job


async def reject_repeated_parameters(request: Request) -> None:
    """Refuse a parameter given twice, of which only the last would count. Raises InvalidRequest."""
    times = Counter(name for name, _ in request.query_params.multi_items())
    for name in times:
        if times[name] > 1:
            raise InvalidRequest.of(name, f"is given {times[name]} times")


async def _json_body(request: Request) -> bytes:
    """The body, if it says that it is JSON: a form on some other web page cannot say so."""
    coding = request.headers.get("content-encoding", "identity")
    if coding.lower() != "identity":
        raise WrongMediaType(f"the body is compressed (Content-Encoding: {coding[:40]}): send it as it is")
    declared = request.headers.get("content-type", "")
    if declared.partition(";")[0].strip().lower() != "application/json":
        raise WrongMediaType("send the specification as JSON, with the header Content-Type: application/json")
    return await request.body()


TheJob = Annotated[JobRecord, Depends(job_of)]
JsonBody = Annotated[bytes, Depends(_json_body)]


def view(
    job: JobRecord, status: int, headers: dict[str, str] | None = None, failures: Sequence[Failure] = ()
) -> Response:
    """A job as an answer."""
    content = schemas.job_view(job, time.time(), None, *failures).model_dump_json()
    return Response(content, status, headers, "application/json")


def seconds_to_wait(job: JobRecord) -> int | None:
    """When to look again: the longer a job takes, the more seldom; None for soon, or never again."""
    left = job.progress(time.time()).eta_seconds if job.state in UNFINISHED else None
    return None if left is None or left < 20 else int(min(left / 20, 10))


def sweep(service: Service, job: JobRecord) -> Sweep:
    """What a job was asked and where its results are."""
    prepared = service.manager.preparer.prepare(job)
    if not isinstance(prepared.spec, SweepSpec):
        kind = prepared.spec.protocol.kind
        raise InvalidRequest.of("job_id", f"must be of a sweep; this job's protocol is {kind}")
    return Sweep(prepared.spec, prepared.store_url, job.state is JobState.DONE)
