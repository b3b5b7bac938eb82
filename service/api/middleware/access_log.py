"""Access log: one line and one metrics sample per request, and the 500 response to a defect."""

import logging
import sys
import time
import uuid
from typing import Final

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.monitoring import Metrics
from service.api.problems import internal_error

log = logging.getLogger("service.requests")

#: Routes that machines poll: logged at level debug unless they fail.
_POLLED_ROUTES: Final = frozenset({"/healthz", "/readyz", "/metrics"})


class AccessLog:
    """Middleware: gives each request an id, and logs and counts its response."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app, self._metrics = app, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id, began, status = uuid.uuid4().hex, time.perf_counter(), 0

        async def send_with_id(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                message["headers"] = [*message["headers"], (b"x-request-id", request_id.encode())]
            await send(message)

        try:
            await self._app(scope, receive, send_with_id)
        except Exception:
            log.exception("internal error", extra={"fields": {"id": request_id}})
            if status:
                raise  # the response has begun: only closing the connection remains
            await internal_error(request_id)(scope, receive, send_with_id)
        finally:
            self._record(scope, request_id, status, time.perf_counter() - began)

    def _record(self, scope: Scope, request_id: str, status: int, seconds: float) -> None:
        """Write the line, without input that could forge a line or leak a secret."""
        route = getattr(scope.get("route"), "path", "none")
        self._metrics.count_request(scope["method"], route, status, seconds)
        fields = {
            "id": request_id,
            "method": scope["method"][:16],
            "route": route,
            "status": status,
            "ms": round(1000 * seconds, 1),
        }
        job = scope.get("path_params", {}).get("job_id")
        is_routine = route in _POLLED_ROUTES or sys.stderr.isatty()  # on a terminal the user sees the answers
        level = logging.DEBUG if is_routine and status < 400 else logging.INFO
        log.log(level, "request", extra={"fields": fields | ({"job": job[:64]} if job else {})})
