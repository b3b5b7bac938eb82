"""How a task computes a chunk, and what it reports: options, errors, report."""

import math
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.params import Outcome
from worker.study.layout import COMPUTED

#: Core-seconds that a task computes before it pauses: the longest wait of another job's chunk for a worker
#: with its own core. Twice the target of a chunk, so that few chunks harder than estimated pause. Measured in
#: core time: on a busy machine, pauses would otherwise use up the worker's share.
SLICE_SECONDS: Final = 1.5


@dataclass(frozen=True)
class ChunkOptions:
    """How a chunk is computed; changes no result."""

    slice_seconds: float = math.inf  # core-seconds after which it pauses
    begins: bool = False  # the chunk's first task: no checkpoint to look for


USUAL: Final = ChunkOptions()

#: For the chunk that this thread computes.
OPTIONS: Final[ContextVar[ChunkOptions]] = ContextVar("options", default=USUAL)

#: Set in a worker process that was told to leave: its chunks pause at once, so that nothing is lost.
LEAVING: Final = threading.Event()


@contextmanager
def with_options(options: ChunkOptions) -> Iterator[None]:
    """Options for the tasks of this thread within the block."""
    token = OPTIONS.set(options)
    try:
        yield
    finally:
        OPTIONS.reset(token)


class TaskError(Exception):
    """Why a chunk was not computed."""


class ChunkCancelled(TaskError):
    """The cancel flag of the store is set; nothing of the chunk was written."""


class ChunkPaused(TaskError):
    """The chunk's time slice is over; the next task continues from its checkpoint."""


class PredecessorMissing(TaskError):
    """The chunk before this one on its ramp is not in the store."""


@dataclass(frozen=True, slots=True)
class ChunkReport:
    """What a task reports of its chunk."""

    index: int
    cells: int
    seconds: float  # wall time, storing included
    kernel_seconds: float  # the part spent in the kernel
    checksum: str  # of the stored bytes; see store.find_corrupt
    outcomes: tuple[int, ...]  # number of cells by kernel.params.Outcome
    computed: int | None = None  # of a study with COMPUTED: cells not filled in
    bytes: int | None = None  # stored, of all arrays; None if unknown


def report_of(
    chunk: Any, record: Mapping[str, NDArray[Any]], stored: tuple[str, int], seconds: tuple[float, float]
) -> ChunkReport:
    """The report of a stored chunk. `stored`: checksum and bytes; `seconds`: in all, and in the kernel."""
    outcomes = tuple(np.bincount(record["outcome"].ravel(), minlength=len(Outcome)).tolist())
    computed = int(record[COMPUTED].sum()) if COMPUTED in record else None
    checksum, size = stored
    return ChunkReport(chunk.index, chunk.cells, *seconds, checksum, outcomes, computed, size)
