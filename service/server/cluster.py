"""The cluster the settings ask for: of this machine, one that is there, or one that a function makes."""

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import dask
from distributed import Security

from service.settings import Settings
from worker.executors.connection import SCHEDULER_SETTINGS
from worker.executors.dask import Dask
from worker.executors.errors import ClusterLost


@contextmanager
def computing(settings: Settings) -> Iterator[Dask]:
    """A connection to that cluster; what was made for it is closed with it. Raises ClusterLost."""
    with _made(settings.cluster) as made:
        cluster = Dask(
            settings.scheduler if made is None else made,
            scheduler_file=settings.scheduler_file,
            security=_tls(settings),
            workers=settings.workers,
            memory=settings.worker_memory,
        )
        try:
            yield cluster
        finally:
            cluster.close()


@contextmanager
def _made(name: str | None) -> Iterator[Any]:
    """What the function named `module:function` gives; None without a name. Its errors are ClusterLost."""
    if name is None:
        yield None
        return
    module, _, function = name.partition(":")
    if "" not in sys.path:
        sys.path.insert(0, "")  # as `python -m` would: the module may lie in the current folder
    try:
        # For a scheduler in this process; another's has to be started so.
        dask.config.set(SCHEDULER_SETTINGS)
        cluster = getattr(importlib.import_module(module), function)()
    except Exception as error:
        raise ClusterLost(f"no cluster from {name}: {type(error).__name__}: {error}") from error
    try:
        yield cluster
    finally:
        if hasattr(cluster, "close"):
            cluster.close()


def _tls(settings: Settings) -> Any:
    """What distributed needs to speak TLS with the scheduler, if the settings ask for it."""
    if settings.scheduler_ca is None:
        return None
    return Security(  # type: ignore[no-untyped-call]
        require_encryption=True,
        tls_ca_file=str(settings.scheduler_ca),
        tls_client_cert=str(settings.scheduler_cert),
        tls_client_key=str(settings.scheduler_key),
    )
