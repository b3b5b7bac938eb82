"""The calls that hand in, list and change jobs: each asks the right room and wraps the answer."""

import time
from typing import Annotated, Any, Final

from fastapi import APIRouter, Header, Query, Request, Response

from service.api import dependencies, schemas
from service.api.conditional import matches
from service.api.dependencies import JsonBody, TheJob, TheService
from service.api.schemas import JobView, problem_responses
from service.jobs import cost as estimates
from service.jobs.model import JobState
from worker.cost import Cost
from worker.studies import from_json

router = APIRouter(prefix="/v1")

_SPEC_BODY: Final = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/SweepSpec"}}},
    }
}

IdempotencyKey = Annotated[
    str | None,
    Header(
        min_length=1,
        max_length=255,
        pattern="^[!-~]+$",
        description="a repeated request with the same key changes nothing",
    ),
]


@router.post(
    "/jobs",
    status_code=202,
    response_model=JobView,
    responses={
        200: {"model": JobView | Cost},
        **problem_responses(400, 408, 409, 413, 415, 422, 429),
    },
    openapi_extra=_SPEC_BODY,
)
def submit(
    service: TheService,
    body: JsonBody,
    query: Annotated[schemas.SubmitQuery, Query()],
    idempotency_key: IdempotencyKey = None,
) -> Response:
    """Submit a sweep: 202 if there is something to compute, 200 if this very sweep is in work or done.

    One that failed or was cancelled goes on where it stopped. With `validate_only` nothing is accepted: the
    answer is what the sweep would cost.
    """
    spec = from_json(body)
    if query.validate_only:
        return _cost(service, spec)
    job, accepted = service.manager.submit(spec, idempotency_key)
    headers = {"Location": f"/v1/jobs/{job.id}"}
    if accepted:
        headers["Retry-After"] = str(dependencies.seconds_to_wait(job) or 0)
    return dependencies.view(job, 202 if accepted else 200, headers)


def _cost(service: TheService, spec: Any) -> Response:
    plan = service.manager.check(spec)
    with service.ledger.reading() as ledger:
        paces = ledger.paces(estimates.RECENT_JOBS, estimates.MAX_SPEC_CHARS)
    found = estimates.cost(spec, plan, paces, service.manager.preparer)
    return Response(found.model_dump_json(), media_type="application/json")


@router.get("/jobs", responses=problem_responses(422))
def jobs(service: TheService, query: Annotated[schemas.JobsQuery, Query()]) -> schemas.JobList:
    """The jobs, the last accepted first; `next` is the cursor of the page after this one."""
    states = tuple(JobState) if query.state is None else (query.state,)
    before = None if query.cursor is None else int(query.cursor)
    with service.ledger.reading() as ledger:
        found = ledger.newest(query.state, query.limit + 1, before)
        total = ledger.count(states)
    page, more = found[: query.limit], len(found) > query.limit
    now = time.time()
    views = [schemas.job_view(job, now, longest_spec=schemas.LONG_SPEC) for job in page]
    return schemas.JobList(jobs=views, total=total, next=str(page[-1].seq) if more else None)


@router.get(
    "/jobs/{job_id}",
    response_model=JobView,
    responses={304: {"description": "nothing has changed"}, **problem_responses(404)},
)
def job(service: TheService, job_id: str, request: Request) -> Response:
    """One job; `If-None-Match` with its ETag answers 304 while nothing has changed."""
    job = dependencies.job_of(
        job_id, service
    )  # here, and not as a dependency: polls need one thread instead of two
    with service.ledger.reading() as ledger:
        failures = ledger.failures(job)
    headers = {"ETag": schemas.etag(job, len(failures)), "Cache-Control": "no-cache"}
    if wait := dependencies.seconds_to_wait(job):
        headers["Retry-After"] = str(wait)
    wanted = request.headers.get("if-none-match", "")
    if wanted == "*" or matches(wanted, headers["ETag"]):
        return Response(status_code=304, headers=headers)
    return dependencies.view(job, 200, headers, failures)


@router.delete("/jobs/{job_id}", status_code=204, responses=problem_responses(404, 409))
def delete(service: TheService, job: TheJob) -> None:
    """Forget a job and remove all it has computed; one in work is to be cancelled first."""
    service.manager.delete(job.id)


@router.post(
    "/jobs/{job_id}/cancel", status_code=202, response_model=JobView, responses=problem_responses(404, 409)
)
def cancel(service: TheService, job: TheJob) -> Response:
    """Stop a job, keeping what is computed."""
    return dependencies.view(service.manager.cancel(job.id), 202)


@router.post(
    "/jobs/{job_id}/resume",
    status_code=202,
    response_model=JobView,
    responses={200: {"model": JobView}, **problem_responses(404, 409, 429)},
)
def resume(service: TheService, job: TheJob) -> Response:
    """Let a job that failed or was cancelled go on where it stopped; 200 if it is in work anyway."""
    found, accepted = service.manager.resume(job.id)
    return dependencies.view(found, 202 if accepted else 200)
