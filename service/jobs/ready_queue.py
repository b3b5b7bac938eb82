"""Which chunk of a job to compute next. Pure."""

from collections import deque
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray


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
