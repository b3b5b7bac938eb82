"""A whole service in this process: web server, application and cluster.

`bounce serve` runs one until a signal stops it; `bounce figure` and the tests run one during a
block.
"""

import errno
import gc
import http.client
import json
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any, Final

from pydantic import SecretStr, ValidationError

from service import address, tokens
from service.api.app import TITLE, create_app
from service.background import Processes
from service.errors import LedgerUnavailable, NotComputed, NotStarted
from service.jobs.stores.adoption import open_ledger
from service.server.cluster import connected_cluster
from service.server.logging import log_to_stderr, quiet_libraries
from service.server.web_server import BACKLOG, WebServer, raise_file_limit
from service.settings import Settings
from service.views import registry
from worker.executors.base import Executor
from worker.executors.errors import ClusterLost
from worker.kernel_cache import CacheRefused
from worker.ownership import PRIVATE_FILE, NotOurs, make_private

#: Seconds after which a computing thread lets another one run: requests wait for it.
_SWITCH_SECONDS: Final = 0.001

#: Permissions that the files of a private service lack: all of group and others.
_PRIVATE_UMASK: Final = 0o077
_TOKEN_VARIABLE: Final = "BOUNCE_TOKEN"

#: Limits on asking the program that has the port: seconds for each piece, bytes of its answer.
_ANSWER_SECONDS: Final = 2.0
_MOST_BYTES: Final = 4_000_000


def settings(**overrides: Any) -> Settings:
    """Settings from `BOUNCE_*` variables, overridden by arguments that are not None.

    Raises NotStarted naming the setting and the rule.
    """
    try:
        return Settings(**{name: value for name, value in overrides.items() if value is not None})
    except ValidationError as error:
        rules = [": ".join([*map(str, entry["loc"]), _rule(entry["msg"])]) for entry in error.errors()]
        raise NotStarted("settings: " + "; ".join(rules)) from error


def _rule(message: str) -> str:
    return message.removeprefix("Value error, ")


@contextmanager
def running(settings: Settings, executor: Executor | None = None) -> Iterator[str]:
    """Run a service in a thread of this process during the block; yields its URL.

    Computes with `executor`, which the caller closes, or with the cluster of the settings. The processes of
    an embedded cluster import the main module: a script that calls this needs `if __name__ == "__main__"`.
    Raises NotStarted, for example if another service uses the data folder or the port.
    """
    with (
        _listening(settings) as (listener, marker),
        _with_own_token(settings, listener) as complete,
        _computing(settings, marker, executor) as chosen,
    ):
        with _startup_errors():
            server = WebServer(create_app(complete, chosen), settings, listener)
        thread = threading.Thread(target=server.serve_until_stopped, name="bounce-server")
        thread.start()
        try:
            with _startup_errors():
                url = server.wait_until_started()
            yield url
        finally:
            server.should_exit = True
            thread.join()


def serve(settings: Settings, announce: Callable[[str], None]) -> None:
    """Run a service until SIGINT or SIGTERM; `announce` gets one line once it listens.

    Raises NotStarted, and KeyboardInterrupt after SIGINT, once everything has ended.
    """

    def announce_url(url: str) -> None:
        record(url)
        announce(f"bounce listens on {url} ({_summary(settings)})")

    raise_file_limit()
    sys.setswitchinterval(_SWITCH_SECONDS)
    with (
        _stopped_by_signals(),
        log_to_stderr(settings.log_level),
        _umask(settings),
        _listening(settings) as (listener, marker),
        _with_own_token(settings, listener) as complete,
        _computing(settings, marker, None) as executor,
        closing(Processes(settings.max_reads + settings.max_exports)) as background,
        address.recorder(settings.data) as record,
    ):
        threading.Thread(target=_warm_answers, args=[background], name="warm-answers", daemon=True).start()
        with _startup_errors():
            app = create_app(complete, executor, background)
            server = WebServer(app, settings, listener, announce_url, quiet_libraries)
        server.serve_until_stopped()
        with _startup_errors():
            server.wait_until_started()
    gc.freeze()  # collecting the objects of compiled kernels at exit would take seconds


@contextmanager
def _umask(settings: Settings) -> Iterator[None]:
    """During the block, create files for this user alone, in this process and its workers.

    Only for the process of a service: the umask applies to all threads.
    """
    if not settings.private:
        yield
        return
    previous = os.umask(_PRIVATE_UMASK)
    try:
        yield
    finally:
        os.umask(previous)


class _Stopped(BaseException):
    """SIGINT or SIGTERM arrived. Like KeyboardInterrupt, no handler of Exception catches it."""

    def __init__(self, number: int) -> None:
        self.number = number


