"""Reads cells of a store: reads and decompresses chunk files directly, and only the needed parts of shards.

For small chunks zarr's overhead is many times the cost of decompression. This module reads only the format
that `metadata.empty_store` defines.
"""

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from worker.store.backend import ROOT, in_bucket, read_key, read_parts
from worker.store.chunks import Index, key, threads
from worker.store.encoding import (
    ArrayForm,
    check_file,
    decode,
    form_of,
    position,
    same,
    seal_of,
    spans_of,
)
from worker.store.errors import ChunkCoords, StoreDamaged, StoreMissing

OUTCOME: Final = "outcome"


class _Part(NamedTuple):
    """The requested cells in one inner chunk (the whole chunk if it is no shard)."""

    coords: ChunkCoords  # of the chunk
    inner: tuple[int, ...]  # position in the shard
    in_chunk: tuple[slice, ...]  # their positions in the inner chunk
    in_result: tuple[slice, ...]  # their positions in the result


def read_cells(
    url: str,
    names: Iterable[str],
    where: Mapping[str, Index] | tuple[slice, ...],
    complete: bool,
    forms: Mapping[str, ArrayForm] | None = None,
) -> dict[str, NDArray[Any]]:
    """The implementation of `store.read_slice` and `store.read_chunk`.

    where: indices along some cell dimensions by name, or slices along all of them in order.
    """
    arrays = stored_forms(url, forms)
    index = where if isinstance(where, tuple) else _in_order(arrays[OUTCOME].dims, where)
    names = list(dict.fromkeys(names))
    parts = list(_parts(arrays[OUTCOME], index))
    reading = _Reading(url, arrays, index)
    # `outcome` is written last: without it the chunk is not computed, and the others are not read.
    present = reading.take([(OUTCOME, part) for part in parts], lenient=not complete)
    others = [name for name in names if name != OUTCOME]
    reading.take([(name, part) for name in others for _, part in present], lenient=False)
    if reading.damaged:
        error = StoreDamaged(next(iter(reading.damaged.values())))
        error.chunks = tuple(reading.damaged)
        raise error
    return {name: reading.result(name) for name in names}


def _in_order(dims: tuple[str, ...], where: Mapping[str, Index]) -> tuple[Index, ...]:
    if unknown := set(where) - set(dims):
        raise IndexError(f"there is no dimension {', '.join(sorted(unknown))}; there are {', '.join(dims)}")
    return tuple(where.get(dim, slice(None)) for dim in dims)


class _Reading:
    """Collects the requested cells and the damaged chunks."""

    def __init__(self, url: str, arrays: Mapping[str, ArrayForm], where: tuple[Index, ...]) -> None:
        self._url, self._arrays, self._where = url, arrays, where
        self._cells: dict[str, NDArray[Any]] = {}
        self.damaged: dict[ChunkCoords, str] = {}

    def take(self, parts: list[tuple[str, _Part]], lenient: bool) -> list[tuple[str, _Part]]:
        """Read parts of arrays and return the existing ones. Missing ones are damage, unless `lenient`."""
        files: dict[str, list[tuple[str, _Part]]] = {}
        for name, part in parts:
            form = self._arrays[name]
            files.setdefault(key(name, len(form.dims), part.coords), []).append((name, part))
        present = []
        for (chunk_key, wanted), contents in zip(files.items(), self._contents(files), strict=True):
            coords = wanted[0][1].coords
            if isinstance(contents, ValueError):
                self.damaged.setdefault(coords, f"{chunk_key}: cannot be decoded: {contents}")
            elif contents is not None:
                present += wanted
                for (name, part), content in zip(wanted, contents, strict=True):
                    self._put(name, part, chunk_key, content)
            elif not lenient:
                self.damaged.setdefault(coords, f"{chunk_key}: is missing")
        return present

    def _contents(
        self, files: Mapping[str, list[tuple[str, _Part]]]
    ) -> Iterator[list[bytes] | ValueError | None]:
        """The bytes of each file's requested parts; requests to a bucket run concurrently."""
        run = threads().map if in_bucket(self._url) else map
        return iter(run(self._content, files, files.values()))

    def _content(self, chunk_key: str, wanted: list[tuple[str, _Part]]) -> list[bytes] | ValueError | None:
        form = self._arrays[wanted[0][0]]
        if not form.sharded:
            content = read_key(self._url, chunk_key)
            return None if content is None else [content] * len(wanted)
        index = read_parts(self._url, chunk_key, [(-form.index_bytes, form.index_bytes)])
        if index is None:
            return None
        inner = [part.inner + (0,) * (len(form.dims) - len(part.inner)) for _, part in wanted]
        try:
            return read_parts(self._url, chunk_key, spans_of(form, index[0], inner))
        except ValueError as error:
            return error

    def result(self, name: str) -> NDArray[Any]:
        """The requested cells of an array, without the dimensions indexed by an integer."""
        drop = tuple(0 if isinstance(index, int) else slice(None) for index in self._where)
        return self._all(name)[drop]

    def _put(self, name: str, part: _Part, chunk_key: str, content: bytes) -> None:
        try:
            form = self._arrays[name]
            values = decode(form, content, position(form, part.coords, part.inner))
        except (RuntimeError, ValueError) as error:  # what codecs raise for damaged bytes
            self.damaged.setdefault(part.coords, f"{chunk_key}: cannot be decoded: {error}")
        else:
            self._all(name)[part.in_result] = values[part.in_chunk]

    def _all(self, name: str) -> NDArray[Any]:
        if name not in self._cells:
            array = self._arrays[name]
            cells = [len(_range(n, index)) for n, index in zip(array.shape, self._where, strict=False)]
            extra = array.shape[len(cells) :]
            self._cells[name] = np.full((*cells, *extra), array.fill, array.dtype)
        return self._cells[name]


