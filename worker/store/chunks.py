"""Room: a chunk's stored bytes: where they are, that they are on the disk for good, and still the same.

Every array has one file (or object) a chunk, whose address follows from the plan alone; so whole
jobs can be checked without opening their stores.
"""

import hashlib
import os
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Final

from worker import schema
from worker.plan import Chunk
from worker.spec import SweepSpec
from worker.store.backend import delete, in_bucket, read_key
from worker.store.errors import ChunkCoords

#: A disk's syncs and a bucket's answers come several at a time as fast as one.
_THREADS: Final = 8

_DIMS: Final = {array.name: array.dims for array in (*schema.RECORD, schema.END_STATE, schema.OUTCOME)}

Shape = tuple[int, ...]
Index = int | slice


def chunk_coords(chunk: Chunk, chunk_shape: Shape) -> ChunkCoords:
    """Where a chunk lies; `chunk_shape` is (xi, omega, gamma)."""
    xi, omega, gamma = (
        span[0] // size for span, size in zip((chunk.xi, chunk.omega, chunk.gamma), chunk_shape, strict=True)
    )
    return ChunkCoords(chunk.direction, xi, omega, gamma)


def key(name: str, place: ChunkCoords) -> str:
    """Address of one array's chunk below the store's own."""
    extra = "/0" * (len(_DIMS[name]) - len(place))
    return f"{name}/c/{'/'.join(map(str, place))}{extra}"


def checksum(url: str, names: Iterable[str], place: ChunkCoords) -> str:
    """SHA-256 over the chunk's stored bytes in these arrays, 64 hex digits; absent ones count too."""
    digest = hashlib.sha256()
    for name in names:
        content = read_key(url, key(name, place))
        digest.update(f"{name} {'absent' if content is None else len(content)}\n".encode())
        digest.update(content or b"")
    return digest.hexdigest()


def find_corrupt(
    url: str, spec: SweepSpec, chunk_shape: Shape, chunks: Iterable[tuple[Chunk, str]]
) -> Iterator[Chunk]:
    """Those chunks whose stored bytes are not what their checksums say; a fraction of a millisecond each."""
    names = [array.name for array in schema.arrays(spec)]
    for chunk, expected in chunks:
        if checksum(url, names, chunk_coords(chunk, chunk_shape)) != expected:
            yield chunk


def discard(url: str, spec: SweepSpec, place: ChunkCoords) -> None:
    """Remove a chunk, its outcomes first, so that its cells read as missing from then on."""
    names = [array.name for array in schema.arrays(spec)]
    for name in reversed(names):
        delete(url, key(name, place))


def fsync_files(url: str, keys: Sequence[str]) -> None:
    """Return when files just written, and the folders that name them, would survive a loss of power.

    A bucket has answered only then anyway.
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
    """For what is waited for rather than computed."""
    return ThreadPoolExecutor(_THREADS, thread_name_prefix="store")
