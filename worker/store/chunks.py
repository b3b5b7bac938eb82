"""A chunk's stored bytes: where they are, that they are durable, and that they are still the same.

Every array has one file (or object) per chunk, whose address follows from the chunk's coordinates alone; so
whole jobs can be checked without opening their stores.
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

#: A disk's syncs and a bucket's answers come several at a time as fast as one.
_THREADS: Final = 8

Index = int | slice
#: Names of arrays with their number of dimensions, in the order they are written.
Names = Sequence[tuple[str, int]]


class HasSlices(Protocol):
    """A chunk as the store sees it."""

    @property
    def slices(self) -> tuple[slice, ...]:
        """The cells it spans along each cell dimension."""

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape in which its task records these cells; it may leave out dimensions of length one."""


Chunk = TypeVar("Chunk", bound=HasSlices)


def names_of(layout: Layout) -> Names:
    """The arrays of a layout."""
    return [(array.name, len(array.dims)) for array in layout.arrays]


def key(name: str, dims: int, coords: ChunkCoords) -> str:
    """Address of one array's chunk below the store's own; `dims`: how many dimensions the array has."""
    extra = "/0" * (dims - len(coords))
    return f"{name}/c/{'/'.join(map(str, coords))}{extra}"


def checksum(url: str, names: Names, coords: ChunkCoords) -> str:
    """SHA-256 over the chunk's stored bytes in these arrays, 64 hex digits; absent ones count too."""
    digest = hashlib.sha256()
    for name, dims in names:
        content = read_key(url, key(name, dims, coords))
        digest.update(f"{name} {'absent' if content is None else len(content)}\n".encode())
        digest.update(content or b"")
    return digest.hexdigest()


def find_corrupt(url: str, layout: Layout, chunks: Iterable[tuple[Chunk, str]]) -> Iterator[Chunk]:
    """Those chunks whose stored bytes differ from their checksums; a fraction of a millisecond each."""
    names = names_of(layout)
    for chunk, expected in chunks:
        if checksum(url, names, layout.coords(chunk.slices)) != expected:
            yield chunk


def discard(url: str, layout: Layout, chunk: HasSlices) -> None:
    """Remove a chunk, its outcomes first, so that its cells read as missing from then on."""
    for name, dims in reversed(names_of(layout)):
        delete(url, key(name, dims, layout.coords(chunk.slices)))


def fsync_files(url: str, keys: Sequence[str]) -> None:
    """Return when files just written, and the folders that name them, would survive a loss of power.

    Does nothing for a bucket, which acknowledges only what is durable.
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
    """Threads that wait for disks and buckets."""
    return ThreadPoolExecutor(_THREADS, thread_name_prefix="store")
