"""The service's view of its workers: which are refused, which leave, and on which a chunk has failed."""

import logging
from collections import OrderedDict
from collections.abc import Collection, Hashable
from typing import Any, Final

log = logging.getLogger(__name__)

#: Number of workers' hosts, workers that left, and failed chunks remembered.
_REMEMBERED: Final = 10_000


class Roster:
    """Workers by address. One thread calls the methods that change it; any thread may read."""

    def __init__(self) -> None:
        self.refused: dict[str, str] = {}  # workers refused now or when last present, and why
        self._hosts: OrderedDict[Hashable, str] = OrderedDict()
        self.leaving: OrderedDict[Hashable, None] = OrderedDict()  # workers that have reported this
        self.failed_on: OrderedDict[Hashable, set[str]] = OrderedDict()  # workers, by chunk

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
            _remember(self.leaving, address, None)

    def keep(self, present: Collection[str]) -> None:
        """Forget refused workers that are not `present`."""
        for address in self.refused.keys() - present:
            self.refused.pop(address, None)

    def describe(self, address: str) -> str:
        """A worker's address, and its host if known."""
        host = self._hosts.get(address)
        return address if host is None else f"{address} on {host}"

    def failed(self, chunk: Hashable, worker: str) -> None:
        """Note that a worker failed a chunk or died of it."""
        _remember(self.failed_on, chunk, self.failed_on.get(chunk, set()) | {worker})


def _remember(entries: OrderedDict[Hashable, Any], key: Hashable, value: Any) -> None:
    entries[key] = value
    entries.move_to_end(key)
    while len(entries) > _REMEMBERED:
        entries.popitem(last=False)
