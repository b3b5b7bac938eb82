"""Conditional requests: ETags of jobs and of their results, and 304 for clients that have them."""

import hashlib
from collections.abc import Callable, Coroutine, Mapping
from http import HTTPStatus
from typing import Annotated, Any, Final

from fastapi import Depends, Request, Response
from fastapi.routing import APIRoute

from service.api.dependencies import JobDep
from service.jobs.model import JobRecord, JobState
from worker.executors.base import Compiling

#: Entry of the API document.
NOT_MODIFIED: Final[dict[int | str, dict[str, Any]]] = {
    304: {"description": "The tag in If-None-Match is current"}
}


def job_headers(
    job: JobRecord, failures: int = 0, notice: str | None = None, compiling: Compiling | None = None
) -> dict[str, str]:
    """ETag and Cache-Control of a job's view; the tag is weak, because it ignores the estimated time left."""
    shown = [fact for fact in (notice, compiling and round(compiling.seconds)) if fact is not None]
    return _headers(f"W/{_tag(failures, *job.revision, *shown)}")


def not_modified(request: Request, headers: Mapping[str, str]) -> Response | None:
    """304 with `headers` if If-None-Match names their ETag or is `*`, else None."""
    candidates = request.headers.get("if-none-match", "")
    if candidates == "*" or _matches(candidates, headers["ETag"]):
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
    return None


class ConditionalRoute(APIRoute):
    """A route whose responses carry the tag of the job's results, if its endpoint takes a `ResultsJob`."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Called by FastAPI."""
        handler = super().get_route_handler()

        async def tagged(request: Request) -> Response:
            try:
                response = await handler(request)
            except _NotModified:
                response = Response(status_code=HTTPStatus.NOT_MODIFIED)
            tag = getattr(request.state, "tag", None)
            if tag is not None and response.status_code in (HTTPStatus.OK, HTTPStatus.NOT_MODIFIED):
                response.headers.update(_headers(tag))
            return response

        return tagged


class _NotModified(Exception):
    """If-None-Match names the tag of the results."""


async def _results_job(job: JobDep, request: Request) -> JobRecord:
    """The job, with the tag of its results in `request.state` if they are final."""
    if job.state is JobState.DONE:
        # An accepted job gives the same bytes under one URL while this version of the service runs.
        request.state.tag = _tag(job.id, job.seq, job.created, request.app.version)
        if _matches(request.headers.get("if-none-match", ""), request.state.tag):
            raise _NotModified
    return job


#: The job whose results a `ConditionalRoute` returns; a client that has them gets 304 before anything is
#: read.
ResultsJob = Annotated[JobRecord, Depends(_results_job)]


def _headers(tag: str) -> dict[str, str]:
    return {"ETag": tag, "Cache-Control": "no-cache"}


def _tag(*facts: object) -> str:
    return f'"{hashlib.sha256(repr(facts).encode()).hexdigest()[:16]}"'


def _matches(candidates: str, tag: str) -> bool:
    """Whether an If-None-Match header names the tag, by weak comparison."""
    tags = {candidate.strip().removeprefix("W/") for candidate in candidates.split(",")}
    return tag.removeprefix("W/") in tags
