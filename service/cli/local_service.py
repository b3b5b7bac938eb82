"""A service inside the command's own process, for `bounce figure` and `bounce tradeoff`."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

import click


def claim_kernel_cache() -> None:
    """Choose this process's cache of compiled kernels; must run before anything that declares kernels."""
    from worker.kernel_cache import claim_cache

    claim_cache()


@contextmanager
def temporary_service(workers: int | None) -> Iterator[str]:
    """The address of a service whose data is removed at the end of the block."""
    with (
        tempfile.TemporaryDirectory(prefix="bounce-") as folder,
        _local_service(workers=workers, data=folder) as url,
    ):
        yield url


@contextmanager
def persistent_service(workers: int | None, data: str | None) -> Iterator[str]:
    """The address of a service that keeps its results in the folder `data`, by default ./bounce-data."""
    with _local_service(workers=workers, data=data) as url:
        yield url


@contextmanager
def _local_service(**options: str | int | None) -> Iterator[str]:
    claim_kernel_cache()
    from service.server import embedded

    settings = embedded.settings(**options, host="127.0.0.1", port=0)
    click.echo("starting a local service (compiling for the first time takes a minute)", err=True)
    with embedded.running(settings) as url:
        yield url
