"""Work around every request: access control, headers of the response, HEAD, access log and metrics.

On loopback every local user may use the service. The Host check keeps out web pages of other origins, which
could otherwise bind their domain name to 127.0.0.1 (DNS rebinding) and read the responses. A service that
other machines can reach requires a token (`settings`).
"""

import asyncio
import hmac
import logging
import sys
import time
import uuid
from collections.abc import Mapping
from typing import Final
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.monitoring import Metrics
from service.api.problems import ProblemResponse
from service.settings import Settings

log = logging.getLogger("service.requests")

#: Paths that need no token: health checks, and pages that contain no data.
OPEN_PATHS: Final = frozenset({"/", "/docs", "/openapi.json", "/healthz", "/readyz"})

#: Methods that change nothing.
_SAFE: Final = frozenset({"GET", "HEAD", "OPTIONS"})

#: Routes that machines poll: logged at level debug unless they fail.
_POLLED_ROUTES: Final = frozenset({"/healthz", "/readyz", "/metrics"})

#: Headers of every response that does not set its own; only the page at / needs scripts, and sets its own.
_HEADERS: Final = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; img-src data:;"
    " frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
}

#: Statuses of requests whose body may not have been read: the connection closes.
_UNREAD: Final = frozenset({408, 413, 415})

#: To a client whose request is cancelled by the shutdown, after `shutdown_seconds`.
_STOPPING: Final = "the service stops: repeat the request"


