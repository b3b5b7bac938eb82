"""A file beside the stores that says whose they are: the service's ledger writes its id there, once.

A worker proves by it that it sees the folder that the service sees, and the service that the folder is there.
"""

from typing import Final

from worker.store import backend

MARKER: Final = ".ledger"


def write_marker(url: str, content: str) -> None:
    """Mark a folder of stores, or prefix of a bucket. Raises OSError, or one of `store.UNREACHABLE`."""
    backend.make_place(url)
    backend.put(url, MARKER, content.encode())


def read_marker(url: str) -> str | None:
    """What marks the stores at an address; None if nothing does.

    Raises OSError, or one of `store.UNREACHABLE`.
    """
    content = backend.read_key(url, MARKER)
    return None if content is None else content.decode(errors="replace")
