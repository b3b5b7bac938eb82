"""The service's view of its workers: which are refused, which leave, and which fail what others compute.

A chunk that fails everywhere is itself to blame. A chunk that fails on one worker and is then computed by
another counts against the first; a worker that computes a chunk clears its count.
"""

import logging
from collections import Counter, OrderedDict
from collections.abc import Collection, Hashable
from typing import Any, Final

log = logging.getLogger(__name__)

#: Failures in a row after which a worker gets no task for REST_SECONDS.
MARKS: Final = 3
REST_SECONDS: Final = 60.0
#: Number of workers' hosts, workers that left, and failed chunks remembered.
_REMEMBERED: Final = 10_000


class Roster:
    """Workers by address. Pure; its methods are called from one thread, those that only read from any."""

    def __init__(self) -> None:
        self.refused: dict[str, str] = {}  # workers refused now or when last present, and why
        self._hosts: OrderedDict[Hashable, str] = OrderedDict()
        self._leaving: OrderedDict[Hashable, None] = OrderedDict()
        self._failed_on: OrderedDict[Hashable, set[str]] = OrderedDict()  # workers, by chunk
        self._marks: Counter[str] = Counter()

    def note(self, event: dict[str, Any]) -> None:
        """Record an event that a worker's plugin logged."""
        address = event["worker"]
        _remember(self._hosts, address, event["host"])
        if "refused" in event:
            refused = f"worker {self.describe(address)} (process {event['process']}): {event['refused']}"
            if self.refused.get(address) != refused:
                log.warning("refused: %s", refused)
            self.refused[address] = refused
        elif "admitted" in event:
            if self.refused.pop(address, None) is not None:
                log.info("worker %s is admitted now", self.describe(address))
        elif "leaving" in event:
            _remember(self._leaving, address, None)

    def keep(self, present: Collection[str]) -> None:
        """Forget refused workers that are not `present`."""
        for address in self.refused.keys() - present:
            self.refused.pop(address, None)

    def is_leaving(self, address: str) -> bool:
        """Whether a worker has reported that it must leave."""
        return address in self._leaving

    def describe(self, address: str) -> str:
        """A worker's address, and its host if known."""
        host = self._hosts.get(address)
        return address if host is None else f"{address} on {host}"

    def failed(self, chunk: Hashable, worker: str) -> None:
        """Note that a worker failed a chunk or died of it."""
        _remember(self._failed_on, chunk, self._failed_on.get(chunk, set()) | {worker})

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


def _remember(known: OrderedDict[Hashable, Any], key: Hashable, value: Any) -> None:
    known[key] = value
    known.move_to_end(key)
    while len(known) > _REMEMBERED:
        known.popitem(last=False)
