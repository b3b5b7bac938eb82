"""A file beside the stores by which a worker proves that it sees the folder that the service sees."""

from typing import Final
from uuid import uuid4

from worker.store import backend

_PROBE: Final = ".probe"


def write_probe(url: str) -> str:
    """Write the probe of a folder of stores, or prefix of a bucket, and return its content.

    One that is there is kept: the workers of an earlier start know it. Raises OSError, or one of
    `store.UNREACHABLE`.
    """
    content = read_probe(url)
    if not content:
        content = uuid4().hex
        backend.make_place(url)
        backend.put(url, _PROBE, content.encode())
    return content


def read_probe(url: str) -> str | None:
    """The probe's content; None if there is none. Raises OSError, or one of `store.UNREACHABLE`."""
    found = backend.read_key(url, _PROBE)
    return None if found is None else found.decode(errors="replace")
