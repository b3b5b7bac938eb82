"""A service inside the command's own process, for `bounce figure` and `bounce tradeoff`."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import click

from service.cli.options import DEFAULT_URL


def claim_kernel_cache() -> None:
    """Choose this process's cache of compiled kernels; must run before anything that declares kernels.

    Raises NotStarted if other users could have written it.
    """
    from service.errors import NotStarted
    from worker.kernel_cache import CacheRefused, claim_cache

    try:
        claim_cache()
    except CacheRefused as error:
        raise NotStarted(str(error)) from error


@contextmanager
def temporary_service(workers: int | None) -> Iterator[str]:
    """The address of a service whose data is removed at the end of the block."""
    with (
        tempfile.TemporaryDirectory(prefix="bounce-") as folder,
        _local_service(workers=workers, data=folder) as url,
    ):
        yield url


@contextmanager
def persistent_service(workers: int | None, data: str | None, token: str | None) -> Iterator[str]:
    """The address of a service that keeps its results in the folder `data`, by default ./bounce-data.

    A folder has one service at a time. If another one uses the default folder, as beside `bounce serve`, that
    service is used if it answers at BOUNCE_URL or the default address, and a temporary one otherwise. A
    folder that was named is not replaced: raises DataFolderBusy.
    """
    from service.errors import DataFolderBusy

    with ExitStack() as stack:
        try:
            url = stack.enter_context(_local_service(workers=workers, data=data))
        except DataFolderBusy:
            if data is not None:
                raise
            running = os.environ.get("BOUNCE_URL") or DEFAULT_URL
            if _answers(running, token):
                click.echo(f"another service uses the data folder: using the service at {running}", err=True)
                url = running
            else:
                click.echo("another service uses the data folder: using a temporary one", err=True)
                url = stack.enter_context(temporary_service(workers))
        yield url


@contextmanager
def _local_service(**options: str | int | None) -> Iterator[str]:
    claim_kernel_cache()
    from service.server import embedded

    settings = embedded.settings(**options, host="127.0.0.1", port=0)
    click.echo("starting a local service (compiling for the first time takes a minute)", err=True)
    with embedded.running(settings) as url:
        yield url


def _answers(url: str, token: str | None) -> bool:
    """Whether a service answers at `url` and accepts the token."""
    from service.client import BounceError, Client

    try:
        with Client(url, token, timeout=5.0) as client:
            client.metrics()
    except BounceError:
        return False
    return True
