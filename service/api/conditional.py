"""Results that a caller has already: a done job's change no more, so a tag tells them from all others."""

import hashlib
from collections.abc import Callable, Coroutine
from typing import Annotated, Any

from fastapi import Depends, Request, Response
from fastapi.routing import APIRoute

from service.api.dependencies import TheJob
from service.jobs.model import JobRecord, JobState


class _NotModified(Exception):
    """The caller's tag is the right one."""


class Tagged(APIRoute):
    """A route whose answers carry the tag of its job's results, where it asks for `Results`."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Called by FastAPI."""
        answer = super().get_route_handler()

        async def tagged(request: Request) -> Response:
            try:
                response = await answer(request)
            except _NotModified:
                response = Response(status_code=304)
            tag = getattr(request.state, "tag", None)
            if tag is not None and response.status_code in (200, 304):
                response.headers.update({"ETag": tag, "Cache-Control": "no-cache"})
            return response

        return tagged


def matches(wanted: str, tag: str) -> bool:
    """Whether an If-None-Match header names the tag; weak and strong ones compare alike."""
    tags = {one.strip().removeprefix("W/") for one in wanted.split(",")}
    return tag.removeprefix("W/") in tags


async def _results(job: TheJob, request: Request) -> JobRecord:
    if job.state is JobState.DONE:
        request.state.tag = _tag(job, request.app.version)
        if matches(request.headers.get("if-none-match", ""), request.state.tag):
            raise _NotModified
    return job


#: A job whose results are asked for; nothing is read for a caller who has them.
Results = Annotated[JobRecord, Depends(_results)]

#: What the API document says of it.
NOT_MODIFIED: dict[int | str, dict[str, Any]] = {304: {"description": "the job is done, and this is known"}}


def _tag(job: JobRecord, version: str) -> str:
    """One accepted job gives the same bytes under one address, for as long as this version answers."""
    facts = (job.id, job.seq, job.created, version)
    return f'"{hashlib.sha256(repr(facts).encode()).hexdigest()[:16]}"'
