"""A request that meets damaged results: told so, never answered with them."""

from fastapi import Request, Response

from service.api.problems import Problem
from worker.store import StoreDamaged


def damaged(request: Request, error: Exception) -> Response:
    """503 naming the chunks, which are unmarked and computed again; soon after, the job runs."""
    repairer = request.app.state.service.manager.repairer
    places = error.chunks if isinstance(error, StoreDamaged) else ()
    return Problem(503, repairer.report(request.path_params.get("job_id", ""), places))
