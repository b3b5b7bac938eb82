"""Reading cells of a store: the chunks they lie in, straight from their files.

zarr's own way to a chunk takes many times longer than the chunk's decompression where chunks are small. This
module reads what `metadata.empty_store` lays out and nothing else: whole chunks of numbers, little-endian,
zstd with a checksum. It is used through worker.store.
"""

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
from numcodecs.zstd import decompress
from numpy.typing import NDArray

from worker.store.backend import in_bucket, read_key
from worker.store.chunks import Index, key, threads
from worker.store.errors import ChunkCoords, StoreDamaged, StoreMissing

ROOT: Final = "zarr.json"
OUTCOME: Final = "outcome"


class _Stored(NamedTuple):
    """One stored array, as the store's metadata describe it."""

    dtype: np.dtype[Any]
    fill: Any
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    chunks: tuple[int, ...]


class _Part(NamedTuple):
    """What one chunk holds of the requested cells: where in the chunk, and where among those cells."""

    coords: ChunkCoords
    inside: tuple[slice, ...]
    among: tuple[slice, ...]


def read_cells(
    url: str, names: Iterable[str], where: Mapping[str, Index] | tuple[slice, ...], complete: bool
) -> dict[str, NDArray[Any]]:
    """As `store.read_slice`.

    `where` is the index along some cell dimensions by name, whole along the others; or along all in order.
    """
    arrays = _described(_root(url))
    index = where if isinstance(where, tuple) else _in_order(arrays[OUTCOME].dims, where)
    names = list(dict.fromkeys(names))
    parts = list(_parts(arrays[OUTCOME], index))
    reading = _Reading(url, arrays, index)
    # Outcomes first: a cell that has one had everything else before, and one that has none has nothing.
    present = reading.take([(OUTCOME, part) for part in parts], lenient=not complete)
    others = [name for name in names if name != OUTCOME]
    reading.take([(name, part) for name in others for _, part in present], lenient=False)
    if reading.damaged:
        error = StoreDamaged(next(iter(reading.damaged.values())))
        error.chunks = tuple(reading.damaged)
        raise error
    return {name: reading.answer(name) for name in names}


def _in_order(dims: tuple[str, ...], where: Mapping[str, Index]) -> tuple[Index, ...]:
    if unknown := set(where) - set(dims):
        raise IndexError(f"there is no dimension {', '.join(sorted(unknown))}; there are {', '.join(dims)}")
    return tuple(where.get(dim, slice(None)) for dim in dims)


class _Reading:
    """The requested cells as they come together, and the chunks that are not as they were written."""

    def __init__(self, url: str, arrays: Mapping[str, _Stored], where: tuple[Index, ...]) -> None:
        self._url, self._arrays, self._where = url, arrays, where
        self._cells: dict[str, NDArray[Any]] = {}
        self.damaged: dict[ChunkCoords, str] = {}

    def take(self, parts: list[tuple[str, _Part]], lenient: bool) -> list[tuple[str, _Part]]:
        """Read parts of arrays; returns those that are present. The others are damage unless `lenient`."""
        present = []
        keys = [key(name, len(self._arrays[name].dims), part.coords) for name, part in parts]
        for (name, part), address, content in zip(parts, keys, _contents(self._url, keys), strict=True):
            if content is not None:
                present.append((name, part))
                self._put(name, part, address, content)
            elif not lenient:
                self.damaged.setdefault(part.coords, f"{address}: is gone")
        return present

    def answer(self, name: str) -> NDArray[Any]:
        """The cells of an array, without the dimensions that were indexed by a whole number."""
        drop = tuple(0 if isinstance(index, int) else slice(None) for index in self._where)
        return self._all(name)[drop]

    def _put(self, name: str, part: _Part, address: str, content: bytes) -> None:
        array = self._arrays[name]
        numbers = np.empty(array.chunks, array.dtype)  # damaged bytes may claim to hold far more
        try:
            decompress(content, numbers)
        except (RuntimeError, ValueError) as error:  # what codecs raise for damaged bytes
            self.damaged.setdefault(part.coords, f"{address}: cannot be read back: {error}")
        else:
            self._all(name)[part.among] = numbers[part.inside]

    def _all(self, name: str) -> NDArray[Any]:
        if name not in self._cells:
            array = self._arrays[name]
            cells = [len(_range(n, index)) for n, index in zip(array.shape, self._where, strict=False)]
            extra = array.shape[len(cells) :]
            self._cells[name] = np.full((*cells, *extra), array.fill, array.dtype)
        return self._cells[name]


def _contents(url: str, keys: list[str]) -> Iterator[bytes | None]:
    """What is stored under each key; a bucket answers many questions at once as fast as one."""
    if in_bucket(url):
        return threads().map(lambda key: read_key(url, key), keys)
    return (read_key(url, key) for key in keys)


def _root(url: str) -> bytes:
    content = read_key(url, ROOT)
    if content is None:
        raise StoreMissing(f"{url}: no store here")
    return content


@lru_cache(maxsize=32)  # the specification in it can be long
def _described(root: bytes) -> dict[str, _Stored]:
    """The arrays of cells by name, from the root's consolidated metadata."""
    try:
        consolidated = json.loads(root).get("consolidated_metadata")
        if not consolidated:
            raise StoreMissing("the store was never finished; create it again")
        arrays = {
            name: _stored(metadata)
            for name, metadata in consolidated["metadata"].items()
            if name not in metadata["dimension_names"]  # a coordinate
        }
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise StoreDamaged(f"the store's metadata cannot be read: {type(error).__name__}: {error}") from None
    if OUTCOME not in arrays:
        raise StoreDamaged("the store's metadata cannot be read: no outcomes in it")
    return arrays


def _stored(metadata: Mapping[str, Any]) -> _Stored:
    dtype = np.dtype(metadata["data_type"]).newbyteorder("<")
    fill = metadata["fill_value"]
    return _Stored(
        dtype,
        np.nan if fill == "NaN" else fill,
        tuple(metadata["dimension_names"]),
        tuple(metadata["shape"]),
        tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"]),
    )


def _parts(array: _Stored, where: tuple[Index, ...]) -> Iterator[_Part]:
    """The chunks that hold the cells at these indices."""
    axes = [
        list(_spans(_range(n, index), size))
        for n, size, index in zip(array.shape, array.chunks, where, strict=True)
    ]
    for spans in product(*axes):
        coords, inside, among = zip(*spans, strict=True)
        yield _Part(coords, inside, among)


def _range(length: int, index: Index) -> range:
    """The positions along an axis that an index means; raises IndexError outside it."""
    positions = range(length)[index]
    return range(positions, positions + 1) if isinstance(positions, int) else positions


def _spans(cells: range, size: int) -> Iterator[tuple[int, slice, slice]]:
    """The chunks along an axis that hold some of these cells: number, where in it, where among the cells."""
    first = 0
    while first < len(cells):
        chunk = cells[first] // size
        end = min(len(cells), math.ceil(((chunk + 1) * size - cells.start) / cells.step))
        low, high = cells[first] - chunk * size, cells[end - 1] - chunk * size
        yield chunk, slice(low, high + 1, cells.step), slice(first, end)
        first = end
