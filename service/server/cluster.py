"""The Dask cluster of the settings: embedded, an existing one, or created by a user's function."""

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import dask
from distributed import Security

from service.settings import Settings
from worker.executors.clusters import SCHEDULER_SETTINGS, CreatedCluster
from worker.executors.dask import Dask


@contextmanager
def connected_cluster(settings: Settings, marker: str) -> Iterator[Dask]:
    """A connection to the cluster during the block; closes a cluster created for it. Raises ClusterLost.

    marker: the mark of the stores, by which workers prove their access.
    """
    name = settings.cluster
    cluster = Dask(
        settings.scheduler if name is None else CreatedCluster(partial(_create, name), name),
        scheduler_file=settings.scheduler_file,
        security=_tls(settings),
        workers=settings.workers,
        memory=settings.worker_memory,
        stores=(settings.stores_url, marker),
    )
    try:
        yield cluster
    finally:
        cluster.close()


def _create(name: str) -> Any:
    """The cluster returned by the function `module:function`. Raises its errors."""
    module, _, function = name.partition(":")
    # For a scheduler in this process; a remote one must be started with these settings.
    dask.config.set(SCHEDULER_SETTINGS)
    with _current_folder_last():
        imported = importlib.import_module(module)
    return getattr(imported, function)()


@contextmanager
def _current_folder_last() -> Iterator[None]:
    """Look for modules in the current folder too, after all other places, during the block.

    Anyone who can write to that folder could otherwise name a file like a library that is imported later.
    """
    folder = str(Path.cwd())
    sys.path.append(folder)
    try:
        yield
    finally:
        sys.path.remove(folder)


def _tls(settings: Settings) -> Any:
    """The TLS settings of the connection to the scheduler; None for a plain connection."""
    if settings.scheduler_ca is None:
        return None
    return Security(  # type: ignore[no-untyped-call]
        require_encryption=True,
        tls_ca_file=str(settings.scheduler_ca),
        tls_client_cert=str(settings.scheduler_cert),
        tls_client_key=str(settings.scheduler_key),
    )
