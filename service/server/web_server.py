"""uvicorn with startup errors as exceptions, limits on connections, and prompt shutdown."""

import asyncio
import logging
import math
import resource
import socket
import sys
from collections.abc import Callable
from concurrent.futures import Future
from http import HTTPStatus
from typing import Any, Final

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol

from service.api.problems import ProblemResponse
from service.errors import NotStarted
from service.settings import Settings

#: uvicorn's log is silent during startup, because startup errors are raised instead.
_LOG: Final = logging.getLogger("uvicorn.error")

#: Files of the process reserved for ledger, stores and workers.
OTHER_FILES: Final = 256
#: Connections accepted at a time. Even one that is refused soon takes a file.
ACCEPTED_AT_A_TIME: Final = 16
#: Connections waiting to be accepted.
BACKLOG: Final = 2048
#: Maximum open files requested, although some systems allow a thousand million.
MOST_FILES: Final = 65_536


def _answer(status: HTTPStatus, detail: str) -> bytes:
    """The answer to a connection that never reaches the application: a problem document, and the end."""
    problem = ProblemResponse(status, detail)
    headers = b"".join(b"%s: %s\r\n" % pair for pair in [*problem.raw_headers, (b"connection", b"close")])
    return b"HTTP/1.1 %d %s\r\n%s\r\n%s" % (status, status.phrase.encode(), headers, problem.body)


class WebServer(uvicorn.Server):
    """Serves an application on a bound socket; run it in one thread, wait for its `url` in any."""

    def __init__(
        self,
        app: FastAPI,
        settings: Settings,
        listener: socket.socket,
        on_start: Callable[[str], None] = lambda url: None,
        on_stop: Callable[[], None] = lambda: None,
    ) -> None:
        self._app, self._listener, self._on_start, self._on_stop = app, listener, on_start, on_stop
        #: The address once it has started; the error of the startup, or NotStarted if it was stopped before.
        self.url: Future[str] = Future()
        super().__init__(
            uvicorn.Config(
                app,
                ws="none",
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
            if self.started:  # the command's to SIGHUP
                raise
        finally:
            if not self.url.done():
                stopped = NotStarted("the service was stopped before it had started")
                self.url.set_exception(getattr(self._app.state, "startup_error", stopped))

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Called by uvicorn, after the startup of the application."""
        await super().startup(sockets)
        self._listener.listen(BACKLOG)  # asyncio has one number for both
        _LOG.setLevel(logging.WARNING)
        host, port = self._listener.getsockname()[:2]
        url = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
        try:
            self._on_start(url)
            self.url.set_result(url)
        except (OSError, UnicodeError) as error:  # raised here, it would leave the application running
            reason = error.strerror if isinstance(error, OSError) else error
            self.url.set_exception(NotStarted(f"standard output: {reason}"))
            self.should_exit = True

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Called by uvicorn; first ends event streams, which would otherwise last as long as their jobs."""
        self._on_stop()
        self._app.state.service.progress_stream.close()
        await super().shutdown(sockets)


class Limited(H11Protocol):
    """Request-header timeout, timeout of clients that do not read, and limit of connections.

    Closes a connection unless the head of a request is complete within `timeout` seconds from its first byte,
    or from the opening of the connection. `api.dependencies` limits the body. A connection above `limit` is
    answered with 503: without a limit, connections could take all files of the process. The system
    disconnects a client that reads nothing for `stall` seconds, because its answer is in memory.
    """

    timeout = 10.0
    limit = OTHER_FILES
    stall = 60.0
    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        """Called by the event loop."""
        super().connection_made(transport)
        if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux
            milliseconds = int(1000 * min(self.stall, 2e6))
            transport.get_extra_info("socket").setsockopt(
                socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, milliseconds
            )
        if len(self.connections) > self.limit:
            transport.write(_answer(HTTPStatus.SERVICE_UNAVAILABLE, "too many connections"))
            transport.close()
        else:
            self._start_timer()

    def connection_lost(self, exc: Exception | None) -> None:
        """Called by the event loop."""
        self._stop_timer()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Called by the event loop."""
        super().data_received(data)
        if self._responding:
            self._stop_timer()
        elif self._timer is None:
            self._start_timer()

    def send_400_response(self, msg: str) -> None:
        """Called by uvicorn, with its own text, for bytes that are not a request."""
        fault = str(sys.exception()).partition(":")[0]  # then h11 quotes the client, perhaps its token
        rule = f"the request is not HTTP/1.1 with a percent-encoded address and a short head: {fault}"
        self.transport.write(_answer(HTTPStatus.BAD_REQUEST, rule))
        self.transport.close()

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
            rule = f"the head of the request did not arrive within {self.timeout:g} s"
            self.transport.write(_answer(HTTPStatus.REQUEST_TIMEOUT, rule))
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
