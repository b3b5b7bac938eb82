"""The calls of the HTTP table: each reads its parameters, asks the right room, and wraps the answer."""

import time
from dataclasses import dataclass
from typing import Annotated, Any, Final

import numpy as np
from fastapi import APIRouter, Depends, Query, Request, Response
from numpy.typing import NDArray

from kernel.threshold import threshold
from service import diagrams, queries, schemas
from service.errors import Problem, UnknownJob, WrongMediaType
from service.health import Health
from service.jobs import UNFINISHED, JobRecord, JobState
from service.ledger import Ledger
from service.lifecycle import Lifecycle
from service.schemas import Format, JobView, problem_responses
from service.settings import Settings
from worker.spec import SweepSpec

router = APIRouter(prefix="/v1")
probes = APIRouter()


@dataclass(frozen=True)
class Service:
    """What the calls work with; lives as long as the application runs."""

    settings: Settings
    ledger: Ledger
    lifecycle: Lifecycle
    health: Health


def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


def _job(job_id: str, service: "TheService") -> JobRecord:
    job = service.ledger.find(job_id)
    if job is None:
        raise UnknownJob.of(job_id)
    return job


async def _specification(request: Request) -> bytes:
    """The body, if it says that it is JSON: a form on some other web page cannot say so."""
    declared = request.headers.get("content-type", "")
    if declared.partition(";")[0].strip().lower() != "application/json":
        raise WrongMediaType("send the specification as JSON, with the header Content-Type: application/json")
    return await request.body()


TheService = Annotated[Service, Depends(_service)]
TheJob = Annotated[JobRecord, Depends(_job)]

_SPEC_BODY: Final = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/SweepSpec"}}},
    }
}


@router.post(
    "/jobs",
    status_code=202,
    response_model=JobView,
    responses={200: {"model": JobView}, **problem_responses(400, 408, 413, 415, 422, 429)},
    openapi_extra=_SPEC_BODY,
)
def submit(service: TheService, body: Annotated[bytes, Depends(_specification)]) -> Response:
    """Submit a sweep: 202 if there is something to compute, 200 if this very sweep is in work or done.

    One that failed or was cancelled goes on where it stopped.
    """
    job, accepted = service.lifecycle.submit(SweepSpec.from_json(body))
    headers = {"Location": f"/v1/jobs/{job.id}"}
    if accepted:
        headers["Retry-After"] = str(_seconds_to_wait(job) or 0)
    return _view(service, job, 202 if accepted else 200, headers)


@router.get("/jobs", responses=problem_responses(422))
def jobs(service: TheService, query: Annotated[schemas.JobsQuery, Query()]) -> schemas.JobList:
    """The jobs, the last accepted first."""
    states = tuple(JobState) if query.state is None else (query.state,)
    with service.ledger.reading() as ledger:
        found = ledger.newest(query.state, query.limit)
        total = ledger.count(states)
    now = time.time()
    views = [schemas.job_view(job, now, service.settings.store_of(job.id), in_list=True) for job in found]
    return schemas.JobList(jobs=views, total=total)


@router.get(
    "/jobs/{job_id}",
    response_model=JobView,
    responses={304: {"description": "nothing has changed"}, **problem_responses(404)},
)
def job(service: TheService, job: TheJob, request: Request) -> Response:
    """One job; `If-None-Match` with its ETag answers 304 while nothing has changed."""
    headers = {"ETag": schemas.etag(job), "Cache-Control": "no-cache"}
    if wait := _seconds_to_wait(job):
        headers["Retry-After"] = str(wait)
    if _matches(request.headers.get("if-none-match", ""), headers["ETag"]):
        return Response(status_code=304, headers=headers)
    return _view(service, job, 200, headers)


@router.post(
    "/jobs/{job_id}/cancel", status_code=202, response_model=JobView, responses=problem_responses(404, 409)
)
def cancel(service: TheService, job: TheJob) -> Response:
    """Stop a job, keeping what is computed; submitting the sweep again resumes it."""
    return _view(service, service.lifecycle.cancel(job.id), 202)


