"""A whole service in this process: web server, application, and the workers it computes with.

`bounce serve` runs one until it is told to stop; `bounce figure` and the tests run one for as long as they
need it.
"""

import gc
import logging
import math
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType
from typing import Any, Final

import uvicorn
from fastapi import FastAPI
from pydantic import ValidationError
from starlette.types import Receive, Scope, Send

from service.api.app import create_app
from service.client.errors import BounceError
from service.errors import ServiceError
from service.jobs.ledger import Ledger
from service.server import logging as logs
from service.server.cluster import computing
from service.server.head_timeout import with_head_timeout
from service.settings import Settings
from worker.executors.base import Executor
from worker.executors.errors import ClusterLost
from worker.kernel_cache import claim_cache, warm

#: The web server's own log: silent until it has started, because why it does not start is raised, not logged.
_LOG: Final = logging.getLogger("uvicorn.error")


class NotStarted(BounceError):
    """The service cannot start; says why."""


def settings(**given: Any) -> Settings:
    """Settings from `BOUNCE_*` variables; what is given, and not None, goes before them.

    Raises NotStarted naming the setting and the rule.
    """
    try:
        return Settings(**{name: value for name, value in given.items() if value is not None})
    except ValidationError as error:
        rules = [": ".join([*map(str, one["loc"]), _rule(one["msg"])]) for one in error.errors()]
        raise NotStarted("settings: " + "; ".join(rules)) from error


def _rule(message: str) -> str:
    return message.removeprefix("Value error, ")


@contextmanager
def running(settings: Settings, executor: Executor | None = None) -> Iterator[str]:
    """A service in a thread of this process; gives its address, stops it at the end of the block.

    Computes with `executor` (its owner closes it), or with the cluster that the settings ask for, whose
    processes import the main module: a script that calls this needs the usual `if __name__ == "__main__"`.
    Raises NotStarted, as when another service uses the data folder or the port.
    """
    with _listening(settings) as listener, _computing(settings, executor) as chosen:
        server = _Server(settings, chosen, listener)
        thread = threading.Thread(target=server.run_until_told, name="bounce-server")
        thread.start()
        try:
            yield server.wait_until_started()
        finally:
            server.should_exit = True
            thread.join()


def serve(settings: Settings, announce: Callable[[str], None]) -> None:
    """Run a service until SIGINT or SIGTERM; `announce` gets one line when it listens. Raises NotStarted."""
    with (
        logs.to_standard_error(settings.log_level),
        _stopped_by_signals(),
        _listening(settings) as listener,
        _computing(settings, None) as executor,
    ):
        server = _Server(settings, executor, listener, announce)
        server.run_until_told()
        server.wait_until_started()
    gc.freeze()  # the process ends now: nobody needs it taken apart, which compiled kernels make long


class _Stopped(BaseException):
    """A signal to stop came; like KeyboardInterrupt, no ordinary handler may swallow it."""


@contextmanager
def _stopped_by_signals() -> Iterator[None]:
    """SIGINT and SIGTERM end the block, wherever it is; once it serves, the web server ends first."""
    before = {number: signal.signal(number, _stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    except _Stopped:
        pass
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _stop(number: int, frame: FrameType | None) -> None:
    raise _Stopped


class _Application:
    """The application, remembering the error its start ended with, which a web server only logs."""

    def __init__(self, app: FastAPI) -> None:
        self._app = app
        self.error: Exception | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await self._app(scope, receive, send)
        except Exception as error:
            if scope["type"] == "lifespan":
                self.error = error
            raise

    def close_events(self) -> None:
        """End the answers that go on for as long as a job does."""
        service = getattr(self._app.state, "service", None)
        if service is not None:
            service.watch.close()


class _Server(uvicorn.Server):
    """A web server that says when it has started and raises when it cannot."""

    def __init__(
        self,
        settings: Settings,
        executor: Executor,
        listener: socket.socket,
        announce: Callable[[str], None] = lambda line: None,
    ) -> None:
        self._listener, self._announce, self._settings = listener, announce, settings
        self._application = _Application(_created(settings, executor))
        self._decided = threading.Event()
        super().__init__(
            uvicorn.Config(
                self._application,
                http=with_head_timeout(settings.body_seconds),
                lifespan="on",
                log_config=None,
                log_level=logging.CRITICAL,
                access_log=False,
                server_header=False,
                timeout_graceful_shutdown=math.ceil(settings.shutdown_seconds),
            )
        )

    @property
    def address(self) -> str:
        """Where it listens."""
        host, port = self._listener.getsockname()[:2]
        return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Called by the web server; what comes after the application's own start."""
        self.where = self.address
        await super().startup(sockets)
        _LOG.setLevel(logging.WARNING)
        self._announce(f"bounce listens on {self.where} ({_means(self._settings)})")
        self._decided.set()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Called by the web server; answers that would not end by themselves are ended first."""
        self._application.close_events()
        await super().shutdown(sockets)

    def run_until_told(self) -> None:
        """Serve until a signal comes or `should_exit` is set."""
        try:
            self.run(sockets=[self._listener])
        except SystemExit:  # the web server's word for a failed start
            pass
        finally:
            self._decided.set()

    def wait_until_started(self) -> str:
        """The address, once it answers. Raises NotStarted, or the error itself if the start met a defect."""
        self._decided.wait()
        if self.started:
            return self.where
        raise _not_started(self._application.error) from self._application.error


def _created(settings: Settings, executor: Executor) -> FastAPI:
    try:
        return create_app(settings, executor)
    except (ServiceError, OSError) as error:
        raise _not_started(error) from error


def _not_started(error: Exception | None) -> Exception:
    """What a user should read, or the error itself if it is a defect."""
    if isinstance(error, ServiceError):
        return NotStarted(str(error))
    if isinstance(error, OSError):
        return NotStarted(f"{error.filename or 'the data folder'}: {error.strerror or error}")
    return error or NotStarted("the service was stopped before it had started")


def _means(settings: Settings) -> str:
    place = settings.scheduler or settings.scheduler_file or settings.cluster
    workers = f"cluster {place}" if place else f"{settings.workers} worker processes"
    return f"data in {settings.data}, {workers}"


@contextmanager
def _listening(settings: Settings) -> Iterator[socket.socket]:
    """A socket bound to the address of the settings; like the data folder, tried before the slow start."""
    host, port = settings.host, settings.port
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listener = socket.create_server((host, port), family=family, backlog=2048)
    except OSError as error:
        raise NotStarted(f"cannot listen on {host} port {port}: {error.strerror or error}") from error
    # Connections inherit it; without, each answer waits 40 ms for an acknowledgement of its head.
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    with listener:
        _try_data_folder(settings)
        yield listener


def _try_data_folder(settings: Settings) -> None:
    try:
        Ledger(settings.ledger_path).close()
    except (ServiceError, OSError) as error:
        raise _not_started(error) from error


@contextmanager
def _computing(settings: Settings, executor: Executor | None) -> Iterator[Executor]:
    """The executor that was given, or the cluster of the settings for as long as the block."""
    if executor is not None:
        yield executor
        return
    with ExitStack() as stack:
        try:
            cluster = stack.enter_context(computing(settings))
        except ClusterLost as error:
            raise NotStarted(str(error)) from error
        _warm_beside()
        yield cluster


def _warm_beside() -> None:
    """Have kernels ready here too, for motions are computed in this process; nobody waits for it.

    The workers have compiled by now, and left what they compiled. A process without a cache waits till asked.
    """
    if claim_cache() is not None:
        threading.Thread(target=warm, name="warm", daemon=True).start()
