"""Which workers fail what others compute: a retry goes elsewhere, and such a worker gets nothing for a while.

A chunk that fails everywhere is to blame itself. One that failed on a worker and is then computed by another
is a mark against the first; a chunk that a worker computes clears its marks.
"""

from collections import Counter, OrderedDict
from collections.abc import Hashable
from typing import Final

#: Marks in a row at which a worker gets no task for REST_SECONDS.
MARKS: Final = 3
REST_SECONDS: Final = 60.0
#: Failed chunks that are remembered.
_REMEMBERED: Final = 10_000


class Quarantine:
    """Marks against workers. Pure; its methods are called from one thread, `failed_on` from any."""

    def __init__(self) -> None:
        self._failed_on: OrderedDict[Hashable, set[str]] = OrderedDict()  # workers, by chunk
        self._marks: Counter[str] = Counter()

    def failed(self, chunk: Hashable, worker: str) -> None:
        """A worker failed a chunk, or died of it."""
        self._failed_on.setdefault(chunk, set()).add(worker)
        self._failed_on.move_to_end(chunk)
        while len(self._failed_on) > _REMEMBERED:
            self._failed_on.popitem(last=False)

    def computed(self, chunk: Hashable, worker: str | None) -> list[str]:
        """A worker computed a chunk; the workers that shall rest, because they failed several such."""
        if worker is not None:
            self._marks.pop(worker, None)
        failed_on = self._failed_on.pop(chunk, set()) - {worker}
        self._marks.update(failed_on)
        due = [each for each in failed_on if self._marks[each] >= MARKS]
        for each in due:
            del self._marks[each]
        return due

    def failed_on(self, chunk: Hashable) -> frozenset[str]:
        """The workers on which a chunk failed since it was last computed."""
        return frozenset(self._failed_on.get(chunk, ()))
