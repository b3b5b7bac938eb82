"""Who may ask: by the name they ask for, by the page they ask from, by the token they bring.

On loopback whoever can reach the service may use it, so the names it answers to are few: a web page
elsewhere cannot make a browser speak to it under a name of its own. Everywhere else a token is needed.
"""

import hmac
from typing import Final
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.problems import problem_of
from service.errors import CrossOriginRefused, HostNotAllowed, ServiceError, Unauthenticated
from service.settings import Settings

#: What answers without a token: whether the service lives, and pages that hold nothing of anybody's.
OPEN_PATHS: Final = frozenset({"/", "/docs", "/openapi.json", "/healthz", "/readyz"})
OPEN_FOLDER: Final = "/static/"

#: Methods that change nothing.
SAFE: Final = frozenset({"GET", "HEAD", "OPTIONS"})

#: On every answer that has none of its own. Nothing of ours needs a script but the page, which says so.
HEADERS: Final = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; img-src data:;"
    " frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
}
_RAW_HEADERS: Final = [(name.lower().encode(), value.encode()) for name, value in HEADERS.items()]


class AccessControl:
    """Middleware: refuses requests from where, or without what, they must not come."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._hosts = settings.hosts
        self._token = settings.token.get_secret_value().encode() if settings.token else None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            self._check(scope["method"], scope["path"], Headers(scope=scope))
        except ServiceError as error:
            await problem_of(error)(scope, receive, with_headers(send))
        else:
            await self._app(scope, receive, with_headers(send))

    def _check(self, method: str, path: str, headers: Headers) -> None:
        self._check_host(headers.getlist("host"))
        if method not in SAFE:
            _check_page(headers)
        if self._token is not None and path not in OPEN_PATHS and not path.startswith(OPEN_FOLDER):
            self._check_token(headers.getlist("authorization"))

    def _check_host(self, given: list[str]) -> None:
        name = host_name(given[0]) if len(given) == 1 else ""
        if "*" not in self._hosts and name not in self._hosts:
            raise HostNotAllowed(
                f"Host: the service does not answer to the name {name[:80]!a}; "
                "its operator may add it to BOUNCE_ALLOWED_HOSTS"
            )

    def _check_token(self, given: list[str]) -> None:
        scheme, _, token = given[0].partition(" ") if len(given) == 1 else ("", "", "")
        expected = self._token or b""
        if not hmac.compare_digest(token.strip().encode(), expected) or scheme.lower() != "bearer":
            came = "this is not the one" if given else "none came"
            raise Unauthenticated(f"Authorization: must hold the service's token (Bearer TOKEN); {came}")


def _check_page(headers: Headers) -> None:
    """A browser says which page makes it ask; programs say nothing and are let through."""
    origin, site = headers.get("origin"), headers.get("sec-fetch-site", "none")
    ours = origin is None or urlsplit(origin).netloc == headers.get("host")
    if not ours or site not in ("none", "same-origin"):
        raise CrossOriginRefused("Origin: a page from elsewhere must not change anything here")


def host_name(host: str) -> str:
    """The name in a Host header, without its port: `[::1]:8000` → `::1`."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""
    return name.rstrip(".") if "@" not in host else ""


def with_headers(send: Send) -> Send:
    """`send`, adding the headers that every answer has."""

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            given = {name for name, _ in message["headers"]}
            message["headers"] = [
                *message["headers"],
                *((name, value) for name, value in _RAW_HEADERS if name not in given),
            ]
        await send(message)

    return sending
