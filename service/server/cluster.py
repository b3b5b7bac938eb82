"""The Dask cluster of the settings: embedded, an existing one, or created by a user's function."""

import importlib
import sys
from functools import partial
from pathlib import Path
from typing import Any

import dask
from distributed import Security

from service.settings import Settings
from worker.executors.clusters import SCHEDULER_SETTINGS, CreatedCluster
from worker.executors.dask import Dask


def connect(settings: Settings, marker: str) -> Dask:
    """A connection to the cluster; its `close` closes a cluster created for it. Raises ClusterLost.

    marker: the mark of the stores, by which workers prove their access.
    """
    name = settings.cluster
    return Dask(
        settings.scheduler if name is None else CreatedCluster(partial(_create, name), name),
        scheduler_file=settings.scheduler_file,
        security=_tls(settings),
        workers=settings.workers,
        memory=settings.worker_memory,
        stores=(settings.stores_url, marker),
    )


def _create(name: str) -> Any:
    """The cluster returned by the function `module:function`. Raises its errors."""
    module, _, function = name.partition(":")
    # For a scheduler in this process; a remote one must be started with these settings.
    dask.config.set(SCHEDULER_SETTINGS)
    # The current folder comes last: anyone who can write to it could name a file like a library.
    folder = str(Path.cwd())
    sys.path.append(folder)
    try:
        imported = importlib.import_module(module)
    finally:
        sys.path.remove(folder)
    return getattr(imported, function)()


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
