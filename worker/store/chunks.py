"""Stored bytes of chunks: keys, checksums, removal, durability.

Every array has one file (or object) per chunk. Its key follows from the chunk's coordinates, so a whole job
can be verified without opening its store.
"""

import hashlib
import os
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Final, Protocol, TypeVar

from worker.schema import Layout
from worker.store.backend import delete, in_bucket, read_key
from worker.store.errors import ChunkCoords

#: Concurrent syncs and requests: they wait for the disk or the network, not for the processor.
_THREADS: Final = 8

Index = int | slice
#: Names of arrays and their numbers of dimensions, in the order they are written.
Names = Sequence[tuple[str, int]]


class HasSlices(Protocol):
    """The properties of a chunk that the store needs."""

    @property
    def slices(self) -> tuple[slice, ...]:
        """The cells it spans along each cell dimension."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the record's arrays; may omit dimensions of length one."""


Chunk = TypeVar("Chunk", bound=HasSlices)


def names_of(layout: Layout) -> Names:
    """Names and numbers of dimensions of a layout's arrays."""
    return [(array.name, len(array.dims)) for array in layout.arrays]


def key(name: str, dims: int, coords: ChunkCoords) -> str:
    """Key of one array's chunk in its store; `dims` is the array's number of dimensions."""
    extra = "/0" * (dims - len(coords))
    return f"{name}/c/{'/'.join(map(str, coords))}{extra}"


def checksum(url: str, names: Names, coords: ChunkCoords) -> str:
    """SHA-256 of a chunk's stored bytes in these arrays, 64 hex digits; also covers which are absent."""
    digest = hashlib.sha256()
    for name, dims in names:
        content = read_key(url, key(name, dims, coords))
        digest.update(f"{name} {'absent' if content is None else len(content)}\n".encode())
        digest.update(content or b"")
    return digest.hexdigest()


def checksum_of(url: str, layout: Layout, chunk: HasSlices) -> str:
    """The checksum of a chunk's stored bytes, as `find_corrupt` expects it."""
    return checksum(url, names_of(layout), layout.coords(chunk.slices))


def find_corrupt(url: str, layout: Layout, chunks: Iterable[tuple[Chunk, str]]) -> Iterator[Chunk]:
    """The chunks whose stored bytes differ from their expected checksums."""
    names = names_of(layout)
    for chunk, expected in chunks:
        if checksum(url, names, layout.coords(chunk.slices)) != expected:
            yield chunk


def discard(url: str, layout: Layout, chunk: HasSlices) -> None:
    """Remove a chunk's stored bytes; `outcome` first, so that its cells read as missing at any time."""
    for name, dims in reversed(names_of(layout)):
        delete(url, key(name, dims, layout.coords(chunk.slices)))


def fsync_files(url: str, keys: Sequence[str]) -> None:
    """Sync files to disk, and the folders above them up to the store's parent.

    Does nothing for a bucket, whose acknowledged objects are durable.
    """
    if in_bucket(url):
        return
    root = Path(url)
    files = [root / key for key in keys]
    folders = {above for file in files for above in file.parents if above.is_relative_to(root)}
    for group in (files, [*folders, root.parent]):
        list(threads().map(_fsync, group))


def _fsync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@cache
def threads() -> ThreadPoolExecutor:
    """The thread pool for syncs and for requests to buckets."""
    return ThreadPoolExecutor(_THREADS, thread_name_prefix="store")
