"""The service's view of its workers: which are refused and which are leaving. Pure."""

import logging
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any, Final

log = logging.getLogger(__name__)

#: Number of workers that left, and of workers' hosts, remembered.
_REMEMBERED: Final = 10_000


@dataclass(frozen=True)
class Refused:
    """A worker that may not compute."""

    worker: str  # its address
    host: str
    process: int
    reason: str

    def __str__(self) -> str:
        return f"worker {self.worker} on {self.host} (process {self.process}): {self.reason}"


class Roster:
    """Workers by address, from the events of their plugin. Events come from one thread, any may read."""

    def __init__(self) -> None:
        self._refused: dict[str, Refused] = {}
        self._hosts: OrderedDict[str, str] = OrderedDict()
        self._leaving: OrderedDict[str, None] = OrderedDict()

    def note(self, event: dict[str, Any]) -> None:
        """Record an event that a worker's plugin logged."""
        address = event["worker"]
        _remember(self._hosts, address, event["host"])
        if "refused" in event:
            refused = Refused(address, event["host"], event["process"], event["refused"])
            if self._refused.get(address) != refused:
                log.warning("refused: %s", refused)
            self._refused[address] = refused
        elif "admitted" in event:
            if self._refused.pop(address, None) is not None:
                log.info("worker %s on %s is admitted now", address, event["host"])
        elif "leaving" in event:
            _remember(self._leaving, address, None)

    @property
    def refused(self) -> tuple[Refused, ...]:
        """Workers refused now, or when last present."""
        return tuple(self._refused.values())

    def keep(self, present: set[str]) -> None:
        """Forget refused workers that are not `present`."""
        for address in self._refused.keys() - present:
            self._refused.pop(address, None)

    def is_leaving(self, address: str) -> bool:
        """Whether a worker has reported that it must leave."""
        return address in self._leaving

    def describe(self, address: str) -> str:
        """A worker's address, and its host if known."""
        host = self._hosts.get(address)
        return address if host is None else f"{address} on {host}"


def _remember(known: OrderedDict[str, Any], address: str, value: Any) -> None:
    known[address] = value
    known.move_to_end(address)
    while len(known) > _REMEMBERED:
        known.popitem(last=False)
