"""Specifications of chunks, sent to each worker once: a list of axis values may have thousands of numbers.

A long specification is written beside the store's metadata, and a chunk is sent with its digest. A worker
reads and parses it when it computes its first chunk of the job.
"""

import json
import logging
import pickle
from collections import OrderedDict
from functools import lru_cache
from typing import Any, Final, NamedTuple

from worker import store
from worker.studies import Chunk, Spec, from_json
from worker.tasks import ChunkReport, TaskError, Terms
from worker.watchdog import run_watched

log = logging.getLogger(__name__)

#: Pickled specifications of more bytes are sent once.
LONG_BYTES: Final = 4_000
#: Jobs whose specifications are remembered, by the service and by each worker.
REMEMBERED: Final = 32


class Reference(NamedTuple):
    """Where a specification is: in a store, and its digest."""

    url: str
    digest: str


class SentSpecs:
    """Which specifications are sent by reference; used by the service's supervisor alone."""

    def __init__(self) -> None:
        self._sent: OrderedDict[str, tuple[Spec, Spec | Reference]] = OrderedDict()  # by store

    def sent(self, spec: Spec, url: str) -> Spec | Reference:
        """What to send in place of a specification: itself, unless it is long."""
        known, sent = self._sent.get(url, (None, spec))
        if known is not spec:
            sent = self._reference(spec, url) if len(pickle.dumps(spec)) > LONG_BYTES else spec
            self._sent[url] = spec, sent
            if len(self._sent) > REMEMBERED:
                self._sent.popitem(last=False)
        return sent

    def _reference(self, spec: Spec, url: str) -> Spec | Reference:
        """Write a specification into its store; itself where that cannot be done, or would change it."""
        text = json.dumps(spec.as_submitted())
        try:
            if from_json(text) == spec:
                return Reference(url, store.write_spec(url, text))
        except Exception as error:  # noqa: BLE001 - a full disk, a bucket out of reach: it is sent whole
            log.warning("the specification cannot be written to %s: %s", url, error)
        return spec


def run_sent(
    sent: Spec | Reference, chunk: Chunk, store_url: str, seconds: float, terms: Terms
) -> ChunkReport | TaskError:
    """`run_watched` of a chunk whose specification may have been sent by reference."""
    spec = _read(sent) if isinstance(sent, Reference) else sent
    return run_watched(spec, chunk, store_url, seconds, terms)


@lru_cache(maxsize=REMEMBERED)
def _read(reference: Reference) -> Any:
    text = store.read_spec(reference.url, reference.digest)
    if text is None:
        raise store.StoreMissing(f"{reference.url}: the job's specification is not there")
    return from_json(text)
