"""Decides which job submits the next chunk. Pure: takes jobs and free places, and returns a job."""

import heapq
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, NamedTuple, TypeAlias

if TYPE_CHECKING:
    from service.jobs.run import JobRun

#: The share of the workers' time for all jobs in turn; the rest goes to the job with the least left.
ROTATION_SHARE: Final = 0.25
#: Maximum chunks in flight, however small, of one job and those with less left to compute.
MAX_IN_FLIGHT: Final = 64
#: Limit on chunks in flight over all jobs, in multiples of one job's window.
MAX_TIMES_IN_FLIGHT: Final = 4


@dataclass(frozen=True)
class Waiting:
    """A job that is not in memory, with the fields of a `JobRun` that decide when it gets a place."""

    id: str
    seq: int  # numbers jobs in the order they were accepted
    chunk_seconds: float  # core-seconds of a chunk
    remaining_seconds: float  # core-seconds of the remaining chunks
    in_flight: ClassVar[Collection[int]] = ()
    turns: ClassVar[Collection[int]] = ()
    may_submit: ClassVar[bool] = True
    is_idle: ClassVar[bool] = False

    @property
    def expected_seconds(self) -> float:
        """Core-seconds of the remaining chunks, as a `JobRun` has."""
        return self.remaining_seconds


Job: TypeAlias = "JobRun | Waiting"


class Next(NamedTuple):
    """The job that submits the next chunk."""

    job: Job
    is_turn: bool
    leaving: "Job | None" = None  # an idle job that leaves memory first


def by_remaining_work(job: Job) -> tuple[float, int]:
    """Sort key of jobs: the least left to compute first, then the first accepted."""
    return job.remaining_seconds, job.seq


class Rotation:
    """The unfinished jobs in the order of their turns, and when the next turn is due.

    Owners take turns, and so do each owner's jobs. A turn is one chunk, or one time slice of a long chunk.
    `ROTATION_SHARE` of the workers' time goes to turns, so that every job advances, whatever the number of
    smaller jobs after it.

    slice_seconds: limit on the cost of a turn.
    """

    def __init__(self, slice_seconds: float) -> None:
        self.slice_seconds = slice_seconds
        self._jobs: dict[str | None, dict[str, None]] = {}  # ids by owner, both in the order of their turns
        self._owners: dict[str, str | None] = {}  # by job
        self._credit = 0.0  # core-seconds that turns may take now

    def update(self, owners: Mapping[str, str | None]) -> None:
        """Forget ended jobs and add new ones at the end. owners: by job, in order of acceptance."""
        for job_id in self._owners.keys() - owners.keys():
            self._remove(job_id)
        for job_id, owner in owners.items():
            if job_id not in self._owners:
                self._append(job_id, owner)

    def __len__(self) -> int:
        return len(self._owners)

    def __iter__(self) -> Iterator[str]:
        """Job ids, the next turn first."""
        for jobs in self._jobs.values():
            yield from jobs

    def is_due(self, seconds: float) -> bool:
        """Whether the workers have time for a turn of about `seconds` core-seconds."""
        return self._credit >= min(seconds, self.slice_seconds)

    def begin_turn(self, job_id: str, seconds: float) -> None:
        """Give a job a turn of about `seconds` core-seconds; its next turn comes after all other jobs."""
        self._credit -= min(seconds, self.slice_seconds)
        owner = self._owners[job_id]
        self._remove(job_id)
        self._append(job_id, owner)
        self._jobs[owner] = self._jobs.pop(owner)

    def count(self, seconds: float, turn: float | None) -> None:
        """Count the core-seconds of a chunk or slice that came back; turn: its estimate, if it was a turn.

        Others earn credit, limited to one turn: missed turns are lost.
        """
        if turn is not None:
            self._credit += min(turn, self.slice_seconds) - seconds
            return
        earned = seconds * ROTATION_SHARE / (1.0 - ROTATION_SHARE)
        self._credit = min(self._credit + earned, self.slice_seconds)

    def _append(self, job_id: str, owner: str | None) -> None:
        self._owners[job_id] = owner
        self._jobs.setdefault(owner, {})[job_id] = None

    def _remove(self, job_id: str) -> None:
        owner = self._owners.pop(job_id)
        del self._jobs[owner][job_id]
        if not self._jobs[owner]:
            del self._jobs[owner]


