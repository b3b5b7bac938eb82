"""Errors as HTTP: one table from an error to its status, and the problem document that answers it.

Errors travel as `application/problem+json` (RFC 9457) with an extension:
`errors`, a list of `{"field", "rule"}`.
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
    NotInStore,
    QueueFull,
    TooLarge,
    Unauthenticated,
    UnknownJob,
    WrongMediaType,
)
from worker import store
from worker.spec.errors import Problem as Broken
from worker.spec.errors import SpecError, SpecTooLarge, SpecUnreadable
from worker.store import StoreError

log = logging.getLogger(__name__)

#: The one table, the first that fits. What is not here is a defect of the service and answers 500.
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
    KeyReused: HTTPStatus.CONFLICT,
    IllegalTransition: HTTPStatus.CONFLICT,
    TooLarge: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    QueueFull: HTTPStatus.TOO_MANY_REQUESTS,
    Busy: HTTPStatus.TOO_MANY_REQUESTS,
    NotComputed: HTTPStatus.SERVICE_UNAVAILABLE,
    NoSpace: HTTPStatus.INSUFFICIENT_STORAGE,
    StoreError: HTTPStatus.INTERNAL_SERVER_ERROR,
    **dict.fromkeys(store.UNREACHABLE, HTTPStatus.SERVICE_UNAVAILABLE),
    LedgerUnavailable: HTTPStatus.SERVICE_UNAVAILABLE,
    OSError: HTTPStatus.SERVICE_UNAVAILABLE,  # the data folder is gone, or not ours to use
}

#: Seconds a client is asked to wait before it tries again.
RETRY_AFTER: Final[Mapping[HTTPStatus, int]] = {
    HTTPStatus.TOO_MANY_REQUESTS: 5,
    HTTPStatus.SERVICE_UNAVAILABLE: 2,
}


class Problem(Response):
    """A problem document."""

    media_type = "application/problem+json"

    def __init__(
        self,
        status: int,
        detail: str,
        rules: Sequence[Broken] = (),
        headers: Mapping[str, str] | None = None,
    ) -> None:
        status = HTTPStatus(status)
        waits = {"Retry-After": str(RETRY_AFTER[status])} if status in RETRY_AFTER else {}
        if status == HTTPStatus.UNAUTHORIZED:
            waits = {"WWW-Authenticate": "Bearer"}
        document: dict[str, Any] = {"title": status.phrase, "status": int(status), "detail": detail}
        if rules:
            document["errors"] = [rule._asdict() for rule in rules]
        super().__init__(json.dumps(document), status, {**waits, **(headers or {})})


def install(app: FastAPI) -> None:
    """Make every error of `app` a problem document."""
    for kind in STATUS:
        app.add_exception_handler(kind, _refused)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(Exception, _defect)


def problem_of(error: Exception) -> Problem:
    """The problem document of an error in STATUS."""
    status = next(status for kind, status in STATUS.items() if isinstance(error, kind))
    if isinstance(error, LedgerUnavailable):
        log.error("%s", error)
    if isinstance(error, store.UNREACHABLE):
        log.error("the bucket of the results does not answer: %s", error)
        return Problem(status, "the place of the results does not answer")
    if isinstance(error, OSError):
        log.error("the disk does not do what is asked of it", exc_info=error)
        reason = error.strerror or type(error).__name__
        return Problem(status, f"the data folder cannot be used now: {reason}; the service's log says more")
    return Problem(status, str(error), getattr(error, "problems", ()))


def _refused(_: Request, error: Exception) -> Response:
    return problem_of(error)


def _invalid(_: Request, error: Exception) -> Response:
    """Query parameters that break a rule; the input is not repeated, it may not be valid JSON."""
    entries = cast(RequestValidationError, error).errors()
    rules = [Broken(_name(entry["loc"]), _rule(entry)) for entry in entries]
    return Problem(422, "; ".join(f"{field}: {rule}" for field, rule in rules), rules)


def _name(location: Sequence[str | int]) -> str:
    """`("query", "limit")` → `limit`."""
    return ".".join(str(part) for part in location[1:]) or str(location[0])


#: Rules that a pattern does not tell in words.
_WORDS: Final = {
    "cursor": "should be `next` of the page before",
    "idempotency-key": "should be made of ASCII characters, without spaces",
}


def _rule(entry: Mapping[str, Any]) -> str:
    if entry["type"] == "extra_forbidden":
        return "there is no such parameter"
    if entry["type"] == "missing":
        return "is required"
    if entry["type"] == "string_pattern_mismatch":
        return _WORDS.get(str(entry["loc"][-1]), str(entry["msg"])).removeprefix("String ")
    message = str(entry["msg"])
    return message.removeprefix("Value error, ").removeprefix("Input ").removeprefix("String ")


def _http(request: Request, error: Exception) -> Response:
    """Starlette's own 404 and 405."""
    refusal = cast(HTTPException, error)
    detail = refusal.detail
    if refusal.status_code == HTTPStatus.NOT_FOUND:
        detail = f"there is nothing at {request.url.path}; the calls are listed at /docs"
    if refusal.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
        detail = f"{request.url.path} does not answer {request.method}"
        allowed = _allowed(request, (refusal.headers or {}).get("Allow", "GET"))
        return Problem(refusal.status_code, detail, headers={"Allow": ", ".join(allowed)})
    return Problem(refusal.status_code, detail, headers=refusal.headers)


def _allowed(request: Request, named: str) -> list[str]:
    """The methods of all calls at an address: the one that refused names only its own."""
    calls = [route for route in request.app.routes if not isinstance(route, Mount)]
    found = {
        method
        for method in ("DELETE", "GET", "HEAD", "POST")
        if any(call.matches({**request.scope, "method": method})[0] is Match.FULL for call in calls)
    }
    return sorted(found | set(named.split(", ")))


def _defect(request: Request, error: Exception) -> Response:
    log.error("%s %s failed", request.method, request.url.path, exc_info=error)
    return Problem(500, "this is a defect of the service; its log says more")
