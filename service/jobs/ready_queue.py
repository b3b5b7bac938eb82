"""Which chunks of one job may be computed next, each after the one whose end it takes over. Pure.

Lean enough for a million chunks: a few numbers a chunk.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

#: Stands for no chunk, where a chunk waits for no other.
NONE: Final = -1


class ReadyQueue:
    """The chunks between done and not yet possible.

    `after`: (n,) integers, the chunk that each chunk waits for, or NONE.
    `done`: (n,) which chunks are done already.
    """

    def __init__(self, after: NDArray[np.int64], done: NDArray[np.bool_]) -> None:
        self._done = done.copy()
        self._by_predecessor = np.argsort(after, kind="stable")
        self._predecessors = after[self._by_predecessor]
        free = (after == NONE) | self._done[after]
        self._free = np.flatnonzero(free & ~self._done)  # from the start, taken up to `_taken`
        self._after = after
        self._taken = 0
        self._out: set[int] = set()  # taken, and neither put back nor complete
        self._freed: deque[int] = deque()  # since then, and what was put back
        self._left = int(np.count_nonzero(~self._done))

    @property
    def finished(self) -> bool:
        """Whether every chunk is done."""
        return self._left == 0

    @property
    def ready(self) -> bool:
        """Whether there is a chunk to take."""
        return self._taken < len(self._free) or bool(self._freed)

    def take(self) -> int:
        """A chunk that may be computed now; raises IndexError if none is ready.

        All chains move on together, so that the last one does not run alone at the end.
        """
        if self._taken == len(self._free):
            chunk = self._freed.popleft()
        else:
            self._taken += 1
            chunk = int(self._free[self._taken - 1])
        self._out.add(chunk)
        return chunk

    def requeue(self, chunk: int) -> None:
        """A chunk that was taken was not computed; the others go first."""
        self._out.discard(chunk)
        if self._possible(chunk):
            self._freed.append(chunk)

    def complete(self, chunks: Iterable[int]) -> None:
        """Chunks that were taken are done; those that waited for them become ready."""
        for chunk in chunks:
            self._out.discard(chunk)
            if not self._done[chunk]:
                self._done[chunk] = True
                self._left -= 1
                self._freed.extend(one for one in self._waiting_for(chunk))

    def invalidate(self, chunks: Iterable[int]) -> None:
        """Chunks that were done are to be computed again, and what waits for them waits again."""
        again = {chunk for chunk in chunks if self._done[chunk]}
        self._done[list(again)] = False
        self._left += len(again)
        waiting = [*(int(chunk) for chunk in self._free[self._taken :]), *self._freed, *again]
        self._free, self._taken = np.empty(0, np.int64), 0
        self._freed = deque(chunk for chunk in dict.fromkeys(waiting) if self._possible(chunk))

    def _possible(self, chunk: int) -> bool:
        before = self._after[chunk]
        return (
            not self._done[chunk] and chunk not in self._out and (before == NONE or bool(self._done[before]))
        )

    def _waiting_for(self, chunk: int) -> Iterator[int]:
        return (int(one) for one in self._successors(chunk) if not self._done[one] and one not in self._out)

    def _successors(self, chunk: int) -> NDArray[np.int64]:
        low, high = np.searchsorted(self._predecessors, [chunk, chunk + 1])
        return self._by_predecessor[low:high]
