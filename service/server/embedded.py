"""A whole service in this process: web server, application and cluster.

`bounce serve` runs one until a signal stops it; `bounce figure` and the tests run one during a
block.
"""

import errno
import importlib
import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, Final

import dask
from distributed import Security
from pydantic import SecretStr

from service import tokens
from service.api.app import create_app
from service.background import Processes
from service.errors import LedgerUnavailable, NotStarted
from service.jobs.stores.opening import open_ledger
from service.ledger.ledger import Ledger
from service.server.logging import log_to_stderr, quiet_libraries
from service.server.web_server import BACKLOG, WebServer, raise_file_limit
from service.settings import Settings
from service.views import registry
from worker.executors.base import ClusterLost, Executor
from worker.executors.clusters import SCHEDULER_SETTINGS, CreatedCluster
from worker.executors.dask import Dask
from worker.kernel_cache import CacheRefused
from worker.ownership import PRIVATE_FILE, NotOurs, make_private

log = logging.getLogger(__name__)

#: Seconds for which a computing thread may keep others, which serve requests, from running.
_SWITCH_SECONDS: Final = 0.001

#: Permissions that the files of a private service lack: all of group and others.
_PRIVATE_UMASK: Final = 0o077
_TOKEN_VARIABLE: Final = "BOUNCE_TOKEN"


@contextmanager
def running(settings: Settings, executor: Executor | None = None) -> Iterator[str]:
    """Run a service in a thread of this process during the block; yields its URL.

    Computes with `executor`, which the caller closes, or with the cluster of the settings. The processes of
    an embedded cluster import the main module: a script that calls this needs `if __name__ == "__main__"`.
    Raises NotStarted, for example if another service uses the data folder or the port.
    """
    with (
        _prepared(settings, executor) as (complete, listener, chosen, ledger),
        tokens.recorder(settings.data) as record,
    ):
        with _startup_errors():
            server = WebServer(create_app(complete, chosen, ledger=ledger), settings, listener)
        thread = threading.Thread(target=server.serve_until_stopped, name="bounce-server")
        thread.start()
        try:
            with _startup_errors():
                url = server.url.result()
            if settings.makes_token:
                record(url)
            yield url
        finally:
            server.should_exit = True
            thread.join()


def serve(settings: Settings, announce: Callable[[str], None]) -> None:
    """Run a service until SIGINT or SIGTERM; `announce` gets one line once it listens.

    Raises NotStarted, and SystemExit after SIGINT, once everything has ended.
    """

    def announce_url(url: str) -> None:
        record(url)
        announce(f"bounce listens on {url} ({_summary(settings)})")

    raise_file_limit()
    sys.setswitchinterval(_SWITCH_SECONDS)
    with ExitStack() as stack:
        stack.enter_context(_stopped_by_signals())
        stack.enter_context(log_to_stderr(settings.log_level))
        if settings.private:  # of this process and its workers, which is why `running` does not
            stack.callback(os.umask, os.umask(_PRIVATE_UMASK))
        complete, listener, executor, ledger = stack.enter_context(_prepared(settings, None))
        background = stack.enter_context(
            closing(Processes(settings.max_reads + settings.max_exports, registry.warm_pictures))
        )
        record = stack.enter_context(tokens.recorder(settings.data))
        threading.Thread(target=_warm_answers, args=[background], name="warm-answers", daemon=True).start()
        with _startup_errors():
            app = create_app(complete, executor, background, ledger)
            server = WebServer(app, settings, listener, announce_url, quiet_libraries)
        server.serve_until_stopped()
        with _startup_errors():
            server.url.result()


class _Stopped(BaseException):
    """SIGINT or SIGTERM arrived. Like KeyboardInterrupt, no handler of Exception catches it."""

    def __init__(self, number: int) -> None:
        self.number = number


