"""What to compute next: which chunk of a job, and which job. Pure."""

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

#: The share of the workers' time for all jobs in turn; the rest goes to the job with the least left.
ROTATION_SHARE: Final = 0.25


class ReadyQueue:
    """The chunks of one job that are not done, in an order in which they can be computed; a few bytes each.

    `lines`: chunk i depends on chunk i - lines, if there is one. `done`: (n,) which chunks are already done.
    """

    def __init__(self, lines: int, done: NDArray[np.bool_]) -> None:
        self._lines, self._done = lines, done.copy()
        ready = np.concatenate([np.ones(min(lines, len(done)), np.bool_), done[:-lines]])
        self._initial = np.flatnonzero(ready & ~done)  # ready from the start
        self._initial_popped = 0  # how many of them are popped
        self._first: deque[int] = deque()  # requeued chunks that come before all others
        self._later: deque[int] = deque()  # ready since then: successors and requeued chunks
        self._popped: set[int] = set()  # neither requeued nor complete
        self.remaining = int(np.count_nonzero(~self._done))  # chunks that are not done

    @property
    def ready(self) -> int:
        """Number of chunks that can be popped."""
        return len(self._initial) - self._initial_popped + len(self._first) + len(self._later)

    def pop(self) -> int:
        """A chunk that can be computed now; raises IndexError if none is ready.

        All chains of a ramp advance together: a long one left to the end would occupy a single worker.
        """
        if self._first:
            chunk = self._first.popleft()
        elif self._initial_popped == len(self._initial):
            chunk = self._later.popleft()
        else:
            self._initial_popped += 1
            chunk = int(self._initial[self._initial_popped - 1])
        self._popped.add(chunk)
        return chunk

    def requeue(self, chunk: int, *, first: bool = False) -> None:
        """Put a popped chunk that was not computed at the end of the queue, or before all others."""
        self._popped.discard(chunk)
        if self._can_run(chunk):
            (self._first if first else self._later).append(chunk)

    def complete(self, chunks: Iterable[int]) -> None:
        """Mark popped chunks as done; their successors become ready."""
        for chunk in chunks:
            self._popped.discard(chunk)
            if not self._done[chunk]:
                self._done[chunk] = True
                self.remaining -= 1
                successor = chunk + self._lines
                if successor < len(self._done) and self._can_run(successor):
                    self._later.append(successor)

    def invalidate(self, chunks: Iterable[int]) -> None:
        """Queue done chunks again; their successors wait for them again."""
        undone = [chunk for chunk in dict.fromkeys(chunks) if self._done[chunk]]
        if not undone:
            return
        self._done[undone] = False
        self.remaining += len(undone)
        initial = self._initial[self._initial_popped :]
        self._initial = initial[~np.isin(initial - self._lines, undone)]
        self._initial_popped = 0
        self._first = deque(filter(self._can_run, self._first))
        self._later = deque(filter(self._can_run, [*self._later, *undone]))

    def _can_run(self, chunk: int) -> bool:
        ready = chunk < self._lines or bool(self._done[chunk - self._lines])
        return ready and not self._done[chunk] and chunk not in self._popped


def chunk_seconds(estimate: float, taken: float, timed: float) -> float:
    """Core-seconds of a job's chunk: the mean of the estimate and of the `timed` chunks, which took `taken`.

    So neither a low nor a high estimate decides the order of jobs for long.
    """
    return (estimate + taken) / (1.0 + timed)


class Rotation:
    """The unfinished jobs in the order of their turns, and when the next turn is due.

    Owners take turns, and so do each owner's jobs. A turn is one chunk, or one time slice of a long one. In
    any case `ROTATION_SHARE` of the workers' time goes to turns, so that every job advances, however many
    smaller ones follow it.

    `slice_seconds`: the highest cost of a turn.
    """

    def __init__(self, slice_seconds: float) -> None:
        self.slice_seconds = slice_seconds
        self._jobs: dict[str | None, dict[str, None]] = {}  # ids by owner, both in the order of their turns
        self._owners: dict[str, str | None] = {}  # by job
        self._credit = 0.0  # core-seconds that turns may take now

    def update(self, owners: Mapping[str, str | None]) -> None:
        """Forget ended jobs and add new ones at the end. `owners`: by job, in order of acceptance."""
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
        """Give a job a turn of about `seconds` core-seconds; its next turn follows all other jobs'."""
        self._credit -= min(seconds, self.slice_seconds)
        owner = self._owners[job_id]
        self._remove(job_id)
        self._append(job_id, owner)
        self._jobs[owner] = self._jobs.pop(owner)

    def end_turn(self, estimate: float, taken: float) -> None:
        """Replace a turn's estimate by the core-seconds it has taken."""
        self._credit += min(estimate, self.slice_seconds) - taken

    def earn(self, seconds: float) -> None:
        """Add the core-seconds of chunks outside the rotation.

        The credit is at most one turn's: missed turns are not made up for.
        """
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
