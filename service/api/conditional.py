"""Conditional requests: ETags of jobs and of their results, and 304 for clients that have them."""

import hashlib
from typing import Annotated, Any, Final

from fastapi import Depends, HTTPException, Request

from service.api.dependencies import JobDep
from service.jobs.model import JobRecord, JobState

#: Entry of the API document.
NOT_MODIFIED: Final[dict[int | str, dict[str, Any]]] = {
    304: {"description": "The tag in If-None-Match is current"}
}


def tag(request: Request, *facts: object, weak: bool = False, headers: Any = None) -> None:
    """Give the response an ETag of these facts, which `middleware` adds if it succeeds.

    Raises HTTPException 304, with `headers`, if the client has this tag, by weak comparison.
    """
    own = f'"{hashlib.sha256(repr(facts).encode()).hexdigest()[:16]}"'
    request.state.tag = f"W/{own}" if weak else own
    candidates = request.headers.get("if-none-match", "").split(",")
    if not {"*", own}.isdisjoint(each.strip().removeprefix("W/") for each in candidates):
        raise HTTPException(304, headers=headers)


async def _results_job(job: JobDep, request: Request) -> JobRecord:
    """The job, its results tagged if they are final."""
    if job.state is JobState.DONE:
        # An accepted job gives the same bytes under one URL while this version of the service runs.
        tag(request, job.id, job.seq, job.created, request.app.version)
    return job


#: The job whose results are returned; a client that has them gets 304 before anything is read.
ResultsJob = Annotated[JobRecord, Depends(_results_job)]