@contextmanager
def _stopped_by_signals() -> Iterator[None]:
    """SIGINT and SIGTERM end the block, also during startup; uvicorn handles them while it serves.

    After SIGINT, raises SystemExit with the code that shells give.
    """
    previous = {number: signal.signal(number, _stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    except _Stopped as stopped:
        if stopped.number == signal.SIGINT:
            sys.exit(128 + signal.SIGINT)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _stop(number: int, frame: FrameType | None) -> None:
    for further in (signal.SIGINT, signal.SIGTERM):  # another one would interrupt the cleanup
        signal.signal(further, signal.SIG_IGN)
    quiet_libraries()
    raise _Stopped(number)


@contextmanager
def _startup_errors() -> Iterator[None]:
    """Turn errors of data folder, ledger, kernel cache and cluster into NotStarted, but not defects."""
    try:
        yield
    except (LedgerUnavailable, CacheRefused, ClusterLost) as error:
        raise NotStarted(str(error)) from error
    except NotOurs as error:
        raise NotStarted(f"{error}; name another folder with BOUNCE_DATA or BOUNCE_STORES") from error
    except OSError as error:
        raise NotStarted(f"{error.filename or 'the data folder'}: {error.strerror or error}") from error


def _summary(settings: Settings) -> str:
    cluster = settings.scheduler or settings.scheduler_file or settings.cluster
    workers = f"cluster {cluster}" if cluster else f"{settings.workers} worker processes"
    token = f", token in {settings.data / tokens.FILE_NAME}" if settings.makes_token else ""
    return f"data in {settings.data}, {workers}{token}"


@contextmanager
def _prepared(
    settings: Settings, executor: Executor | None
) -> Iterator[tuple[Settings, socket.socket, Executor, Ledger]]:
    """The settings with the service's own token, a bound socket, `executor` or the settings' cluster, ledger.

    Checks port and data folder before the slow startup. Raises NotStarted.
    """
    with ExitStack() as stack:
        listener = stack.enter_context(_bound(settings))
        # Processes started meanwhile do not inherit a token: workers need none.
        if (inherited := os.environ.pop(_TOKEN_VARIABLE, None)) is not None:
            stack.callback(os.environ.__setitem__, _TOKEN_VARIABLE, inherited)
        with _startup_errors():
            ledger = stack.enter_context(_opened(settings))
            if settings.makes_token:
                token = tokens.own_token(settings.data)
                settings = settings.model_copy(update={"token": SecretStr(token)})
            if executor is None:
                at = settings.scheduler or settings.scheduler_file
                log.info("%s", f"connecting to the scheduler {at}" if at else "starting workers")
                with ledger.reading() as reading:
                    marker, _ = reading.marker()
                executor = stack.enter_context(closing(connected_cluster(settings, marker)))
        yield settings, listener, executor, ledger


def _bound(settings: Settings) -> socket.socket:
    host, port = settings.host, settings.port
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listener = socket.create_server((host, port), family=family, backlog=BACKLOG)
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (while ")[0]  # the address is named below
        if error.errno == errno.EADDRINUSE:
            reason = "another program has it; take another one with --port"
        raise NotStarted(f"cannot listen on {host} port {port}: {reason}") from error
    # Connections inherit it; without it, delayed acknowledgements slow each response by 40 ms.
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listener


def _opened(settings: Settings) -> Ledger:
    """The ledger; creates the data folders, and closes them to other users. Raises NotOurs."""
    for folder in settings.folders if settings.private else ():
        make_private(folder)
    with ExitStack() as stack:
        ledger = stack.enter_context(open_ledger(settings))
        if settings.private:  # SQLite gives the files that it adds to a ledger the same permissions
            for file in settings.data.glob(f"{settings.ledger_path.stem}.*"):
                file.chmod(PRIVATE_FILE)
        stack.pop_all()
    return ledger


def connected_cluster(settings: Settings, marker: str) -> Dask:
    """A connection to the cluster of the settings, which closes one created for it. Raises ClusterLost.

    marker: the mark of the stores, by which workers prove their access.
    """
    name, tls = settings.cluster, None
    if settings.scheduler_ca is not None:
        tls = Security(  # type: ignore[no-untyped-call]
            require_encryption=True,
            tls_ca_file=str(settings.scheduler_ca),
            tls_client_cert=str(settings.scheduler_cert),
            tls_client_key=str(settings.scheduler_key),
        )
    return Dask(
        settings.scheduler if name is None else CreatedCluster(partial(_create, name), name),
        scheduler_file=settings.scheduler_file,
        security=tls,
        workers=settings.workers,
        memory=settings.worker_memory,
        stores=(settings.stores_url, marker),
    )


def _create(name: str) -> Any:
    """The cluster returned by the function `module:function`. Raises its errors."""
    module, _, function = name.partition(":")
    # for a scheduler in this process; a remote one must be started with these settings
    dask.config.set(SCHEDULER_SETTINGS)
    # the current folder comes last, and for this import only: anyone who can write to it could name a file
    # like a library that is imported later
    folder = str(Path.cwd())
    sys.path.append(folder)
    try:
        imported = importlib.import_module(module)
    finally:
        sys.path.remove(folder)
    return getattr(imported, function)()


def _warm_answers(background: Processes) -> None:
    """Import the modules for answers, and start their first process, before the first request."""
    registry.warm()
    background.start()