def stored_forms(url: str, forms: Mapping[str, ArrayForm] | None) -> Mapping[str, ArrayForm]:
    """The forms of a store's arrays: `forms` if given, which the store's metadata must match.

    Raises StoreMissing, StoreDamaged.
    """
    stored = forms_of(root_of(url))
    if forms is None:
        return stored
    if wrong := [name for name, form in forms.items() if not same(form, stored.get(name))]:
        raise StoreDamaged(f"the store's metadata are not those of its specification: {', '.join(wrong)}")
    return forms


def read_file(url: str, key: str, forms: Mapping[str, ArrayForm]) -> bytes | None:
    """The stored bytes of an array's chunk; None if there are none. Raises StoreDamaged."""
    name, _, rest = key.partition("/")
    form, content = forms[name], read_key(url, key)
    if content is None:
        return None
    coords = tuple(int(number) for number in rest.split(".")[1:])
    try:
        check_file(form, content, coords)
    except (ValueError, IndexError) as failure:
        error = StoreDamaged(f"{key}: cannot be decoded: {failure}")
        error.chunks = (coords[: len(forms[OUTCOME].dims)],)
        raise error from None
    return content


def root_of(url: str) -> bytes:
    content = read_key(url, ROOT)
    if content is None:
        raise StoreMissing(f"{url}: no store here")
    return content


@lru_cache(maxsize=32)  # few, as `root` holds the specification, which can be long
def forms_of(root: bytes) -> dict[str, ArrayForm]:
    """The arrays of cells by name, from the root's consolidated metadata."""
    try:
        group = json.loads(root)
        consolidated = group.get("consolidated_metadata")
        if not consolidated:
            raise StoreMissing("the store's creation was interrupted; create it again")
        job = group["attributes"].get("job")
        arrays = {
            name: form_of(metadata, seal_of(job, name))
            for name, metadata in consolidated["metadata"].items()
            if name not in metadata["dimension_names"]  # a coordinate
        }
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise StoreDamaged(f"the store's metadata cannot be read: {type(error).__name__}: {error}") from None
    if OUTCOME not in arrays:
        raise StoreDamaged("the store's metadata cannot be read: no outcomes in it")
    return arrays


def _parts(array: ArrayForm, where: tuple[Index, ...]) -> Iterator[_Part]:
    """The inner chunks that contain the cells at these indices."""
    axes = [
        list(_spans(_range(n, index), size))
        for n, size, index in zip(array.shape, array.inner, where, strict=True)
    ]
    counts = array.inner_counts
    for spans in product(*axes):
        numbers, in_chunk, in_result = zip(*spans, strict=True)
        coords, inner = zip(*map(divmod, numbers, counts), strict=True)
        yield _Part(coords, inner, in_chunk, in_result)


def _range(length: int, index: Index) -> range:
    """The positions along an axis of `length` that an index selects; raises IndexError outside it."""
    positions = range(length)[index]
    return range(positions, positions + 1) if isinstance(positions, int) else positions


def _spans(cells: range, size: int) -> Iterator[tuple[int, slice, slice]]:
    """Chunks of `size` along an axis that contain some of `cells`: (index, slice of it, slice of cells)."""
    first = 0
    while first < len(cells):
        chunk = cells[first] // size
        end = min(len(cells), math.ceil(((chunk + 1) * size - cells.start) / cells.step))
        low, high = cells[first] - chunk * size, cells[end - 1] - chunk * size
        yield chunk, slice(low, high + 1, cells.step), slice(first, end)
        first = end
