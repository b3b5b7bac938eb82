"""A service inside the command's own process, for `bounce figure`.

It requires a token that only this process knows: other users of the machine reach its port as well.
"""

import secrets
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType
from typing import Final, NamedTuple
from urllib.parse import urlsplit

import click

from service import address
from service.client.display import display_elapsed
from service.local import claim_kernels
from service.tokens import AUTO, data_folder, find_token
from worker.ownership import temporary_folder


class Address(NamedTuple):
    """Where a service answers, and the access token for it."""

    url: str
    token: str | None


_STARTING: Final = "starting a local service"

#: Signals that end a command, which then removes its temporary folder and ends its worker processes.
_SIGNALS: Final = (signal.SIGTERM, signal.SIGHUP)


@contextmanager
def temporary_service(workers: int | None) -> Iterator[Address]:
    """A service whose data is removed at the end of the block."""
    with (
        ended_by_signals(),
        temporary_folder("bounce-") as folder,
        _local_service(workers=workers, data=str(folder)) as address,
    ):
        yield address


@contextmanager
def persistent_service(workers: int | None, data: str | None, token: str | None) -> Iterator[Address]:
    """A service that keeps its results in the folder `data`, by default BOUNCE_DATA or ./bounce-data.

    A folder has one service at a time. If `bounce serve` runs on it, that service is used. If another command
    uses the default folder, a temporary service is started. A folder that was named is not replaced: raises
    DataFolderBusy.
    """
    from service.errors import DataFolderBusy

    folder = Path(data) if data else data_folder()
    with ExitStack() as stack:
        stack.enter_context(ended_by_signals())
        if running := _running_on(folder, token):
            click.echo(f"using the service at {running.url}, which runs on {folder}", err=True)
            yield running
            return
        try:
            service = stack.enter_context(_local_service(workers=workers, data=data))
        except DataFolderBusy:
            if data is not None:
                raise
            click.echo("another service uses the data folder: using a temporary one", err=True)
            service = stack.enter_context(temporary_service(workers))
        yield service


def _running_on(folder: Path, token: str | None) -> Address | None:
    """The service that runs on a data folder, if it accepts `token`, or else the one that it has made."""
    url = address.find(folder)
    if url is None:
        return None
    if token in (None, "", AUTO):
        token = find_token(urlsplit(url).port or 80, folder)
    service = Address(url, token)
    return service if _answers(service) else None


@contextmanager
def _local_service(**options: str | int | None) -> Iterator[Address]:
    claim_kernels()
    from service.server import embedded

    token = secrets.token_urlsafe()
    settings = embedded.settings(**options, host="127.0.0.1", port=0, token=token)
    with ExitStack() as stack:
        with display_elapsed(_STARTING):
            url = stack.enter_context(embedded.running(settings))
        yield Address(url, token)


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """The signals end the block by SystemExit; only the main thread can handle signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:  # as `nohup` leaves SIGHUP
            signal.signal(number, _end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _end(number: int, frame: FrameType | None) -> None:
    for other in _SIGNALS:  # a second one does not interrupt the clean-up
        signal.signal(other, signal.SIG_IGN)
    sys.exit(128 + number)


def _answers(service: Address) -> bool:
    """Whether it answers, and accepts the token."""
    from service.client import BounceError, Client

    try:
        with Client(*service, timeout=5.0) as client:
            client.metrics()
    except BounceError:
        return False
    return True
