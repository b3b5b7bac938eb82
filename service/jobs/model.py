"""What a job is, its states, and which may follow which. Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, NamedTuple

from service.errors import IllegalTransition


class JobState(StrEnum):
    """Where a job is in its life."""

    QUEUED = "queued"  # accepted, no chunk of it given to a worker since
    RUNNING = "running"  # chunks of it may be at the workers, also while a cancel is being carried out
    DONE = "done"  # every chunk is written and marked
    FAILED = "failed"  # it cannot go on by itself; the error says why; submitting it again resumes it
    CANCELLED = "cancelled"  # someone stopped it and nothing writes any more; submitting it again resumes it


#: What may follow each state.
LEGAL: Final[Mapping[JobState, frozenset[JobState]]] = {
    # picked up | its plan or store cannot be made | cancelled before it began
    JobState.QUEUED: frozenset({JobState.RUNNING, JobState.FAILED, JobState.CANCELLED}),
    # all chunks done | a chunk failed for good | cancelled and nothing writes any more
    JobState.RUNNING: frozenset({JobState.DONE, JobState.FAILED, JobState.CANCELLED}),
    # what is done stays done, unless stored bytes are lost: then their chunks are computed again
    JobState.DONE: frozenset({JobState.RUNNING}),
    # resumed: what is done is kept
    JobState.FAILED: frozenset({JobState.QUEUED}),
    JobState.CANCELLED: frozenset({JobState.QUEUED}),
}

#: A job in one of these is the supervisor's business.
UNFINISHED: Final = (JobState.QUEUED, JobState.RUNNING)

#: A job in one of these starts again when its sweep is submitted again.
RESUMABLE: Final = (JobState.FAILED, JobState.CANCELLED)


def check_transition(old: JobState, new: JobState) -> None:
    """Raise IllegalTransition unless `new` may follow `old`."""
    if new not in LEGAL[old]:
        raise IllegalTransition(f"a job that is {old} cannot become {new}")


@dataclass(frozen=True)
class Progress:
    """How far a job is; `run_*` count from when it was last picked up, so that a pause is no slowness."""

    chunks_done: int
    chunks_total: int
    cells_done: int
    cells_total: int
    run_seconds: float = 0.0
    run_cells: int = 0

    @property
    def percent(self) -> float:
        """Cells done in percent, rounded down to a tenth: 100 means all."""
        return 1000 * self.cells_done // max(self.cells_total, 1) / 10

    @property
    def eta_seconds(self) -> float | None:
        """Seconds to go at the pace of this run; None while there is no pace to go by."""
        if self.run_cells <= 0 or self.run_seconds <= 0:
            return None
        return (self.cells_total - self.cells_done) * self.run_seconds / self.run_cells


@dataclass(frozen=True)
class NewJob:
    """What is known of a job when it is accepted."""

    id: str
    name: str
    spec: str  # JSON, as `SweepSpec.as_submitted` gives it
    kernel_version: str
    chunk_shape: tuple[int, int, int]  # cells of a chunk along xi, omega, gamma
    chunks_total: int
    cells_total: int


@dataclass(frozen=True)
class JobRecord(NewJob):
    """A job as the ledger has it; times in seconds since 1970."""

    seq: int  # jobs in the order they were accepted
    state: JobState
    cancel_requested: bool
    error: str | None
    created: float
    started: float | None
    finished: float | None
    run_started: float | None  # when it was last picked up
    run_cells: int  # cells done then
    chunks_done: int
    cells_done: int
    choice: (
        str | None
    )  # JSON of a worker.analysis.model_selection.Choice, once an `auto` sweep's model is chosen

    def progress(self, now: float) -> Progress:
        """How far the job is at `now`; a job that is not running has no pace."""
        running = self.state is JobState.RUNNING and self.run_started is not None
        return Progress(
            self.chunks_done,
            self.chunks_total,
            self.cells_done,
            self.cells_total,
            run_seconds=now - (self.run_started or now) if running else 0.0,
            run_cells=self.cells_done - self.run_cells if running else 0,
        )


class Failure(NamedTuple):
    """A chunk that could not be computed, for good or until the job is resumed."""

    chunk: int
    place: str  # which cells, in words
    error: str
    traceback: str | None  # None where a process died instead
    tries: int


class DoneChunk(NamedTuple):
    """A chunk that is written: what the worker reported of it."""

    chunk: int
    cells: int
    seconds: float
    checksum: str
    outcomes: Sequence[int]  # cells of each Outcome
