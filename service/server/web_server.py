"""uvicorn with startup errors as exceptions, limits on connections, and prompt shutdown."""

import asyncio
import logging
import math
import resource
import socket
import threading
from collections.abc import Callable
from typing import Any, Final

import uvicorn
from fastapi import FastAPI
from starlette.types import Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from service.errors import NotStarted
from service.settings import Settings

#: uvicorn's log is silent during startup, because startup errors are raised instead.
_LOG: Final = logging.getLogger("uvicorn.error")

#: Files of the process reserved for ledger, stores and workers.
OTHER_FILES: Final = 256
#: Connections accepted at a time. Each takes a file until it is refused, a little later.
ACCEPTED_AT_A_TIME: Final = 16
#: Connections waiting to be accepted.
BACKLOG: Final = 2048
#: Maximum open files requested, although some systems allow a thousand million.
MOST_FILES: Final = 65_536

_FULL_RESPONSE: Final = (
    b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\nRetry-After: 2\r\nConnection: close\r\n\r\n"
)
_TIMEOUT_RESPONSE: Final = b"HTTP/1.1 408 Request Timeout\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


class WebServer(uvicorn.Server):
    """Serves an application on a bound socket; run it in one thread, wait in any."""

    def __init__(
        self,
        app: FastAPI,
        settings: Settings,
        listener: socket.socket,
        on_start: Callable[[str], None] = lambda url: None,
        on_stop: Callable[[], None] = lambda: None,
    ) -> None:
        self._app, self._listener = _Application(app), listener
        self._on_start, self._on_stop = on_start, on_stop
        self._started_or_failed = threading.Event()
        super().__init__(
            uvicorn.Config(
                self._app,
                http=limited(settings.body_seconds, connections_allowed(), settings.stall_seconds),
                lifespan="on",
                backlog=ACCEPTED_AT_A_TIME,
                log_config=None,
                log_level=logging.CRITICAL,
                access_log=False,
                server_header=False,
                timeout_graceful_shutdown=math.ceil(settings.shutdown_seconds),
            )
        )

    def serve_until_stopped(self) -> None:
        """Serve until SIGINT or SIGTERM comes or `should_exit` is set."""
        try:
            self.run(sockets=[self._listener])
        except SystemExit:  # uvicorn's reaction to a failed startup
            pass
        finally:
            self._started_or_failed.set()

    def wait_until_started(self) -> str:
        """Wait for the end of the startup; returns the URL, or raises the startup's error.

        Raises NotStarted if the server was stopped before it had started.
        """
        self._started_or_failed.wait()
        if not self.started:
            raise self._app.startup_error or NotStarted("the service was stopped before it had started")
        return self._url

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Called by uvicorn, after the startup of the application."""
        host, port = self._listener.getsockname()[:2]
        self._url = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
        await super().startup(sockets)
        self._listener.listen(BACKLOG)  # asyncio has one number for both
        _LOG.setLevel(logging.WARNING)
        self._on_start(self._url)
        self._started_or_failed.set()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Called by uvicorn; first ends event streams, which would otherwise last as long as their jobs."""
        self._on_stop()
        self._app.close_streams()
        await super().shutdown(sockets)


class _Application:
    """The application, keeping the error of a failed startup, which uvicorn only logs."""

    def __init__(self, app: FastAPI) -> None:
        self._app = app
        self.startup_error: Exception | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await self._app(scope, receive, send)
        except Exception as error:
            if scope["type"] == "lifespan":
                self.startup_error = error
            raise

    def close_streams(self) -> None:
        service = getattr(self._app.state, "service", None)
        if service is not None:
            service.progress_stream.close()


class Limited(H11Protocol):
    """Request-header timeout, timeout of clients that do not read, and limit of connections.

    Closes a connection unless the head of a request is complete within `timeout` seconds from its first byte,
    or from the opening of the connection. `api.middleware.body_limit` limits the body. A connection above
    `limit` is answered with 503: without a limit, connections could take all files of the process.
    A client that reads nothing for `stall` seconds is disconnected, because its answer is in memory.
    """

    timeout = 10.0
    limit = OTHER_FILES
    stall = 60.0
    _stalled: asyncio.TimerHandle | None = None
    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        """Called by the event loop."""
        super().connection_made(transport)
        if len(self.connections) > self.limit:
            transport.write(_FULL_RESPONSE)
            transport.close()
        else:
            self._start_timer()

    def connection_lost(self, exc: Exception | None) -> None:
        """Called by the event loop."""
        self._stop_timer()
        self._stop_stalled()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """Called by the transport when the client does not read as fast as the service writes."""
        super().pause_writing()
        self._watch_reader(0)

    def resume_writing(self) -> None:
        """Called by the transport when the client has read."""
        self._stop_stalled()
        super().resume_writing()

    def _watch_reader(self, before: int) -> None:
        """Disconnect a client with as many waiting bytes as `stall` seconds ago."""
        waiting = self.transport.get_write_buffer_size()
        if waiting == before:
            self.transport.abort()
        else:
            self._stalled = self.loop.call_later(self.stall, self._watch_reader, waiting)

    def _stop_stalled(self) -> None:
        if self._stalled is not None:
            self._stalled.cancel()
            self._stalled = None

    def data_received(self, data: bytes) -> None:
        """Called by the event loop."""
        super().data_received(data)
        if self._responding:
            self._stop_timer()
        elif self._timer is None:
            self._start_timer()

    @property
    def _responding(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _start_timer(self) -> None:
        self._timer = self.loop.call_later(self.timeout, self._on_timeout)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _on_timeout(self) -> None:
        self._timer = None
        if not self._responding and not self.transport.is_closing():
            self.transport.write(_TIMEOUT_RESPONSE)
            self.transport.close()


def limited(timeout: float, limit: int, stall: float = Limited.stall) -> type[H11Protocol]:
    """The protocol class for uvicorn's `http` option, with these limits."""
    return type("Limited", (Limited,), {"timeout": timeout, "limit": limit, "stall": stall})


def raise_file_limit() -> None:
    """Raise the limit on open files to what the system allows, up to MOST_FILES."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    allowed = MOST_FILES if hard == resource.RLIM_INFINITY else min(hard, MOST_FILES)
    if soft != resource.RLIM_INFINITY and soft < allowed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, hard))


def connections_allowed() -> int:
    """Number of connections that leaves enough of the process's files for the rest."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    files = MOST_FILES if soft == resource.RLIM_INFINITY else min(soft, MOST_FILES)
    return max(files - OTHER_FILES, files // 2)
