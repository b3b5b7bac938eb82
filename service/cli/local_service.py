"""A service inside the command's own process, for `bounce figure` and `bounce tradeoff`.

It requires a token that only this process knows: other users of the machine reach its port as well.
"""

import os
import secrets
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType
from typing import Final, NamedTuple

import click

from service.cli.options import DEFAULT_URL
from service.local import claim_kernels


class Address(NamedTuple):
    """Where a service answers, and the access token for it."""

    url: str
    token: str | None


#: Signals that end a command, which then removes its temporary folder and ends its worker processes.
_SIGNALS: Final = (signal.SIGTERM, signal.SIGHUP)


@contextmanager
def temporary_service(workers: int | None) -> Iterator[Address]:
    """A service whose data is removed at the end of the block."""
    with (
        ended_by_signals(),
        tempfile.TemporaryDirectory(prefix="bounce-") as folder,
        _local_service(workers=workers, data=folder) as address,
    ):
        yield address


@contextmanager
def persistent_service(workers: int | None, data: str | None, token: str | None) -> Iterator[Address]:
    """A service that keeps its results in the folder `data`, by default ./bounce-data.

    A folder has one service at a time. If another one uses the default folder, as beside `bounce serve`, that
    service is used if it answers at BOUNCE_URL or the default address, and a temporary one otherwise. A
    folder that was named is not replaced: raises DataFolderBusy.
    """
    from service.errors import DataFolderBusy

    with ExitStack() as stack:
        stack.enter_context(ended_by_signals())
        try:
            address = stack.enter_context(_local_service(workers=workers, data=data))
        except DataFolderBusy:
            if data is not None:
                raise
            running = os.environ.get("BOUNCE_URL") or DEFAULT_URL
            if _answers(running, token):
                click.echo(f"another service uses the data folder: using the service at {running}", err=True)
                address = Address(running, token)
            else:
                click.echo("another service uses the data folder: using a temporary one", err=True)
                address = stack.enter_context(temporary_service(workers))
        yield address


@contextmanager
def _local_service(**options: str | int | None) -> Iterator[Address]:
    claim_kernels()
    from service.server import embedded

    token = secrets.token_urlsafe()
    settings = embedded.settings(**options, host="127.0.0.1", port=0, token=token)
    click.echo("starting a local service (compiling for the first time takes a minute)", err=True)
    with embedded.running(settings) as url:
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


def _answers(url: str, token: str | None) -> bool:
    """Whether a service answers at `url` and accepts the token."""
    from service.client import BounceError, Client

    try:
        with Client(url, token, timeout=5.0) as client:
            client.metrics()
    except BounceError:
        return False
    return True
