"""Faults in the worker processes of a test's own cluster, as the name of a sweep says.

`hang:3` hangs in chunk 3, and so on; all other chunks are computed as usual.
"""

import asyncio
import ctypes
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import dask
from distributed import Worker, WorkerPlugin
from scripted import wait_for

from worker import watchdog
from worker.executors.dask import Dask
from worker.kernel_cache import use_cache
from worker.store import backend
from worker.study import Chunk, ChunkReport
from worker.study.chunks import USUAL, with_options
from worker.sweep import SweepSpec
from worker.sweep.task import run_chunk

#: Seconds until the report of the chunk before has left the worker. If it were lost with the worker, that
#: chunk would count as the cause and be computed again.
REPORTED = 2.0


def leave(dask_worker: Worker) -> None:
    """Close this worker and its nanny, as a worker does that its scheduler has forgotten."""
    dask_worker.loop.call_later(0.2, dask_worker.close)  # after the caller has its answer


def hang() -> None:
    """Like a kernel that does not return and ignores the cancel flag."""
    time.sleep(3600)


def freeze() -> None:
    """The same, holding the interpreter's lock: no thread of the process runs any more."""
    ctypes.PyDLL(None).sleep(3600)


def hog() -> None:
    """Allocate memory until the process is ended."""
    blocks = []
    time.sleep(REPORTED)
    while True:
        blocks.append(b"x" * (50 << 20))
        time.sleep(0.1)


def poison() -> None:
    """Like compiled code that writes to memory it does not own."""
    time.sleep(REPORTED)
    os.kill(os.getpid(), signal.SIGSEGV)


def fail() -> None:
    raise ValueError("the spring broke")


def die_writing() -> None:
    """The first time that a store's file is complete but not in its place, kill this process."""
    place = backend.place

    def die_once(url: str, partial: Path, key: str) -> None:
        written = died_writing(url)
        if not written.exists():
            written.write_bytes(partial.read_bytes())
            os.kill(os.getpid(), signal.SIGKILL)
        place(url, partial, key)

    backend.place = die_once


def died_writing(url: str) -> Path:
    """Beside a store, a copy of the file that a worker wrote as it died."""
    return Path(url).with_suffix(".died")


HARMS = {harm.__name__: harm for harm in (hang, freeze, hog, poison, fail, die_writing)}


def run_harmed(spec: SweepSpec, chunk: Chunk, store_url: str) -> ChunkReport:
    harm, _, index = spec.name.partition(":")
    if harm in HARMS and chunk.index == int(index):
        HARMS[harm]()
    with with_options(USUAL):  # in one piece
        return run_chunk(spec, chunk, store_url)


class Stuck(WorkerPlugin):
    """Once a file exists, keeps workers from completing their start."""

    name = "stuck"

    def __init__(self, file: Path) -> None:
        self._file = file

    async def setup(self, worker: Any) -> None:
        if self._file.exists():
            (self._file.parent / "starting").touch()
            await asyncio.sleep(3600)


class Harm(WorkerPlugin):
    """Replaces the real task in every process that a nanny starts."""

    name = "harm"

    def setup(self, worker: Any) -> None:
        watchdog.run_task = run_harmed


#: Memory limit of a worker of `fragile_cluster`, bytes.
MEMORY = 600 << 20


@contextmanager
def fragile_cluster() -> Iterator[Dask]:
    """An executor on two workers that fail as a sweep's name says."""
    use_cache()
    with dask.config.set({"distributed.worker.memory.terminate": False}):  # the watchdog is under test
        executor = Dask(workers=2, memory=MEMORY)
    executor._connection.client.register_plugin(Harm())
    try:
        yield executor
    finally:
        executor.close()


def pids(executor: Dask, workers: int = 2) -> list[int]:
    """The processes of all workers, once this many answer: a killed one counts until it is noticed."""
    processes: list[int] = []

    def answered() -> bool:
        try:
            processes[:] = executor._connection.client.run(os.getpid).values()
        except (OSError, TimeoutError):  # a connection to a worker that has died
            return False
        return len(processes) == workers

    wait_for(answered)
    return processes


def wait_until_ready(executor: Dask) -> None:
    """Wait until both workers are ready."""
    wait_for(lambda: executor.state().workers == 2)
