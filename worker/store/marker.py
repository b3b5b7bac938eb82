"""A file beside the stores with the id of the service's ledger, which writes it once.

It proves to a worker that it sees the service's folder, and to the service that the folder is there.
"""

from typing import Final

from worker.store import backend

MARKER: Final = ".ledger"


def write_marker(url: str, content: str) -> None:
    """Mark a folder of stores, or prefix of a bucket. Raises OSError, or one of `store.UNREACHABLE`."""
    backend.make_place(url)
    backend.put(url, MARKER, content.encode())


def read_marker(url: str) -> str | None:
    """The mark of the stores at an address; None without one.

    Raises OSError, or one of `store.UNREACHABLE`.
    """
    content = backend.read_key(url, MARKER)
    return None if content is None else content.decode(errors="replace")
