"""Room: reading cells of a store: the chunks they lie in, straight from their files.

zarr's own way to a chunk takes longer than the chunk's decompression, many times over where chunks are
small. What is read here is what worker.store.metadata lays out and nothing else: whole chunks of numbers,
little-endian, zstd with a checksum. Used through worker.store.
"""

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
from numcodecs.zstd import decompress
from numpy.typing import NDArray

from worker import schema
from worker.store.backend import in_bucket, read_key
from worker.store.chunks import Index, Shape, key, threads
from worker.store.errors import ChunkCoords, StoreDamaged, StoreMissing

ROOT: Final = "zarr.json"

_ARRAYS: Final = {array.name: array for array in (*schema.RECORD, schema.END_STATE, schema.OUTCOME)}


class _Cut(NamedTuple):
    """How one stored array is cut; shapes have the extra dimension too."""

    array: schema.Array
    shape: Shape
    chunks: Shape


class _Part(NamedTuple):
    """What one chunk holds of the cells asked for: where in the chunk, and where among them."""

    place: ChunkCoords
    inside: tuple[slice, ...]
    among: tuple[slice, ...]


def read_cells(
    url: str, names: Iterable[str], where: Sequence[Index], complete: bool
) -> dict[str, NDArray[Any]]:
    """As `store.read_slice`; `where` is the index along (direction, xi, omega, gamma)."""
    cuts = _described(_root(url))
    outcome, wanted = schema.OUTCOME.name, list(dict.fromkeys(names))
    parts = list(_parts(cuts[outcome], where))
    reading = _Reading(url, cuts, where)
    # Outcomes first: a cell that had one had everything else before, and one that has none has nothing.
    there = reading.take([(outcome, part) for part in parts], lenient=not complete)
    others = [name for name in wanted if name != outcome]
    reading.take([(name, part) for name in others for _, part in there], lenient=False)
    if reading.damaged:
        error = StoreDamaged(next(iter(reading.damaged.values())))
        error.places = tuple(reading.damaged)
        raise error
    return {name: reading.answer(name) for name in wanted}


class _Reading:
    """The cells asked for as they come together, and the chunks that are not as they were written."""

    def __init__(self, url: str, cuts: dict[str, _Cut], where: Sequence[Index]) -> None:
        self._url, self._cuts, self._where = url, cuts, where
        self._found: dict[str, NDArray[Any]] = {}
        self.damaged: dict[ChunkCoords, str] = {}

    def take(self, asked: list[tuple[str, _Part]], lenient: bool) -> list[tuple[str, _Part]]:
        """Read parts of arrays; gives those that were there. The others are damage unless `lenient`."""
        there = []
        addresses = [key(name, part.place) for name, part in asked]
        for (name, part), content in zip(asked, _contents(self._url, addresses), strict=True):
            if content is not None:
                there.append((name, part))
                self._put(name, part, content)
            elif not lenient:
                self.damaged.setdefault(part.place, f"{key(name, part.place)}: is gone")
        return there

    def answer(self, name: str) -> NDArray[Any]:
        """What was found of an array, without the dimensions that were asked for by a whole number."""
        drop = tuple(0 if isinstance(index, int) else slice(None) for index in self._where)
        return self._all(name)[drop]

    def _put(self, name: str, part: _Part, content: bytes) -> None:
        cut = self._cuts[name]
        numbers = np.empty(cut.chunks, cut.array.dtype)  # damaged bytes may claim to hold far more
        try:
            decompress(content, numbers)
        except (RuntimeError, ValueError) as error:  # what is raised for bytes that are not ours
            self.damaged.setdefault(part.place, f"{key(name, part.place)}: cannot be read back: {error}")
        else:
            self._all(name)[part.among] = numbers[part.inside]

    def _all(self, name: str) -> NDArray[Any]:
        if name not in self._found:
            cut = self._cuts[name]
            cells = [len(_range(n, index)) for n, index in zip(cut.shape, self._where, strict=False)]
            extra = cut.shape[len(cells) :]
            self._found[name] = np.full((*cells, *extra), cut.array.fill, cut.array.dtype)
        return self._found[name]


def _contents(url: str, addresses: list[str]) -> Iterator[bytes | None]:
    """What lies under each address; a bucket answers many questions at once as fast as one."""
    if in_bucket(url):
        return threads().map(lambda address: read_key(url, address), addresses)
    return (read_key(url, address) for address in addresses)


def _root(url: str) -> bytes:
    content = read_key(url, ROOT)
    if content is None:
        raise StoreMissing(f"{url}: no store here")
    return content


@lru_cache(maxsize=32)  # the specification in it can be long
def _described(root: bytes) -> dict[str, _Cut]:
    """The arrays of cells by name, from the root's consolidated metadata."""
    try:
        consolidated = json.loads(root).get("consolidated_metadata")
        found = (
            {
                name: _Cut(
                    _ARRAYS[name],
                    tuple(about["shape"]),
                    tuple(about["chunk_grid"]["configuration"]["chunk_shape"]),
                )
                for name, about in consolidated["metadata"].items()
                if name in _ARRAYS
            }
            if consolidated
            else None
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise StoreDamaged(f"the store's metadata cannot be read: {type(error).__name__}: {error}") from None
    if found is None:
        raise StoreMissing("the store was never finished; create it again")
    if schema.OUTCOME.name not in found:
        raise StoreDamaged("the store's metadata cannot be read: no outcomes in it")
    return found


def _parts(cut: _Cut, where: Sequence[Index]) -> Iterator[_Part]:
    """The chunks that hold the cells at these indices."""
    axes = [
        list(_spans(_range(n, index), size))
        for n, size, index in zip(cut.shape, cut.chunks, where, strict=False)
    ]
    for found in product(*axes):
        places, inside, among = zip(*found, strict=True)
        yield _Part(ChunkCoords(*places), inside, among)


def _range(length: int, index: Index) -> range:
    """The places along an axis that an index means; raises IndexError outside it."""
    places = range(length)[index]
    return range(places, places + 1) if isinstance(places, int) else places


def _spans(cells: range, size: int) -> Iterator[tuple[int, slice, slice]]:
    """The chunks along an axis that hold some of these cells: number, where in it, where among the cells."""
    first = 0
    while first < len(cells):
        chunk = cells[first] // size
        end = min(len(cells), math.ceil(((chunk + 1) * size - cells.start) / cells.step))
        low, high = cells[first] - chunk * size, cells[end - 1] - chunk * size
        yield chunk, slice(low, high + 1, cells.step), slice(first, end)
        first = end
