"""Errors as HTTP responses.

Errors are sent as `application/problem+json` (RFC 9457) with an extension: `errors`, a list of
`{"field", "rule", "code"}`. Two exceptions need more than a status: `StoreDamaged` starts a repair, and
`Pending`, which is no error, becomes 202 with the progress of the workers.
"""

import json
import logging
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any, Final

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.routing import Match, Mount

from service.api.capacity import CLIENT_GONE
from service.api.schemas import PartsView, PendingView
from service.errors import LedgerUnavailable, ServiceError
from service.jobs.on_demand import Pending
from worker import store
from worker.spec.errors import (
    Problem,
    SpecError,
    SpecTooLarge,
    SpecUnreadable,
    code_of,
    did_you_mean,
    rule_of,
)
from worker.store import StoreDamaged, StoreError

log = logging.getLogger(__name__)

#: Statuses of errors that are not the service's own; the first class that matches counts. Any other exception
#: is a defect: 500.
FOREIGN: Final[Mapping[type[Exception], int]] = {
    SpecUnreadable: 400,
    SpecTooLarge: 413,
    SpecError: 422,
    StoreError: 500,
    store.Unreachable: 503,
    OSError: 503,  # the data folder is missing or not accessible
}

_KNOWN: Final[tuple[type[Exception], ...]] = (ServiceError, *FOREIGN)

#: Retry-After, in seconds.
RETRY_AFTER: Final[Mapping[int, int]] = {429: 5, 503: 2}


class ProblemResponse(Response):
    """A problem document (see `schemas.ProblemDocument`) with the headers of its status."""

    media_type = "application/problem+json"

    def __init__(
        self,
        status: int,
        detail: str,
        problems: Sequence[Problem] = (),
        headers: Mapping[str, str] | None = None,
    ) -> None:
        own = {"Retry-After": str(RETRY_AFTER[status])} if status in RETRY_AFTER else {}
        document: dict[str, Any] = {"title": HTTPStatus(status).phrase, "status": status, "detail": detail}
        if problems:
            document["errors"] = [problem._asdict() for problem in problems]
        # json.dumps escapes lone surrogates, which a caller's input may contain; Pydantic refuses them.
        super().__init__(json.dumps(document), status, {**own, **(headers or {})})


def install(app: FastAPI) -> None:
    """Register the handlers of all errors except defects, which `middleware` answers."""
    for error_class in _KNOWN:
        app.add_exception_handler(error_class, lambda _, error: problem_response(error))
    app.add_exception_handler(StoreDamaged, _damaged)
    app.add_exception_handler(Pending, _pending)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(ClientDisconnect, lambda *_: Response(status_code=CLIENT_GONE))


def problem_response(error: Exception) -> ProblemResponse:
    """The response to an error of the service's own, or one in FOREIGN."""
    if isinstance(error, ServiceError):
        status = error.status
    else:
        status = next(status for error_class, status in FOREIGN.items() if isinstance(error, error_class))
    if isinstance(error, LedgerUnavailable | StoreError):  # a store's text begins with its address
        log.error("%s", error)
    if isinstance(error, store.Unreachable):
        log.error("the bucket of the stores does not answer: %s", error)
        return ProblemResponse(status, "the bucket of the stores does not answer")
    if isinstance(error, StoreError):
        return ProblemResponse(status, "the stored results cannot be read; see the service log")
    if isinstance(error, OSError):
        log.error("the data folder cannot be used: %s", error, exc_info=None if error.filename else error)
        reason = error.strerror or type(error).__name__
        return ProblemResponse(status, f"the data folder cannot be used: {reason}; see the service log")
    return ProblemResponse(status, str(error), getattr(error, "problems", ()))


def _damaged(request: Request, error: Any) -> Response:
    """Start the repair of damaged results; 503 with the chunks, or 500 if they cannot be repaired."""
    supervisor = request.app.state.service.manager.supervisor
    try:
        repair = supervisor.repair(request.path_params.get("job_id", ""), error.chunks)
    except _KNOWN as hindrance:  # for example missing stores, or a full disk
        return problem_response(hindrance)
    return ProblemResponse(500 if repair.lasting else 503, repair.detail)


def _pending(request: Request, pending: Any) -> Response:
    percent = round(100.0 * pending.done / pending.total, 1)
    progress = PartsView(parts_done=pending.done, parts_total=pending.total, percent=percent)
    notice = request.app.state.service.manager.supervisor.cluster.explanation
    content = PendingView(progress=progress, notice=notice).model_dump_json()
    return Response(content, 202, {"Retry-After": "1"}, "application/json")


def _invalid(request: Request, error: Any) -> Response:
    """422 for query parameters and headers; without the input, which may not be valid JSON."""
    models = (field.field_info.annotation for field in request.scope["route"].dependant.query_params)
    known = [name for model in models for name in getattr(model, "model_fields", ())]
    problems = [_problem(entry, known) for entry in error.errors()]
    return ProblemResponse(422, "; ".join(map(str, problems)), problems)


#: The rules of parameters that are checked by a pattern.
_PATTERNS: Final = {
    "cursor": "must be `next` of the page before",
    "idempotency-key": "must be made of ASCII characters, without spaces",
}


def _problem(entry: Mapping[str, Any], known: Sequence[str]) -> Problem:
    """A broken rule of the parameter at `loc`: `("query", "limit")` is `limit`."""
    kind, (first, *loc) = entry["type"], entry["loc"]
    name = ".".join(map(str, loc)) or str(first)
    by_pattern = _PATTERNS.get(name) if kind == "string_pattern_mismatch" else None
    hint = f"{did_you_mean(name, known) or ';'} the parameters are {', '.join(known)}"
    return Problem(name, (by_pattern or rule_of(entry)) + hint * (kind == "extra_forbidden"), code_of(kind))


def _http(request: Request, refusal: Any) -> Response:
    """Refusals of `api` itself, and Starlette's 404 and 405, which lack a detail."""
    status, path = refusal.status_code, request.url.path
    if status == 304:
        return Response(status_code=status, headers=refusal.headers)
    if refusal.detail == "Not Found":
        return ProblemResponse(status, f"no endpoint {path}; /docs lists the endpoints")
    if status == 405:
        allowed = _allowed(request, (refusal.headers or {}).get("Allow", "GET"))
        detail = f"{path} does not support {request.method[:16]}"
        return ProblemResponse(status, detail, headers={"Allow": ", ".join(allowed)})
    return ProblemResponse(status, refusal.detail, headers=refusal.headers)


def _allowed(request: Request, named: str) -> list[str]:
    """The methods of all routes with this path; Starlette's Allow header names only one route's."""
    routes = [route for route in request.app.routes if not isinstance(route, Mount)]
    methods = {
        method
        for method in ("DELETE", "GET", "POST")
        if any(route.matches({**request.scope, "method": method})[0] is Match.FULL for route in routes)
    } | set(named.split(", "))
    return sorted(methods | ({"HEAD"} if "GET" in methods else set()))