class Schedule:
    """The order in which jobs get places: the job whose turn is due, else the one with the least left.

    A smaller job overtakes the chunks of larger ones, which do not count. At most `active_jobs` jobs are in
    memory; an idle one gives its place to another. window: places per worker. window_seconds: core-seconds
    in flight per worker, so that short chunks get more places.
    """

    def __init__(self, window: int, window_seconds: float, active_jobs: int, slice_seconds: float) -> None:
        self._window, self._window_seconds, self._active_jobs = window, window_seconds, active_jobs
        self.rotation = Rotation(slice_seconds)
        self.slots = 0  # places of the executor, over all workers
        self.waiting: dict[str, Waiting] = {}  # by job id, in order

    def update(self, waiting: list[Waiting], owners: Mapping[str, str | None]) -> None:
        """Set the jobs that may start, and the owners of all unfinished ones, in order of acceptance."""
        self.waiting = {job.id: job for job in sorted(waiting, key=by_remaining_work)}
        self.rotation.update(owners)

    def next(self, active: Mapping[str, Job], starting: int = 0) -> Next | None:
        """The next job, in memory or waiting; None if enough is in flight or no job has a chunk.

        active: jobs in memory, by id. starting: number of jobs that will be in memory.
        """
        if self.slots <= 0:
            return None
        return self._next_in_turn(active, starting) or self._next_smallest(active, starting)

    def _next_in_turn(self, active: Mapping[str, Job], starting: int) -> Next | None:
        """The job whose turn is due. Turns take at most half of the workers."""
        turns = sum(len(job.turns) for job in active.values())
        turn_limit = max(self.slots // (2 * self._window), 1)
        if turns >= turn_limit or len(self.rotation) == 1 or not self.rotation.is_due(0.0):
            return None
        for job_id in self.rotation:
            job = active.get(job_id) or self.waiting.get(job_id)
            if job is not None and job.may_submit:
                is_due = self.rotation.is_due(job.chunk_seconds)
                return self._placed(job, True, active, starting) if is_due else None
        return None

    def _next_smallest(self, active: Mapping[str, Job], starting: int) -> Next | None:
        """The job with the least left to compute among those that may submit a chunk."""
        jobs = sorted(active.values(), key=by_remaining_work)
        count = sum(len(job.in_flight) for job in jobs)
        seconds = sum(len(job.in_flight) * job.chunk_seconds for job in jobs)
        if self._is_full(count / MAX_TIMES_IN_FLIGHT, seconds / MAX_TIMES_IN_FLIGHT):
            return None
        count, seconds, has_room = 0, 0.0, True  # in flight for jobs with less left
        for job in heapq.merge(jobs, self.waiting.values(), key=by_remaining_work):
            count += len(job.in_flight)
            seconds += len(job.in_flight) * job.chunk_seconds
            if self._is_full(count, seconds):
                return None
            if job.may_submit and (has_room or job.id in active):
                placed = self._placed(job, False, active, starting)
                if placed is not None:
                    return placed
                has_room = False  # the jobs behind it have more left, and so no place either
        return None

    def _placed(self, job: Job, is_turn: bool, active: Mapping[str, Job], starting: int) -> Next | None:
        """A job with a place in memory, or None. An idle job with more left leaves; for a turn any idle."""
        if job.id in active or len(active) + starting < self._active_jobs:
            return Next(job, is_turn)
        idle = [other for other in active.values() if other.is_idle and other.may_submit]
        leaving = max(idle, key=by_remaining_work, default=None)
        if leaving is None or (not is_turn and leaving.remaining_seconds <= job.remaining_seconds):
            return None
        return Next(job, is_turn, leaving)

    def _is_full(self, count: float, seconds: float) -> bool:
        """Whether `count` chunks, of `seconds` core-seconds in all, are enough; more if they are short."""
        enough = self._window_seconds * self.slots / self._window
        return count >= self.slots and (seconds >= enough or count >= MAX_IN_FLIGHT)
