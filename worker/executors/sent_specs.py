"""Sends each worker the specification of its chunks once: axis values may be thousands of numbers.

A long specification is written beside the store's metadata, and chunks are sent with its digest. A worker
reads and parses it for its first chunk of the job.
"""

import json
import logging
import pickle
from collections import OrderedDict
from functools import lru_cache
from typing import Any, Final, NamedTuple

from worker import store
from worker.studies import Chunk, Spec, from_json
from worker.tasks import ChunkOptions, ChunkReport, TaskError
from worker.watchdog import run_watched

log = logging.getLogger(__name__)

#: Pickled specifications larger than this, in bytes, are sent once.
LONG_BYTES: Final = 4_000
#: Number of jobs whose specifications the service, and each worker, remember.
REMEMBERED: Final = 32


class Reference(NamedTuple):
    """The location of a specification, a store, and its digest."""

    url: str
    digest: str


class SpecReferences:
    """Decides which specifications are sent by reference; used only by the service's supervisor."""

    def __init__(self) -> None:
        self._sent: OrderedDict[str, tuple[Spec, Spec | Reference]] = OrderedDict()  # by store

    def sent(self, spec: Spec, url: str) -> Spec | Reference:
        """The specification itself, or a reference if it is long."""
        last_spec, sent = self._sent.get(url, (None, spec))
        if last_spec is not spec:
            sent = self._reference(spec, url) if len(pickle.dumps(spec)) > LONG_BYTES else spec
            self._sent[url] = spec, sent
            if len(self._sent) > REMEMBERED:
                self._sent.popitem(last=False)
        return sent

    def _reference(self, spec: Spec, url: str) -> Spec | Reference:
        """Write a long specification into its store; returns itself if that fails or would change it."""
        text = json.dumps(spec.as_submitted())
        try:
            if from_json(text) == spec:
                return Reference(url, store.write_spec(url, text))
        except Exception as error:  # noqa: BLE001 - e.g. a full disk: it is sent whole
            log.warning("the specification cannot be written to %s: %s", url, error)
        return spec


def run_sent(
    sent: Spec | Reference, chunk: Chunk, store_url: str, seconds: float, options: ChunkOptions
) -> ChunkReport | TaskError:
    """`run_watched` for a chunk whose specification may be sent by reference."""
    spec = _read_spec(sent) if isinstance(sent, Reference) else sent
    return run_watched(spec, chunk, store_url, seconds, options)


@lru_cache(maxsize=REMEMBERED)
def _read_spec(reference: Reference) -> Any:
    text = store.read_spec(reference.url, reference.digest)
    if text is None:
        raise store.StoreMissing(f"{reference.url}: the job's specification is not there")
    return from_json(text)
