"""Stored bytes of chunks: keys, checksums, sizes, removal, durability.

Every array has one file (or object) per chunk. Its key follows from the chunk's coordinates, so a whole job
can be verified without opening its store.
"""

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from worker.schema import Layout
from worker.store.backend import delete, in_bucket, place, put, read_key, sizes_in, write_partial
from worker.store.errors import ChunkCoords

#: Concurrent syncs and requests, which wait for the disk or the network, not for the processor.
_THREADS: Final = 8
#: Files whose sizes are listed between two pauses.
_LISTED: Final = 2_000


class HasSlices(Protocol):
    """The properties of a chunk that the store needs."""

    @property
    def slices(self) -> tuple[slice, ...]:
        """The cells it spans along each cell dimension."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the record's arrays; may omit dimensions of length one."""


Chunk = TypeVar("Chunk", bound=HasSlices)


class Stored(NamedTuple):
    """What is stored of a chunk."""

    checksum: str  # 64 hex digits, as `find_corrupt` expects it
    bytes: int  # of all arrays, compressed


def key(name: str, dims: int, coords: ChunkCoords) -> str:
    """Key of one array's chunk in its store; `dims` is the array's number of dimensions."""
    numbers = [*coords, *[0] * (dims - len(coords))]
    return f"{name}/c.{'.'.join(map(str, numbers))}"


def _keys_of(layout: Layout, chunk: HasSlices) -> dict[str, str]:
    """The keys of a chunk by array, in the order they are written."""
    coords = layout.coords(chunk.slices)
    return {array.name: key(array.name, len(array.dims), coords) for array in layout.arrays}


def digest(contents: Iterable[tuple[str, bytes | None]]) -> Stored:
    """SHA-256 and size of a chunk's stored bytes by array; the checksum covers absent arrays, too."""
    checksum, size = hashlib.sha256(), 0
    for name, content in contents:
        checksum.update(f"{name} {'absent' if content is None else len(content)}\n".encode())
        checksum.update(content or b"")
        size += len(content or b"")
    return Stored(checksum.hexdigest(), size)


def digest_of(url: str, layout: Layout, chunk: HasSlices) -> Stored:
    """The digest of a chunk's stored bytes."""
    return digest((name, read_key(url, key)) for name, key in _keys_of(layout, chunk).items())


def find_corrupt(url: str, layout: Layout, chunks: Iterable[tuple[Chunk, str]]) -> Iterator[Chunk]:
    """The chunks whose stored bytes differ from their expected checksums; reads several at once."""

    def is_corrupt(expected: tuple[Chunk, str]) -> bool:
        return digest_of(url, layout, expected[0]).checksum != expected[1]

    marked = list(chunks)
    for (chunk, _), corrupt in zip(marked, pool("verify").map(is_corrupt, marked), strict=True):
        if corrupt:
            yield chunk


def stored_sizes(url: str, layout: Layout, pause: Callable[[], object] = lambda: None) -> NDArray[np.int64]:
    """Bytes of every chunk over all arrays, by its coordinates; -1 if one of its files is missing.

    Lists folders and reads no file. `pause` is called now and then.
    """
    counts = tuple(-(-len(layout.coordinates[dim]) // size) for dim, size in layout.chunk_sizes.items())
    total, missing = np.zeros(counts, np.int64), np.zeros(counts, np.bool_)
    for array in layout.arrays:
        sizes = np.full(counts, -1, np.int64)
        for number, (name, size) in enumerate(sizes_in(url, array.name)):
            if number % _LISTED == 0:
                pause()
            first, *at = name.split(".")
            with suppress(ValueError, IndexError):  # zarr.json
                if first == "c":
                    sizes[tuple(map(int, at[: len(counts)]))] = size
        missing |= sizes < 0
        total += sizes
    total[missing] = -1
    return total


def discard(url: str, layout: Layout, chunk: HasSlices) -> None:
    """Remove a chunk's stored bytes, `outcome` first, so that its cells always read as missing."""
    for key in reversed(_keys_of(layout, chunk).values()):
        delete(url, key)


def sync_folders(url: str, layout: Layout) -> None:
    """Sync the names of written chunks to disk; their contents are synced when written.

    Call it once for many chunks: it syncs the arrays' folders.
    """
    with suppress(FileNotFoundError):  # the store is being removed, or was
        fsync(url, [Path(url, array.name) for array in layout.arrays])


def fsync(url: str, folders: Iterable[Path]) -> None:
    """Sync the names in folders of a store to disk. A bucket's acknowledged objects are durable."""
    if not in_bucket(url):
        list(pool("store").map(_fsync, folders))


def _fsync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_keys(url: str, contents: Mapping[str, bytes]) -> None:
    """Write keys of a store, each whole or not at all, and the last one after all others."""
    keys = list(contents)
    if in_bucket(url):
        list(pool("store").map(lambda key: put(url, key, contents[key]), keys[:-1]))
        put(url, keys[-1], contents[keys[-1]])
        return
    writing = [pool("store").submit(write_partial, url, contents[key]) for key in keys]
    wait(writing)
    try:
        for key, partial in zip(keys, [future.result() for future in writing], strict=True):
            place(url, partial, key)
    except OSError:
        for future in writing:
            if future.exception() is None:
                future.result().unlink(missing_ok=True)
        raise


@cache
def pool(purpose: str) -> ThreadPoolExecutor:
    """Threads for syncs and requests ("store") or verification ("verify"): storing never waits for it."""
    return ThreadPoolExecutor(_THREADS, thread_name_prefix=purpose)
