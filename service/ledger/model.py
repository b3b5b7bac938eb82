"""A job, its states, the transitions between them, and its progress. Pure."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final, NamedTuple

from kernel.params import KERNEL_VERSION
from service.errors import IllegalTransition


class JobState(StrEnum):
    """The state of a job."""

    QUEUED = "queued"  # accepted or resumed, without chunks at workers since
    RUNNING = "running"  # workers may be computing its chunks, also during a cancel
    DONE = "done"  # every chunk is stored and marked
    FAILED = "failed"  # a chunk was given up; `error` has the reason; submitting it again resumes it
    CANCELLED = "cancelled"  # stopped by a user, and no worker writes; submitting it again resumes it


#: The states that may follow each state.
LEGAL: Final[Mapping[JobState, frozenset[JobState]]] = {
    # started | its plan or store cannot be made | cancelled before it started
    JobState.QUEUED: frozenset({JobState.RUNNING, JobState.FAILED, JobState.CANCELLED}),
    # all chunks done | a chunk given up | cancelled, and no worker writes
    JobState.RUNNING: frozenset({JobState.DONE, JobState.FAILED, JobState.CANCELLED}),
    # stored bytes were damaged or lost: chunks are computed again | outdated job: they cannot be
    JobState.DONE: frozenset({JobState.RUNNING, JobState.FAILED}),
    # resumed: done chunks are kept
    JobState.FAILED: frozenset({JobState.QUEUED}),
    JobState.CANCELLED: frozenset({JobState.QUEUED}),
}

#: States of the jobs that the supervisor works on.
UNFINISHED: Final = (JobState.QUEUED, JobState.RUNNING)

#: States in which a job resumes when its study is submitted again.
RESUMABLE: Final = (JobState.FAILED, JobState.CANCELLED)


def check_transition(old: JobState, new: JobState) -> None:
    """Raise IllegalTransition unless `new` may follow `old`."""
    if new not in LEGAL[old]:
        raise IllegalTransition(f"a job that is {old} cannot become {new}")


@dataclass(frozen=True)
class NewJob:
    """A job to accept."""

    id: str
    name: str
    spec: str  # JSON, as `SweepSpec.as_submitted` gives it
    kernel_version: str
    chunk_shape: tuple[int, ...]  # cells of a chunk along each dimension; for a sweep xi, omega, gamma
    chunks_total: int
    cells_total: int
    #: Of an adaptive map: cells of the first rounds of all chunks; 0 for other studies.
    first_cells: int = field(default=0, kw_only=True)
    #: Name of the access token that submitted or last resumed it; None if that has no name.
    owner: str | None = field(default=None, kw_only=True)


@dataclass(frozen=True)
class JobRecord(NewJob):
    """A job in the ledger; times in seconds since 1970."""

    seq: int  # numbers jobs in the order they were accepted; never used twice
    store: str  # name of its store beside the others
    state: JobState
    cancel_requested: bool
    error: str | None
    created: float
    started: float | None
    finished: float | None  # during a repair: when the job was done before
    chunks_done: int
    cells_done: int
    cells_settling: int  # done cells whose outcome is `settling`
    cells_computed: int  # of an adaptive map: done cells that were not filled in
    choice: str | None  # of an `auto` sweep: JSON of worker.analysis.model_selection.ModelChoice, once chosen
    replaced_by: str | None  # of an outdated job: id of the job that computes the same study anew
    pinned: bool = False  # marked by a user
    core_seconds: float = 0.0  # of all chunks and repetitions, except adopted chunks
    runs: str = "[]"  # JSON: the software that computed it, see service.software.with_this_run
    progressed: float | None = None  # when this run began, or its last chunks were done
    seconds_left: float | None = None  # estimated at `progressed`

    @property
    def named_spec(self) -> dict[str, Any]:
        """The specification with the name that the job has now; its store keeps the first one."""
        return {**json.loads(self.spec), "name": self.name}

    @property
    def outdated(self) -> bool:
        """Whether another kernel version computed it.

        Its results can be read. This release adds nothing to them, because its numbers may differ.
        """
        return self.kernel_version != KERNEL_VERSION

    @property
    def notice(self) -> str | None:
        """A notice for readers of an outdated job's results; None for other jobs."""
        if not self.outdated:
            return None
        again = "" if self.replaced_by is None else f", as job {self.replaced_by}"
        return (
            f"computed by kernel version {self.kernel_version}; "
            f"this release computes version {KERNEL_VERSION}{again}"
        )

    @property
    def repairing(self) -> bool:
        """Whether a job that was done computes damaged chunks again."""
        return self.state is JobState.RUNNING and self.finished is not None

    def revision(self, now: float) -> tuple[object, ...]:
        """A value that changes with the job's description, and with the time left in steps of 9 %."""
        facts = (self.state, self.error, self.choice, self.chunks_done, self.started, self.finished)
        left = self.eta_seconds(now)
        step = None if left is None else round(8.0 * math.log2(1.0 + left))
        return (self.id, *facts, self.notice, self.owner, self.pinned, self.name, step)

    def eta_seconds(self, now: float) -> float | None:
        """Estimated seconds left; None without an estimate.

        Between chunks it falls at most to half, so that a slow chunk at most doubles it.
        """
        left = self.seconds_left
        if self.state is not JobState.RUNNING or self.progressed is None or left is None:
            return None
        return max(left - max(now - self.progressed, 0.0), left / 2.0)

    def progress(self, now: float, *, compiling: bool = False) -> dict[str, float | None]:
        """The job's progress at `now`, in seconds since 1970; no estimate has a first kernel's compiling."""
        to_come = self.chunks_total - self.chunks_done
        needed = self.cells_computed + -(-self.first_cells * to_come // max(self.chunks_total, 1))
        names = ("chunks_done", "chunks_total", "cells_done", "cells_total", "cells_settling")
        return {name: getattr(self, name) for name in names} | {
            # of adaptive maps: cells computed, and cells known to be needed, with the first rounds of the
            # remaining chunks
            "cells_computed": self.cells_computed if self.first_cells else None,
            "cells_needed": needed if self.first_cells else None,
            "percent": 1000 * self.cells_done // max(self.cells_total, 1) / 10,  # 100 means all
            "eta_seconds": None if compiling and not self.cells_done else self.eta_seconds(now),
        }


class Failure(NamedTuple):
    """A chunk that was given up. Resuming the job tries it again."""

    chunk: int
    place: str  # the chunk's number and cells, as `PreparedJob.describe` gives them
    error: str
    traceback: str | None  # None if a worker process died
    tries: int  # failed tries


def summary_of(failures: Sequence[Failure]) -> str | None:
    """The first failure and the number of further ones; None if there are none."""
    if not failures:
        return None
    first, more = failures[0], len(failures) - 1
    tries = f" ({first.tries} times)" if first.tries > 1 else ""
    others = f" (and {more} more chunk{'s' if more > 1 else ''} failed)" if more else ""
    return f"{first.place}: {first.error}{tries}{others}"