@router.get(
    "/jobs/{job_id}/diagram",
    responses={
        200: {"content": {"application/json": {}, "text/csv": {}, "image/png": {}, "image/svg+xml": {}}},
        **problem_responses(404, 413, 422),
    },
)
def diagram(service: TheService, job: TheJob, query: Annotated[schemas.DiagramQuery, Query()]) -> Response:
    """The bifurcation diagram along one axis, also of a job that is not done: `complete` says so."""
    sweep = _sweep(service, job)
    given = {"gamma": query.gamma, "omega": query.omega, "xi": query.xi}
    line = (sweep, query.along, given, query.direction, query.min_flight, service.settings.max_points)
    found = [queries.diagram(*line)] if query.format is Format.JSON else queries.diagrams(*line)
    content, media_type = _encoded(found, sweep.spec, query.format)
    complete = "true" if all(one.complete for one in found) else "false"
    return Response(content, media_type=media_type, headers={"Bounce-Complete": complete})


@router.get("/jobs/{job_id}/threshold", responses=problem_responses(404, 413, 422))
def job_threshold(
    service: TheService, job: TheJob, query: Annotated[schemas.JobThresholdQuery, Query()]
) -> schemas.Thresholds:
    """Per Ω at one xi: Eq. 25 beside the Γ where the sweep's cells begin and cease to bounce."""
    found = queries.thresholds(_sweep(service, job), query.xi, service.settings.max_points)
    return schemas.Thresholds(
        xi=found.xi,
        omega=found.omega.tolist(),
        analytic=_numbers(found.analytic),
        up=_numbers(found.up),
        down=_numbers(found.down),
        complete=found.complete,
    )


@router.get("/threshold", responses=problem_responses(422))
def eq_25(query: Annotated[schemas.ThresholdQuery, Query()]) -> schemas.Threshold:
    """Γ_th of Eq. 25, where a spring at rest begins to bounce."""
    (value,) = _numbers(np.atleast_1d(threshold(query.omega, query.xi)))
    return schemas.Threshold(omega=query.omega, xi=query.xi, threshold=value)


@probes.get("/healthz")
def healthz() -> schemas.Health:
    """The service answers."""
    return schemas.Health(status="ok")


@probes.get("/readyz", response_model=schemas.Health, responses=problem_responses(503))
def readyz(service: TheService) -> Any:
    """The service can compute: its scheduler answers."""
    if service.health.ready():
        return schemas.Health(status="ok")
    return Problem(503, "the Dask scheduler does not answer; jobs wait until it does")


def _view(service: Service, job: JobRecord, status: int, headers: dict[str, str] | None = None) -> Response:
    view = schemas.job_view(job, time.time(), service.settings.store_of(job.id))
    return Response(view.model_dump_json(), status, headers, "application/json")


def _seconds_to_wait(job: JobRecord) -> int | None:
    """When to look again: the longer a job takes, the more seldom; None for at once or never."""
    left = job.progress(time.time()).eta_seconds if job.state in UNFINISHED else None
    return None if left is None or left < 2 else int(min(max(left / 20, 1), 10))


def _matches(wanted: str, etag: str) -> bool:
    """Whether an If-None-Match header names the tag; weak and strong ones compare alike."""
    tags = {tag.strip().removeprefix("W/") for tag in wanted.split(",")}
    return bool(tags & {"*", etag.removeprefix("W/")})


def _sweep(service: Service, job: JobRecord) -> queries.Sweep:
    return queries.Sweep(SweepSpec.from_json(job.spec), service.settings.store_of(job.id))


def _encoded(found: list[queries.Diagram], spec: SweepSpec, format: Format) -> tuple[bytes, str]:
    """The diagrams' bytes and what they are."""
    if format is Format.JSON:
        return diagrams.as_json(found[0]), "application/json"
    if format is Format.CSV:
        return diagrams.as_csv(found), "text/csv"
    media_type = "image/png" if format is Format.PNG else "image/svg+xml"
    return diagrams.as_picture(found, spec, format), media_type


def _numbers(values: NDArray[np.float64]) -> list[float | None]:
    """Numbers for JSON, which has no NaN and no infinity."""
    return [value if np.isfinite(value) else None for value in values.tolist()]
