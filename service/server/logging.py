"""What happens, one event a line: JSON on standard error, for people and for machines that collect it."""

import json
import logging
import sys
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from http import HTTPStatus
from typing import Any, Final

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.metrics import Metrics
from service.api.problems import Problem

log = logging.getLogger("service.requests")

#: Asked all day long by machines; worth a line only when something is wrong.
PROBES: Final = frozenset({"/healthz", "/readyz", "/metrics"})

#: Libraries that write their own lines unless told otherwise.
_TALKATIVE: Final = ("distributed", "tornado", "bokeh", "uvicorn", "asyncio")


class JsonLines(logging.Formatter):
    """A record as one line of JSON; `extra={"fields": {...}}` adds members, a traceback becomes one."""

    def format(self, record: logging.LogRecord) -> str:
        """The line, without its end."""
        line: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "event": record.getMessage(),
            **getattr(record, "fields", {}),
        }
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


@contextmanager
def to_standard_error(level: str) -> Iterator[None]:
    """Send the process's log there for as long as the block, one JSON object a line."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines())
    root = logging.getLogger()
    root.addHandler(handler)
    for ours in ("service", "worker"):
        logging.getLogger(ours).setLevel(level.upper())
    for name in list(logging.root.manager.loggerDict):
        if name.split(".")[0] in _TALKATIVE:
            logger = logging.getLogger(name)
            logger.handlers.clear()
            logger.propagate = True
            logger.setLevel(max(logger.level, logging.WARNING))
    try:
        yield
    finally:
        root.removeHandler(handler)
        for ours in ("service", "worker"):
            logging.getLogger(ours).setLevel(logging.NOTSET)


class AccessLog:
    """Middleware: gives every request an id, and tells log and metrics what became of it."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app, self._metrics = app, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id, began, status = uuid.uuid4().hex, time.perf_counter(), 0

        async def sending(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                message["headers"] = [*message["headers"], (b"x-request-id", request_id.encode())]
            await send(message)

        try:
            await self._app(scope, receive, sending)
        except Exception:
            log.exception("a defect", extra={"fields": {"id": request_id}})
            if status:
                raise
            detail = f"this is a defect of the service; its log says more of request {request_id}"
            await Problem(HTTPStatus.INTERNAL_SERVER_ERROR, detail)(scope, receive, sending)
        finally:
            self._tell(scope, request_id, status, time.perf_counter() - began)

    def _tell(self, scope: Scope, request_id: str, status: int, seconds: float) -> None:
        route = getattr(scope.get("route"), "path", "none")
        self._metrics.answered(scope["method"], route, status, seconds)
        fields = {
            "id": request_id,
            "method": scope["method"][:16],
            "route": route,
            "status": status,
            "ms": round(1000 * seconds, 1),
        }
        job = scope.get("path_params", {}).get("job_id")
        level = logging.DEBUG if route in PROBES and status < 400 else logging.INFO
        log.log(level, "request", extra={"fields": fields | ({"job": job[:64]} if job else {})})
