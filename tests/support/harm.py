"""Harm that a sweep's name asks for, done in worker processes of a test's own cluster.

`hang:3` hangs in chunk 3, and so on; every other chunk is computed as always.
"""

import asyncio
import ctypes
import os
import signal
import time
from pathlib import Path
from typing import Any

from distributed import WorkerPlugin

from worker import watchdog
from worker.plan import Chunk
from worker.spec import SweepSpec
from worker.tasks import ChunkReport, run_chunk

#: Seconds until what the worker said of the chunk before has surely left it: lost with the worker, that one
#: would be taken for the guilty one, and tried again.
REPORTED = 2.0


def hang() -> None:
    """As a kernel that never comes back: deaf to the cancel mark."""
    time.sleep(3600)


def freeze() -> None:
    """The same, with the interpreter's lock held: no thread of the process runs any more."""
    ctypes.PyDLL(None).sleep(3600)


def hog() -> None:
    """Take memory until someone ends it."""
    taken = []
    time.sleep(REPORTED)
    while True:
        taken.append(b"x" * (50 << 20))
        time.sleep(0.1)


def poison() -> None:
    """As a compiled function that writes where it must not."""
    time.sleep(REPORTED)
    os.kill(os.getpid(), signal.SIGSEGV)


def fail() -> None:
    raise ValueError("the spring broke")


HARMS = {harm.__name__: harm for harm in (hang, freeze, hog, poison, fail)}


def run_harmed(spec: SweepSpec, chunk: Chunk, store_url: str) -> ChunkReport:
    harm, _, index = spec.name.partition(":")
    if harm in HARMS and chunk.index == int(index):
        HARMS[harm]()
    return run_chunk(spec, chunk, store_url)


class Stuck(WorkerPlugin):
    """Keeps a worker from ever having started, once a file is there."""

    name = "stuck"

    def __init__(self, file: Path) -> None:
        self._file = file

    async def setup(self, worker: Any) -> None:
        if self._file.exists():
            (self._file.parent / "starting").touch()
            await asyncio.sleep(3600)


class Harm(WorkerPlugin):
    """Puts the harm in the place of the real task, in every process that a nanny ever starts."""

    name = "harm"

    def setup(self, worker: Any) -> None:
        watchdog.run_task = run_harmed
