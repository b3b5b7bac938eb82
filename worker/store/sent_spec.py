"""A job's specification as its workers read it: JSON, under its digest, beside the store's metadata."""

import hashlib

from worker.store import backend


def write_spec(url: str, text: str) -> str:
    """Write a specification into a store and return its digest; what was written before stays.

    Raises OSError, or one of `store.UNREACHABLE`.
    """
    digest = hashlib.sha256(text.encode()).hexdigest()
    if read_spec(url, digest) is None:
        backend.put(url, _key(digest), text.encode())
    return digest


def read_spec(url: str, digest: str) -> str | None:
    """The specification with this digest; None if it is not there, or is not what was written."""
    content = backend.read_key(url, _key(digest))
    if content is None or hashlib.sha256(content).hexdigest() != digest:
        return None
    return content.decode()


def _key(digest: str) -> str:
    return f".spec-{digest[:16]}"
