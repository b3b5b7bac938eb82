"""Domain errors as HTTP responses: the table of statuses, and the response to each error.

Errors are sent as `application/problem+json` (RFC 9457) with an extension: `errors`, a list of
`{"field", "rule", "code"}`. Two exceptions need more than a status: `StoreDamaged` starts a repair, and
`Pending`, which is no error, becomes 202 with the progress of the workers.
"""

import json
import logging
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any, Final, cast

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.routing import Match, Mount

from service.api.schemas import PartsView, PendingView
from service.errors import (
    BodyTimeout,
    Busy,
    CrossOriginRefused,
    HostNotAllowed,
    IllegalTransition,
    InvalidRequest,
    KeyReused,
    LedgerUnavailable,
    NoSpace,
    NotComputed,
    NotInstalled,
    NotInStore,
    OutdatedJob,
    OutOfRange,
    QueueFull,
    TooLarge,
    TooManyListeners,
    Unauthenticated,
    UnknownJob,
    WrongMediaType,
)
from service.jobs.on_demand import Pending
from worker import store
from worker.spec.errors import Problem, SpecError, SpecTooLarge, SpecUnreadable, code_of
from worker.store import StoreDamaged, StoreError

log = logging.getLogger(__name__)

#: Status of each error; the first class that matches counts. Any other exception is a defect: 500.
STATUS: Final[Mapping[type[Exception], HTTPStatus]] = {
    SpecUnreadable: HTTPStatus.BAD_REQUEST,
    SpecTooLarge: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    SpecError: HTTPStatus.UNPROCESSABLE_ENTITY,
    WrongMediaType: HTTPStatus.UNSUPPORTED_MEDIA_TYPE,
    BodyTimeout: HTTPStatus.REQUEST_TIMEOUT,
    InvalidRequest: HTTPStatus.UNPROCESSABLE_ENTITY,
    Unauthenticated: HTTPStatus.UNAUTHORIZED,
    HostNotAllowed: HTTPStatus.MISDIRECTED_REQUEST,
    CrossOriginRefused: HTTPStatus.FORBIDDEN,
    UnknownJob: HTTPStatus.NOT_FOUND,
    NotInStore: HTTPStatus.NOT_FOUND,
    OutOfRange: HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE,
    KeyReused: HTTPStatus.CONFLICT,
    IllegalTransition: HTTPStatus.CONFLICT,
    OutdatedJob: HTTPStatus.CONFLICT,
    TooLarge: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    QueueFull: HTTPStatus.TOO_MANY_REQUESTS,
    Busy: HTTPStatus.TOO_MANY_REQUESTS,
    TooManyListeners: HTTPStatus.SERVICE_UNAVAILABLE,
    NotComputed: HTTPStatus.SERVICE_UNAVAILABLE,
    NotInstalled: HTTPStatus.NOT_IMPLEMENTED,
    NoSpace: HTTPStatus.INSUFFICIENT_STORAGE,
    StoreError: HTTPStatus.INTERNAL_SERVER_ERROR,
    **dict.fromkeys(store.UNREACHABLE, HTTPStatus.SERVICE_UNAVAILABLE),
    LedgerUnavailable: HTTPStatus.SERVICE_UNAVAILABLE,
    OSError: HTTPStatus.SERVICE_UNAVAILABLE,  # the data folder is missing or not accessible
}

#: Retry-After, in seconds.
RETRY_AFTER: Final[Mapping[HTTPStatus, int]] = {
    HTTPStatus.TOO_MANY_REQUESTS: 5,
    HTTPStatus.SERVICE_UNAVAILABLE: 2,
}


#: Retry-After of a response that workers are computing, in seconds.
PENDING_RETRY_AFTER: Final = 1


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
        status = HTTPStatus(status)
        own = {"Retry-After": str(RETRY_AFTER[status])} if status in RETRY_AFTER else {}
        if status == HTTPStatus.UNAUTHORIZED:
            own = {"WWW-Authenticate": "Bearer"}
        document: dict[str, Any] = {"title": status.phrase, "status": int(status), "detail": detail}
        if problems:
            document["errors"] = [problem._asdict() for problem in problems]
        # json.dumps escapes lone surrogates, which a caller's input may contain; Pydantic refuses them.
        super().__init__(json.dumps(document), status, {**own, **(headers or {})})


def install(app: FastAPI) -> None:
    """Register the handlers of all errors except defects, which `middleware.access_log` answers."""
    for error_class in STATUS:
        app.add_exception_handler(error_class, _refused)
    app.add_exception_handler(StoreDamaged, _damaged)
    app.add_exception_handler(Pending, _pending)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _http)


