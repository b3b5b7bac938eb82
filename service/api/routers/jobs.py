"""Endpoints that submit, show, list and change jobs."""

import json
import time
from collections.abc import AsyncIterator, Callable
from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, Header, HTTPException, Query, Request, Response
from fastapi.sse import EventSourceResponse, ServerSentEvent

from service.api import schemas
from service.api.capacity import Cost, costly
from service.api.dependencies import JobDep, JsonBody, OwnerDep, PageBody, ServiceDep, find_job, tag
from service.api.schemas import NOT_MODIFIED, JobView, job_view, json_body, problem_responses
from service.errors import InvalidRequest
from service.formats import MOST_SHARED
from service.jobs.budgets import Budget
from service.jobs.manager import Submission
from service.jobs.stores.sharing import import_shared
from service.ledger.model import UNFINISHED, JobRecord
from worker.studies import from_json
from worker.study import Cost as StudyCost

router = APIRouter(prefix="/v1", tags=["jobs"])


def _post(
    path: str, summary: str, *problems: int, statuses: tuple[int, ...] = (200,), **options: Any
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Route a POST that answers with a job. `statuses`: of success, the usual one first."""
    responses = {status: {"model": JobView} for status in statuses[1:]} | problem_responses(*problems)
    about: dict[str, Any] = {"summary": summary, "response_model": JobView, "responses": responses}
    return router.post(path, status_code=statuses[0], **about, **options)


#: Copies of a shared file in memory while it is imported: as text, as bytes, decoded.
_COPIES: Final = 4


IdempotencyKey = Annotated[
    str | None,
    Header(
        min_length=1,
        max_length=255,
        pattern="^[!-~]+$",
        description="makes the request safe to repeat: a second request with the same key changes nothing",
    ),
]


@router.post(
    "/jobs",
    summary="Submit a sweep",
    status_code=202,
    response_model=JobView,
    responses={200: {"model": JobView | StudyCost}, **problem_responses(400, 408, 409, 413, 415, 422, 429)},
    openapi_extra=json_body("SweepSpec", "OrbitsSpec", "BasinSpec", "MultistabilitySpec"),
)
def submit_job(
    service: ServiceDep,
    body: JsonBody,
    query: Annotated[schemas.SubmitQuery, Query()],
    owner: OwnerDep,
    idempotency_key: IdempotencyKey = None,
) -> Response:
    """202 if the sweep is accepted, 200 if the same sweep is queued, running or done already.

    A failed or cancelled job resumes. With `validate_only` nothing is accepted; the response is the estimated
    cost. With `budget` levels of a sweep are computed one after another, from coarse to fine; the response is
    the job of the first one, whose `budget` says how far it is. It takes no Idempotency-Key: a repeated
    request joins it anyway.
    """
    spec = from_json(body)
    if query.validate_only:
        return Response(service.manager.cost(spec).model_dump_json(), media_type="application/json")
    if query.budget is not None:
        if idempotency_key is not None:
            raise InvalidRequest.of("budget", "has no Idempotency-Key: a repeated request joins it anyway")
        return _submitted(service, *service.budgets.begin(spec, query.budget, owner))
    return _submitted(service, service.manager.submit(spec, idempotency_key, owner))


_PAGE: Final = {
    "required": True,
    "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
}


@_post(
    "/imports", "Import a shared file", 408, 409, 413, 415, 422, 429, statuses=(201, 200),
    openapi_extra={"requestBody": _PAGE},
)  # fmt: skip
@costly(Cost(_COPIES * MOST_SHARED), "export")
def import_file(service: ServiceDep, body: PageBody) -> Response:
    """The sweep in a file of `export?format=html` as a done job, 200 if it was there.

    The file must hold all numbers, and they must be whole.
    """
    job, is_new = import_shared(service.ledger, service.settings, service.manager.check, body)
    service.manager.supervisor.look_again()  # what an interrupted import left is removed
    return _job_response(job, 201 if is_new else 200, {"Location": f"/v1/jobs/{job.id}"})


def _submitted(
    service: ServiceDep, submission: Submission, budget: Budget | None = None, *, notice: str | None = None
) -> Response:
    """The response to a submission. budget: that has begun it; without one a user wants the job itself."""
    job, accepted = submission
    if budget is None:
        service.budgets.own.discard(job.id)  # no budget cancels it
        budget = service.budgets.of(job.id)
    headers = {"Location": f"/v1/jobs/{job.id}"}
    if accepted:
        headers["Retry-After"] = str(_retry_after(job))
    return _job_response(job, 202 if accepted else 200, headers, notice=notice, budget=_budget_view(budget))


@router.get("/jobs", summary="List jobs", responses=problem_responses(422))
def list_jobs(service: ServiceDep, query: Annotated[schemas.JobsQuery, Query()]) -> schemas.JobList:
    """Those that all parameters allow, in the `order` asked for; `next` is the cursor of the next page."""
    after = None if query.cursor is None else query.read_cursor(query.cursor)
    with service.ledger.reading() as ledger:
        records = ledger.search(query, query.limit + 1, after)
        total = ledger.count_found(query)
    page, more = records[: query.limit], len(records) > query.limit
    compiling = service.manager.compiling
    views = [job_view(job, longest_spec=schemas.LONG_SPEC, compiling=compiling(job)) for job in page]
    following = query.cursor_after(page[-1]) if more else None
    return schemas.JobList(jobs=views, total=total, next=following, notice=service.ledger.fault())


@router.get(
    "/jobs/{job_id}",
    summary="Show a job",
    response_model=JobView,
    responses={**NOT_MODIFIED, **problem_responses(404)},
)
def get_job(
    service: ServiceDep, job_id: str, request: Request, query: Annotated[schemas.JobQuery, Query()]
) -> Response:
    """State, progress and failures; 304 if the ETag in `If-None-Match` is current."""
    job = find_job(job_id, service)  # called, not a dependency: FastAPI would use a second thread for it
    with service.ledger.reading() as ledger:
        failures = ledger.failures(job)
    supervisor, notice = service.manager.supervisor, None
    if job.state in UNFINISHED:
        notice = service.ledger.fault() or supervisor.bucket_fault or supervisor.cluster.explanation
    compiling = service.manager.compiling(job)
    reached = _budget_view(service.budgets.of(job_id, query.budget))
    headers = {"Retry-After": str(seconds)} if (seconds := _retry_after(job)) else {}
    compiled = None if compiling is None else round(compiling.seconds)
    # weak, because the time left changes within a step while the tag stays
    facts = (*job.revision(time.time()), len(failures), notice, compiled, reached)
    tag(request, *facts, weak=True, headers=headers)
    about = {"failures": failures, "notice": notice, "compiling": compiling, "budget": reached}
    return _job_response(job, 200, headers, **about)


@router.delete(
    "/jobs/{job_id}", summary="Delete a job", status_code=204, responses=problem_responses(404, 409)
)
def delete_job(service: ServiceDep, job: JobDep) -> None:
    """Removes the job and its results; 409 while it is queued or running."""
    service.manager.delete(job.id)


@_post("/jobs/{job_id}/cancel", "Cancel a job", 404, 409, statuses=(202,))
def cancel_job(service: ServiceDep, job: JobDep) -> Response:
    """Stops the job; the chunks that are done are kept."""
    return _job_response(service.manager.cancel(job.id), 202)


@_post("/jobs/{job_id}/resume", "Resume a job", 404, 409, 413, 422, 429, statuses=(202, 200))
def resume_job(service: ServiceDep, job: JobDep, owner: OwnerDep) -> Response:
    """A failed or cancelled job computes the chunks that are missing; 200 if it is queued or running.

    A job of another kernel version starts anew as a job of this one: the response describes the new job,
    whose address is in `Location`.
    """
    submission = service.manager.resume(job.id, owner)
    same = submission.job.id == job.id
    notice = None if same else f"starts anew what job {job.id} is: {job.notice}"
    return _submitted(service, submission, notice=notice)


@_post("/jobs/{job_id}/pin", "Pin a job", 404)
def pin_job(service: ServiceDep, job: JobDep) -> Response:
    """Marks the job, so that lists can show it apart; repeating the request changes nothing."""
    return _job_response(service.manager.label(job.id, pinned=True), 200)


@_post("/jobs/{job_id}/unpin", "Unpin a job", 404)
def unpin_job(service: ServiceDep, job: JobDep) -> Response:
    """Takes the mark away; repeating the request changes nothing."""
    return _job_response(service.manager.label(job.id, pinned=False), 200)


@_post("/jobs/{job_id}/rename", "Rename a job", 400, 404, 413, 415, 422, openapi_extra=json_body("NewName"))
def rename_job(service: ServiceDep, job: JobDep, body: JsonBody) -> Response:
    """Gives the job another name. Its id and numbers stay; a store written before keeps the title it has."""
    return _job_response(service.manager.label(job.id, name=schemas.NewName.from_json(body).name), 200)


async def _listener_slot(service: ServiceDep) -> AsyncIterator[None]:
    listeners, limit = service.listeners, service.settings.max_listeners
    if listeners.locked():
        raise HTTPException(503, f"too many event streams: at most {limit:,} at a time; poll the job instead")
    async with listeners:
        yield


@router.get(
    "/jobs/{job_id}/events",
    summary="Stream a job's progress",
    response_class=EventSourceResponse,
    dependencies=[Depends(_listener_slot)],
    responses=problem_responses(404, 503),
)
async def stream_job_events(service: ServiceDep, job: JobDep) -> AsyncIterator[ServerSentEvent]:
    """Server-sent events: state, percent, seconds left, and the kernel while one is compiled.

    They are named `progress` while the job is queued or running; the last one, of a finished job, `end`.
    """
    async for record, compiling in service.progress_stream.changes(job.id):
        progress = record.progress(time.time(), compiling=compiling is not None)
        left = progress["eta_seconds"]
        event = {
            "state": record.state, "percent": progress["percent"],
            "seconds_left": None if left is None else round(left),
            "compiling": None if compiling is None else compiling.kernel,
        }  # fmt: skip
        name = "progress" if record.state in UNFINISHED else "end"
        yield ServerSentEvent(event=name, raw_data=json.dumps(event))


def _job_response(
    job: JobRecord, status: int, headers: dict[str, str] | None = None, **about: Any
) -> Response:
    return Response(job_view(job, **about).model_dump_json(), status, headers, "application/json")


def _budget_view(budget: Budget | None) -> schemas.BudgetView | None:
    return None if budget is None else schemas.BudgetView.model_validate(budget)


def _retry_after(job: JobRecord) -> int:
    """Seconds until the next poll: a twentieth of the estimated time left, at most 10; 0 if finished."""
    left = job.eta_seconds(time.time()) if job.state in UNFINISHED else None
    return int(min((left or 0.0) / 20.0, 10.0))
