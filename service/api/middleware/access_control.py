"""Access control: by the Host header, by the origin of the web page that sends a request, by access token.

On loopback every local user may use the service. The Host check keeps out web pages of other origins, which
could otherwise bind their domain name to 127.0.0.1 (DNS rebinding) and read the responses. A service that
other machines can reach requires a token (`settings`).
"""

import hmac
from collections.abc import Mapping, Set
from typing import Final
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.problems import problem_response
from service.errors import CrossOriginRefused, HostNotAllowed, ServiceError, Unauthenticated

#: Paths that need no token: health checks, and pages that contain no data.
OPEN_PATHS: Final = frozenset({"/", "/docs", "/openapi.json", "/healthz", "/readyz"})
OPEN_FOLDER: Final = "/static/"

#: Methods that change nothing.
SAFE: Final = frozenset({"GET", "HEAD", "OPTIONS"})

#: Headers of every response that does not set its own; only the page at / needs scripts, and sets its own.
HEADERS: Final = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; img-src data:;"
    " frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
}
#: Headers for a web page that asks what it may send, and the headers that it may read.
_PREFLIGHT: Final = {
    "Access-Control-Allow-Methods": "GET, HEAD",
    "Access-Control-Allow-Headers": "Authorization, Range, If-None-Match, Accept",
    "Access-Control-Max-Age": "600",
}
_EXPOSED: Final = "Accept-Ranges, Bounce-Complete, Bounce-Store, Content-Range, ETag, Link, Retry-After"
_RAW_HEADERS: Final = [(name.lower().encode(), value.encode()) for name, value in HEADERS.items()]


class AccessControl:
    """Middleware: refuses requests with the wrong Host, Origin or token; adds security headers.

    `tokens` are the names of the accepted tokens, by token; if there are none, none is required.
    Web pages of `origins` may read and send a token, but change nothing.
    """

    def __init__(
        self,
        app: ASGIApp,
        hosts: Set[str],
        tokens: Mapping[str, str | None],
        origins: Set[str] = frozenset(),
    ) -> None:
        self._app, self._hosts, self._origins = app, hosts, origins
        self._tokens = [(token.encode(), name) for token, name in tokens.items()]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        if self._origins:
            send = _with_cors(send, self._reader(scope["method"], headers))
        if "content-length" in headers and "transfer-encoding" in headers:
            send = _closing(send)
        try:
            scope.setdefault("state", {})["token_name"] = self._check(scope["method"], scope["path"], headers)
        except ServiceError as error:
            await problem_response(error)(scope, receive, _with_headers(send))
        else:
            if self._reader(scope["method"], headers) and _is_preflight(scope["method"], headers):
                await Response(status_code=204, headers=_PREFLIGHT)(scope, receive, _with_headers(send))
            else:
                await self._app(scope, receive, _with_headers(send))

    def _reader(self, method: str, headers: Headers) -> str | None:
        """The origin in the settings whose web page may read the answer."""
        origins = headers.getlist("origin")
        return origins[0] if method in SAFE and len(origins) == 1 and origins[0] in self._origins else None

    def _check(self, method: str, path: str, headers: Headers) -> str | None:
        """The name of the request's token, if one is required and has a name."""
        self._check_host(headers.getlist("host"))
        if method not in SAFE:
            _check_origin(headers)
        elif self._reader(method, headers):
            if _is_preflight(method, headers):
                return None  # a browser sends it without a token
        elif not _same_site(headers) and not _is_navigation(headers):
            raise CrossOriginRefused(
                "Sec-Fetch-Site: web pages of another origin may link to this, not load it"
            )
        if self._tokens and path not in OPEN_PATHS and not path.startswith(OPEN_FOLDER):
            return self._check_token(headers.getlist("authorization"))
        return None

    def _check_host(self, values: list[str]) -> None:
        name = _host_name(values[0]) if len(values) == 1 else ""
        if "*" not in self._hosts and name not in self._hosts:
            raise HostNotAllowed(
                f"the Host {name[:80]!a} is not allowed; the operator can add it to BOUNCE_ALLOWED_HOSTS"
            )

    def _check_token(self, values: list[str]) -> str | None:
        scheme, _, token = values[0].partition(" ") if len(values) == 1 else ("", "", "")
        sent = token.strip().encode()
        # All are compared, each in constant time: the time taken reveals nothing.
        names = [name for accepted, name in self._tokens if hmac.compare_digest(sent, accepted)]
        if not names or scheme.lower() != "bearer":
            raise Unauthenticated(
                "The access token is wrong."
                if values
                else "This service requires an access token. Send the header Authorization: Bearer TOKEN."
            )
        return names[0]


def _is_preflight(method: str, headers: Headers) -> bool:
    """Whether a browser asks what a web page may send."""
    return method == "OPTIONS" and "access-control-request-method" in headers


def _check_origin(headers: Headers) -> None:
    """Refuse pages of another origin; only browsers send these headers, so other clients pass."""
    same_origin = all(_authority(origin) == headers.get("host") for origin in headers.getlist("origin"))
    if not same_origin or not _same_site(headers):
        raise CrossOriginRefused("Origin: web pages of another origin must not change anything")


def _same_site(headers: Headers) -> bool:
    return all(site in ("none", "same-origin") for site in headers.getlist("sec-fetch-site"))


def _is_navigation(headers: Headers) -> bool:
    """Whether the answer becomes the page shown to the user, unlike a frame or an image."""
    return headers.getlist("sec-fetch-mode") == ["navigate"] and (
        headers.getlist("sec-fetch-dest") == ["document"]
    )


def _authority(origin: str) -> str:
    """Host and port of an Origin header; empty if it is malformed."""
    try:
        return urlsplit(origin).netloc
    except ValueError:
        return ""


def _host_name(host: str) -> str:
    """The name in a Host header, without its port: `[::1]:8000` → `::1`; empty if it is malformed."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""
    return name.rstrip(".") if "@" not in host else ""


def _closing(send: Send) -> Send:
    """`send`, closing the connection after the response.

    A request with both headers may end elsewhere than a proxy believes (RFC 9112, 6.1): nothing after it may
    count as a request.
    """

    async def send_and_close(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message["headers"], (b"connection", b"close")]
        await send(message)

    return send_and_close


def _with_cors(send: Send, origin: str | None) -> Send:
    """`send`, adding the headers by which a browser lets a page of `origin`, if any, read the response."""
    added = [(b"vary", b"Origin")]
    if origin is not None:
        added += [
            (b"access-control-allow-origin", origin.encode()),
            (b"access-control-expose-headers", _EXPOSED.encode()),
            (b"cross-origin-resource-policy", b"cross-origin"),
        ]

    async def send_with_cors(message: Message) -> None:
        if message["type"] == "http.response.start":
            replaced = {name for name, _ in added[1:]}
            kept = [(name, value) for name, value in message["headers"] if name not in replaced]
            message["headers"] = [*kept, *added]
        await send(message)

    return send_with_cors


def _with_headers(send: Send) -> Send:
    """`send`, adding the security headers that a response does not set itself."""

    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            present = {name for name, _ in message["headers"]}
            message["headers"] = [
                *message["headers"],
                *((name, value) for name, value in _RAW_HEADERS if name not in present),
            ]
        await send(message)

    return send_with_headers
