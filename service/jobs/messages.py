"""What the supervisor's inbox gets, from whichever thread knows it."""

from collections.abc import Sequence
from concurrent.futures import CancelledError, Future
from typing import NamedTuple

from service.jobs.model import DoneChunk
from worker.tasks import ChunkReport


class ChunkFinished(NamedTuple):
    """A chunk's future has come to its end."""

    job_id: str
    chunk: int
    future: "Future[ChunkReport]"


class ChunksInvalidated(NamedTuple):
    """Chunks are no longer marked: their stored bytes are not what they were."""

    job_id: str
    chunks: Sequence[int]


Message = ChunkFinished | ChunksInvalidated | None  # None: look at the ledger


def error_of(future: "Future[ChunkReport]") -> BaseException | None:
    """Why a future that has come to its end has no report."""
    return CancelledError() if future.cancelled() else future.exception()


def done_of(future: "Future[ChunkReport]") -> DoneChunk:
    """What the ledger keeps of a report."""
    report = future.result()
    return DoneChunk(report.index, report.cells, report.seconds, report.checksum, report.outcomes)