@contextmanager
def _stopped_by_signals() -> Iterator[None]:
    """SIGINT and SIGTERM end the block, also during startup; while serving, uvicorn handles them.

    After SIGINT, raises KeyboardInterrupt.
    """
    previous = {number: signal.signal(number, _stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    except _Stopped as stopped:
        if stopped.number == signal.SIGINT:
            raise KeyboardInterrupt from None
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _stop(number: int, frame: FrameType | None) -> None:
    quiet_libraries()
    raise _Stopped(number)


@contextmanager
def _startup_errors() -> Iterator[None]:
    """Turn errors of data folder, ledger and kernel cache into NotStarted; defects stay as they are."""
    try:
        yield
    except (LedgerUnavailable, CacheRefused) as error:
        raise NotStarted(str(error)) from error
    except OSError as error:
        raise NotStarted(f"{error.filename or 'the data folder'}: {error.strerror or error}") from error


def _summary(settings: Settings) -> str:
    cluster = settings.scheduler or settings.scheduler_file or settings.cluster
    workers = f"cluster {cluster}" if cluster else f"{settings.workers} worker processes"
    token = f", token in {settings.data / tokens.FILE_NAME}" if settings.makes_token else ""
    return f"data in {settings.data}, {workers}{token}"


@contextmanager
def _listening(settings: Settings) -> Iterator[tuple[socket.socket, str]]:
    """A socket bound to the address of the settings, and the mark of the stores.

    Checks port and data folder before the slow startup.
    """
    host, port = settings.host, settings.port
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listener = socket.create_server((host, port), family=family, backlog=BACKLOG)
    except OSError as error:
        reason = error.strerror or str(error)
        if error.errno == errno.EADDRINUSE:
            reason = f"{_who_answers(host, port, settings.data)} has it; take another one with --port"
        raise NotStarted(f"cannot listen on {host} port {port}: {reason}") from error
    # Connections inherit it; without it, delayed acknowledgements slow each response by 40 ms.
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    with listener:
        with _startup_errors():
            if settings.private:
                _make_private(settings.folders)
            with open_ledger(settings) as ledger, ledger.reading() as reading:
                marker, _ = reading.marker()
            if settings.private:  # SQLite gives the files that it adds to a ledger the same permissions
                for file in settings.data.glob(f"{settings.ledger_path.stem}.*"):
                    file.chmod(PRIVATE_FILE)
        yield listener, marker


def _who_answers(host: str, port: int, data: Path) -> str:
    """What listens on a local port: a service, with its release and data folder, or another program."""
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    token = tokens.find_token(port, data) or tokens.find_token(port)
    try:
        with closing(http.client.HTTPConnection(host, port, timeout=_ANSWER_SECONDS)) as connection:
            info = _answer(connection, "/openapi.json", None)["info"]
            if info["title"] != TITLE:
                return "another program"
            folder = _answer(connection, "/v1/software", token).get("data")
            where = f"data in {folder}" if folder else "data in a folder shown to owners of its token"
            return f"a bouncing-spring service (release {info['version']}, {where})"
    except OSError:
        return "a program that does not answer"
    except (http.client.HTTPException, ValueError, LookupError, TypeError, RecursionError):
        return "another program"


def _answer(connection: http.client.HTTPConnection, path: str, token: str | None) -> Any:
    """The JSON answer of a port of this machine. Raises OSError, HTTPException, ValueError."""
    connection.request("GET", path, headers={"Authorization": f"Bearer {token}"} if token else {})
    return json.loads(connection.getresponse().read(_MOST_BYTES))


def _make_private(folders: Iterable[Path]) -> None:
    """Create the data folders, or close them to other users. Raises NotStarted."""
    for folder in folders:
        try:
            make_private(folder)
        except NotOurs as error:
            raise NotStarted(f"{error}; name another folder with BOUNCE_DATA or BOUNCE_STORES") from error


@contextmanager
def _with_own_token(settings: Settings, listener: socket.socket) -> Iterator[Settings]:
    """The settings, with the service's own token if it makes one; clients find it during the block.

    Processes started meanwhile do not inherit a token: workers need none. Raises NotStarted.
    """
    inherited = os.environ.pop(_TOKEN_VARIABLE, None)
    try:
        if not settings.makes_token:
            yield settings
            return
        with _startup_errors():
            token = tokens.own_token(settings.data, port=listener.getsockname()[1])
        try:
            yield settings.model_copy(update={"token": SecretStr(token)})
        finally:
            with suppress(OSError):  # the folder may be gone
                tokens.own_token(settings.data, port=None)
    finally:
        if inherited is not None:
            os.environ[_TOKEN_VARIABLE] = inherited


@contextmanager
def _computing(settings: Settings, marker: str, executor: Executor | None) -> Iterator[Executor]:
    """`executor`, or the cluster of the settings during the block. Raises NotStarted."""
    if executor is not None:
        yield executor
        return
    with ExitStack() as stack:
        with _startup_errors():
            try:
                cluster = stack.enter_context(connected_cluster(settings, marker))
            except ClusterLost as error:
                raise NotStarted(str(error)) from error
        yield cluster


def _warm_answers(background: Processes) -> None:
    """Start the first process for answers before the first request."""
    with suppress(NotComputed):  # the service was stopped meanwhile
        background.run(registry.warm)