def problem_response(error: Exception) -> ProblemResponse:
    """The response to an error in STATUS."""
    status = next(status for error_class, status in STATUS.items() if isinstance(error, error_class))
    if isinstance(error, LedgerUnavailable):
        log.error("%s", error)
    if isinstance(error, store.UNREACHABLE):
        log.error("the bucket of the stores does not answer: %s", error)
        return ProblemResponse(status, "the bucket of the stores does not answer")
    if isinstance(error, OSError):
        log.error("the data folder cannot be used", exc_info=error)
        reason = error.strerror or type(error).__name__
        return ProblemResponse(status, f"the data folder cannot be used: {reason}; see the service log")
    headers = {"Content-Range": f"bytes */{error.size}"} if isinstance(error, OutOfRange) else None
    return ProblemResponse(status, str(error), getattr(error, "problems", ()), headers)


def internal_error(request_id: str) -> ProblemResponse:
    """The response to a defect of the service; the log has the traceback under the request's id."""
    return ProblemResponse(
        HTTPStatus.INTERNAL_SERVER_ERROR, f"internal error; see the service log (request {request_id})"
    )


def _refused(_: Request, error: Exception) -> Response:
    return problem_response(error)


def _damaged(request: Request, error: Exception) -> Response:
    """Start the repair of damaged results; 503 with the chunks, or 500 if they cannot be repaired."""
    scrubber = request.app.state.service.manager.scrubber
    chunks = cast(StoreDamaged, error).chunks
    try:
        detail, lasting = scrubber.report(request.path_params.get("job_id", ""), chunks)
    except LedgerUnavailable as unavailable:  # for example missing stores
        return problem_response(unavailable)
    status = HTTPStatus.INTERNAL_SERVER_ERROR if lasting else HTTPStatus.SERVICE_UNAVAILABLE
    return ProblemResponse(status, detail)


def _pending(_: Request, error: Exception) -> Response:
    """202 with the progress of the workers."""
    pending = cast(Pending, error)
    percent = round(100.0 * pending.done / pending.total, 1)
    progress = PartsView(parts_done=pending.done, parts_total=pending.total, percent=percent)
    content = PendingView(progress=progress).model_dump_json()
    return Response(content, 202, {"Retry-After": str(PENDING_RETRY_AFTER)}, "application/json")


def _invalid(_: Request, error: Exception) -> Response:
    """422 for query parameters and headers; without the input, which may not be valid JSON."""
    entries = cast(RequestValidationError, error).errors()
    problems = [Problem(_name(entry["loc"]), _rule(entry), code_of(entry["type"])) for entry in entries]
    detail = "; ".join(map(str, problems))
    return ProblemResponse(HTTPStatus.UNPROCESSABLE_ENTITY, detail, problems)


def _name(location: Sequence[str | int]) -> str:
    """`("query", "limit")` → `limit`."""
    return ".".join(str(part) for part in location[1:]) or str(location[0])


#: Rules in words for parameters that Pydantic checks by a pattern.
_PATTERN_RULES: Final = {
    "cursor": "should be `next` of the page before",
    "idempotency-key": "should be made of ASCII characters, without spaces",
}


def _rule(entry: Mapping[str, Any]) -> str:
    if entry["type"] == "extra_forbidden":
        return "unknown parameter"
    if entry["type"] == "missing":
        return "is required"
    if entry["type"] == "string_pattern_mismatch":
        return _PATTERN_RULES.get(str(entry["loc"][-1]), str(entry["msg"])).removeprefix("String ")
    message = str(entry["msg"])
    return message.removeprefix("Value error, ").removeprefix("Input ").removeprefix("String ")


def _http(request: Request, error: Exception) -> Response:
    """Starlette's own 404 and 405."""
    refusal = cast(HTTPException, error)
    path = request.url.path
    if refusal.status_code == HTTPStatus.NOT_FOUND:
        return ProblemResponse(HTTPStatus.NOT_FOUND, f"no endpoint {path}; /docs lists the endpoints")
    if refusal.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
        allowed = _allowed(request, (refusal.headers or {}).get("Allow", "GET"))
        detail = f"{path} does not support {request.method[:16]}"
        return ProblemResponse(HTTPStatus.METHOD_NOT_ALLOWED, detail, headers={"Allow": ", ".join(allowed)})
    return ProblemResponse(refusal.status_code, refusal.detail, headers=refusal.headers)


def _allowed(request: Request, named: str) -> list[str]:
    """The methods of all routes with this path; Starlette's Allow header names only one route's."""
    routes = [route for route in request.app.routes if not isinstance(route, Mount)]
    methods = {
        method
        for method in ("DELETE", "GET", "POST")
        if any(route.matches({**request.scope, "method": method})[0] is Match.FULL for route in routes)
    } | set(named.split(", "))
    return sorted(methods | ({"HEAD"} if "GET" in methods else set()))
