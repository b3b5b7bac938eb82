"""Benches workers that fail chunks which other workers complete.

A chunk that fails everywhere is itself to blame. A chunk that fails on one worker and is then computed by
another counts against the first; a worker that computes a chunk clears its count.
"""

from collections import Counter, OrderedDict
from collections.abc import Hashable
from typing import Final

#: Failures in a row after which a worker gets no task for REST_SECONDS.
MARKS: Final = 3
REST_SECONDS: Final = 60.0
#: Number of failed chunks remembered.
_REMEMBERED: Final = 10_000


class Quarantine:
    """Failures of workers. Pure; its methods are called from one thread, `failed_on` from any."""

    def __init__(self) -> None:
        self._failed_on: OrderedDict[Hashable, set[str]] = OrderedDict()  # workers, by chunk
        self._marks: Counter[str] = Counter()

    def failed(self, chunk: Hashable, worker: str) -> None:
        """Note that a worker failed a chunk or died of it."""
        self._failed_on.setdefault(chunk, set()).add(worker)
        self._failed_on.move_to_end(chunk)
        while len(self._failed_on) > _REMEMBERED:
            self._failed_on.popitem(last=False)

    def computed(self, chunk: Hashable, worker: str | None) -> list[str]:
        """Note that a worker computed a chunk; return the workers to rest, which failed several such."""
        if worker is not None:
            self._marks.pop(worker, None)
        failed_on = self._failed_on.pop(chunk, set()) - {worker}
        self._marks.update(failed_on)
        due = [each for each in failed_on if self._marks[each] >= MARKS]
        for each in due:
            del self._marks[each]
        return due

    def failed_on(self, chunk: Hashable) -> frozenset[str]:
        """Workers on which a chunk has failed since it was last computed."""
        return frozenset(self._failed_on.get(chunk, ()))