class Gate:
    """Middleware: refuses requests with the wrong Host, Origin or token; completes and logs every response.

    `tokens`: names by token; if empty, no token is required. HEAD gets the answer of GET without its body,
    for every route.
    """

    def __init__(
        self, app: ASGIApp, metrics: Metrics, settings: Settings, tokens: Mapping[str, str | None]
    ) -> None:
        self._app, self._metrics = app, metrics
        self._hosts = settings.hosts
        self._tokens = [(token.encode(), name) for token, name in tokens.items()]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers, is_head = Headers(scope=scope), scope["method"] == "HEAD"
        inner = {"state": {}, **scope, "method": "GET" if is_head else scope["method"]}
        request_id, began, status, head_ended = uuid.uuid4().hex, time.perf_counter(), 0, False

        async def send_completed(message: Message) -> None:
            nonlocal status, head_ended
            if message["type"] == "http.response.start":
                status = message["status"]
                answer = MutableHeaders(scope=message)
                answer["X-Request-Id"] = request_id
                self._complete(answer, headers, status, inner)
                await send(message)
            elif not is_head:
                await send(message)
            elif not head_ended:
                head_ended = True
                await send({"type": "http.response.body"})

        async def receive_until_ended() -> Message:
            # A stream with nothing more to send must end.
            return {"type": "http.disconnect"} if head_ended else await receive()

        try:
            inner["state"]["token_name"] = self._check(inner["method"], inner["path"], headers)
            if inner["path"].endswith("\n"):  # the `$` of a route would match before it
                raise HTTPException(404, f"no endpoint {inner['path']!a}; /docs lists the endpoints")
            await self._app(inner, receive_until_ended, send_completed)
        except HTTPException as error:
            refusal = ProblemResponse(error.status_code, error.detail, (), error.headers)
            await refusal(inner, receive, send_completed)
        except asyncio.CancelledError:
            if status:
                raise
            await ProblemResponse(503, _STOPPING)(inner, receive, send_completed)
        except Exception:
            log.exception("internal error", extra={"fields": {"id": request_id}})
            if status:
                raise  # the response has begun: only closing the connection remains
            detail = f"internal error; see the service log (request {request_id})"
            await ProblemResponse(500, detail)(inner, receive, send_completed)
        finally:
            self._record(scope["method"], inner, request_id, status, time.perf_counter() - began)

    def _complete(self, answer: MutableHeaders, headers: Headers, status: int, scope: Scope) -> None:
        """Add the headers of every response, and its tag if it has one."""
        for name, value in _HEADERS.items():
            answer.setdefault(name, value)
        # a proxy may see another end of a request with both headers (RFC 9112, 6.1): it is the last one
        if status in _UNREAD or ("content-length" in headers and "transfer-encoding" in headers):
            answer["Connection"] = "close"
        if status in (200, 304) and "tag" in scope["state"]:
            answer.update({"ETag": scope["state"]["tag"], "Cache-Control": "no-cache"})

    def _record(self, method: str, scope: Scope, request_id: str, status: int, seconds: float) -> None:
        """Count and log the request, without input that could forge a line or leak a secret."""
        route = getattr(scope.get("route"), "path", "none")
        self._metrics.count_request(method, route, status, seconds)
        ms = round(1000 * seconds, 1)
        fields = {"id": request_id, "method": method[:16], "route": route, "status": status, "ms": ms}
        job = scope.get("path_params", {}).get("job_id")
        is_routine = route in _POLLED_ROUTES or sys.stderr.isatty()  # on a terminal the user sees the answers
        level = logging.DEBUG if is_routine and status < 400 else logging.INFO
        log.log(level, "request", extra={"fields": fields | ({"job": job[:64]} if job else {})})

    def _check(self, method: str, path: str, headers: Headers) -> str | None:
        """The name of the request's token, if one is required and has a name."""
        self._check_host(headers.getlist("host"))
        same_site = all(site in ("none", "same-origin") for site in headers.getlist("sec-fetch-site"))
        if method not in _SAFE:
            own = {f"{scheme}://{headers.get('host')}" for scheme in ("http", "https")}
            if not same_site or not own.issuperset(headers.getlist("origin")):
                rule = "web pages of another origin must not change anything; a proxy must pass Host on"
                raise HTTPException(403, f"Origin: {rule}")
            # Tags of jobs are weak: by RFC 9110, 13.1.1 none matches.
            if headers.get("if-match", "*").strip() != "*":
                raise HTTPException(412, "If-Match: changes depend on no tag: leave the header out")
        elif not (same_site or _is_navigation(headers)):
            raise HTTPException(
                403, "Sec-Fetch-Site: web pages of another origin may link to this, not load it"
            )
        if self._tokens and path not in OPEN_PATHS and not path.startswith("/static/"):
            return self._check_token(headers.getlist("authorization"))
        return None

    def _check_host(self, values: list[str]) -> None:
        name = _host_name(values[0]) if len(values) == 1 else ""
        if "*" not in self._hosts and name not in self._hosts:
            remedy = "the operator can add it to BOUNCE_ALLOWED_HOSTS"
            raise HTTPException(421, f"the Host {name[:80]!a} is not allowed; {remedy}")

    def _check_token(self, values: list[str]) -> str | None:
        scheme, _, token = values[0].partition(" ") if len(values) == 1 else ("", "", "")
        sent = token.strip().encode()
        # compares all, each in constant time: the time taken reveals nothing
        names = [name for accepted, name in self._tokens if hmac.compare_digest(sent, accepted)]
        if not names or scheme.lower() != "bearer":
            missing = (
                "This service requires an access token: the header Authorization: Bearer TOKEN, or "
                "BOUNCE_TOKEN of bounce and the client."
            )
            detail = "The access token is wrong." if values else missing
            raise HTTPException(401, detail, {"WWW-Authenticate": "Bearer"})
        return names[0]


def _is_navigation(headers: Headers) -> bool:
    """Whether the answer becomes the page shown to the user, unlike a frame or an image."""
    modes, targets = headers.getlist("sec-fetch-mode"), headers.getlist("sec-fetch-dest")
    return modes == ["navigate"] and targets == ["document"]


def _host_name(host: str) -> str:
    """The name in a Host header, without its port: `[::1]:8000` → `::1`; empty if it is malformed."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""
    return name.rstrip(".") if "@" not in host else ""
