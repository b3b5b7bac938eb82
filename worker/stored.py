"""Room: a chunk's stored bytes: where they are, that they are on the disk for good, and still the same.

Every array has one file (or object) a chunk, whose address follows from the plan alone; so whole
jobs can be checked without opening their stores.
"""

import hashlib
import os
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import product, starmap
from pathlib import Path
from typing import Final, NamedTuple

from worker import layout
from worker.places import delete, in_bucket, read
from worker.plan import Chunk
from worker.spec import SweepSpec

#: A disk answers several of these at once as fast as one.
_SYNC_THREADS: Final = 8

_DIMS: Final = {array.name: array.dims for array in (*layout.RECORD, layout.END_STATE, layout.OUTCOME)}

Shape = tuple[int, ...]
Index = int | slice


class Place(NamedTuple):
    """A chunk's address in the grid of chunks."""

    direction: int
    xi: int
    omega: int
    gamma: int


def place_of(chunk: Chunk, chunk_shape: Shape) -> Place:
    """Where a chunk lies; `chunk_shape` is (xi, omega, gamma)."""
    xi, omega, gamma = (
        span[0] // size for span, size in zip((chunk.xi, chunk.omega, chunk.gamma), chunk_shape, strict=True)
    )
    return Place(chunk.direction, xi, omega, gamma)


def key(name: str, place: Place) -> str:
    """Address of one array's chunk below the store's own."""
    extra = "/0" * (len(_DIMS[name]) - len(place))
    return f"{name}/c/{'/'.join(map(str, place))}{extra}"


def place_in(address: str) -> Place:
    """The chunk that an address made by `key` belongs to."""
    direction, xi, omega, gamma = map(int, address.split("/")[2:6])
    return Place(direction, xi, omega, gamma)


def touched(shape: Shape, chunk_shape: Shape, where: Iterable[Index]) -> Iterator[Place]:
    """The chunks that hold the cells at these indices; the shapes are an array's own."""
    spans = []
    for index, size, length in zip(where, chunk_shape, shape, strict=False):
        cells = range(length)[index]
        ends = (cells, cells) if isinstance(cells, int) else (cells[0], cells[-1])
        spans.append(range(min(ends) // size, max(ends) // size + 1))
    return starmap(Place, product(*spans))


def checksum(url: str, names: Iterable[str], place: Place) -> str:
    """SHA-256 over the chunk's stored bytes in these arrays, 64 hex digits; absent ones count too."""
    digest = hashlib.sha256()
    for name in names:
        content = read(url, key(name, place))
        digest.update(f"{name} {'absent' if content is None else len(content)}\n".encode())
        digest.update(content or b"")
    return digest.hexdigest()


def changed(
    url: str, spec: SweepSpec, chunk_shape: Shape, chunks: Iterable[tuple[Chunk, str]]
) -> Iterator[Chunk]:
    """Those chunks whose stored bytes are not what their checksums say; a fraction of a millisecond each."""
    names = [array.name for array in layout.arrays(spec)]
    for chunk, expected in chunks:
        if checksum(url, names, place_of(chunk, chunk_shape)) != expected:
            yield chunk


def discard(url: str, spec: SweepSpec, place: Place) -> None:
    """Remove a chunk, its outcomes first, so that its cells read as missing from then on."""
    names = [array.name for array in layout.arrays(spec)]
    for name in reversed(names):
        delete(url, key(name, place))


def harden(url: str, keys: Sequence[str]) -> None:
    """Return when files just written, and the folders that name them, would survive a loss of power.

    A bucket has answered only then anyway.
    """
    if in_bucket(url):
        return
    root = Path(url)
    files = [root / key for key in keys]
    folders = {above for file in files for above in file.parents if above.is_relative_to(root)}
    for group in (files, [*folders, root.parent]):
        list(_threads().map(_fsync, group))


def _fsync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_SYNC_THREADS, thread_name_prefix="harden")
