"""Reads cells of a store: reads and decompresses chunk files directly, and only the needed parts of shards.

For small chunks zarr's overhead is many times the cost of decompression. This module reads only the format
that `store.metadata_of` defines.
"""

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from worker.store import backend
from worker.store.backend import ROOT, ChunkCoords, StoreDamaged, StoreMissing, in_bucket
from worker.store.encoding import ArrayForm, check_file, chunk_key, decode, form_of, same, spans_of
from worker.study import Chunk
from worker.study.layout import structured_attributes

OUTCOME: Final = "outcome"

_MISSING: Final = "is missing"
#: A file is read whole, in one request, if at least this part of its inner chunks is needed.
MOST_PARTS: Final = 0.5

Index = int | slice
#: Length of an array, of its chunks and of their inner chunks, along each cell dimension.
_Sizes = tuple[tuple[int, int, int], ...]


class _Part(NamedTuple):
    """The requested cells in one inner chunk, or in a chunk that is not a shard."""

    inner: tuple[int, ...]  # position in the shard
    position: tuple[int, ...]  # in the array, in inner chunks
    in_chunk: tuple[slice, ...]  # their positions in the inner chunk
    in_result: tuple[slice, ...]  # their positions in the result


def read_slice(
    url: str,
    names: Iterable[str],
    *,
    complete: bool = False,
    forms: Mapping[str, ArrayForm] | None = None,
    **where: Index,
) -> dict[str, NDArray[Any]]:
    """Part of some arrays, by index along the cell dimensions; reads only the needed chunks.

    An integer drops its dimension, a slice (its step above 0) keeps it; extra dimensions, such as flights,
    come last. Cells that are not computed read as fill values in every array.

    complete: whether every chunk has been written, so that a missing one is damage.
    forms: `forms_in` of the study's layout, which the store's metadata must match.
    Raises `StoreMissing`, `StoreDamaged`, or `IndexError` outside the grid.
    """
    arrays = stored_forms(url, forms)
    dims = arrays[OUTCOME].dims
    return _read(url, arrays, names, tuple(where.get(dim, slice(None)) for dim in dims), complete)


def read_chunk(
    url: str, chunk: Chunk, names: Iterable[str], *, complete: bool = False
) -> dict[str, NDArray[Any]]:
    """A block of cells anywhere in the grid, each array of shape chunk.shape + its extra dimensions.

    `complete` and errors as in `read_slice`.
    """
    block = _read(url, stored_forms(url, None), names, chunk.slices, complete)
    return {
        name: array.reshape(*chunk.shape, *array.shape[len(chunk.slices) :]) for name, array in block.items()
    }


def _read(
    url: str, arrays: Mapping[str, ArrayForm], names: Iterable[str], index: tuple[Index, ...], complete: bool
) -> dict[str, NDArray[Any]]:
    names = tuple(dict.fromkeys(names))
    parts = _parts_of({name: arrays[name] for name in (OUTCOME, *names)}, index)
    chunks = dict.fromkeys(parts[OUTCOME])
    cells = {name: _fill_values(arrays[name], index) for name in (OUTCOME, *names)}
    damaged: dict[ChunkCoords, str] = {}

    def take(names: Iterable[str], lenient: bool) -> None:
        """Read the chunks of some arrays. A missing chunk is damage; if `lenient`, it is not computed."""
        files = [
            (chunk_key(name, len(arrays[name].dims), coords), name, coords)
            for name in names
            for coords in chunks
        ]

        def read(file: tuple[str, str, ChunkCoords]) -> str | None:
            key, name, coords = file
            return _read_file(url, key, arrays[name], parts[name][coords], cells[name])

        # Requests to a bucket run concurrently.
        failures = backend.pool().map(read, files) if in_bucket(url) else map(read, files)
        for (key, _, coords), failure in zip(files, failures, strict=True):
            if failure == _MISSING and lenient:
                del chunks[coords]
            elif failure is not None:
                damaged.setdefault(coords, f"{key}: {failure}")

    # `outcome` is written last: without it the chunk is not computed, and the others are not read.
    take([OUTCOME], not complete)
    take([name for name in names if name != OUTCOME], False)
    if damaged:
        raise StoreDamaged(next(iter(damaged.values())), tuple(damaged))
    drop = tuple(0 if isinstance(i, int) else slice(None) for i in index)
    return {name: cells[name][drop] for name in names}


def _read_file(
    url: str, key: str, form: ArrayForm, parts: Sequence[_Part], cells: NDArray[Any]
) -> str | None:
    """Put the parts of an array's chunk into `cells`; returns the fault of a damaged or missing chunk."""
    try:
        contents = _contents(url, key, form, [part.inner for part in parts])
        if contents is None:
            return _MISSING
        first = (0,) * (len(form.dims) - len(parts[0].position))  # along other dimensions
        for part, content in zip(parts, contents, strict=True):
            values = decode(form, content, part.position + first)
            cells[part.in_result] = values[part.in_chunk]
    except (RuntimeError, ValueError) as error:  # what codecs raise for damaged bytes
        return f"cannot be decoded: {error}"
    return None


def _contents(
    url: str, key: str, form: ArrayForm, inner: Sequence[tuple[int, ...]]
) -> Sequence[bytes] | None:
    """The bytes of some inner chunks of a file; None without one. Raises as `decode`."""
    if form.sharded and len(inner) < MOST_PARTS * math.prod(form.inner_counts):
        index = backend.read_parts(url, key, [(-form.index_bytes, form.index_bytes)])
        return index and backend.read_parts(url, key, spans_of(form, index[0], inner))
    whole = backend.read_key(url, key)
    if whole is None:
        return None
    if not form.sharded:
        return [whole]
    return [whole[offset : offset + n] for offset, n in spans_of(form, whole[-form.index_bytes :], inner)]


def _fill_values(form: ArrayForm, index: tuple[Index, ...]) -> NDArray[Any]:
    """The requested cells of an array before any is computed; an integer index keeps its dimension."""
    cells = [len(_range(n, i)) for n, i in zip(form.shape, index, strict=False)]
    return np.full((*cells, *form.shape[len(cells) :]), form.fill, form.dtype)


def stored_forms(url: str, forms: Mapping[str, ArrayForm] | None) -> Mapping[str, ArrayForm]:
    """The forms of a store's arrays; if `forms` are given, these, which the store's metadata must match.

    Raises StoreMissing, StoreDamaged.
    """
    stored = forms_of(root_of(url))
    expected = stored if forms is None else forms
    if wrong := [name for name, form in expected.items() if not same(form, stored.get(name))]:
        raise StoreDamaged(f"the store's metadata are not those of its specification: {', '.join(wrong)}")
    return expected


def read_file(url: str, key: str, forms: Mapping[str, ArrayForm], *, complete: bool = False) -> bytes | None:
    """The stored bytes of an array's chunk; None if there are none. `complete` as in `read_slice`.

    Raises StoreDamaged.
    """
    name, _, rest = key.partition("/")
    content = backend.read_key(url, key)
    coords, form = tuple(int(number) for number in rest.split(".")[1:]), forms[name]
    if content is None and not (complete and _in_grid(form, coords)):
        return None
    try:
        if content is None:
            raise ValueError(_MISSING)
        check_file(form, content, coords)
    except (RuntimeError, ValueError, IndexError) as error:
        damaged = coords[: len(forms[OUTCOME].dims)]
        raise StoreDamaged(f"{key}: cannot be decoded: {error}", (damaged,)) from None
    return content


def _in_grid(form: ArrayForm, coords: ChunkCoords) -> bool:
    counts = [-(-n // size) for n, size in zip(form.shape, form.chunks, strict=True)]
    return len(coords) == len(counts) and all(i < count for i, count in zip(coords, counts, strict=True))


def read_attrs(url: str) -> dict[str, Any]:
    """The store's attributes with their parts: the layout's and those given to `create`."""
    root = root_of(url)
    forms_of(root)  # raises for metadata that cannot be read
    return structured_attributes(json.loads(root)["attributes"])


def root_of(url: str) -> bytes:
    content = backend.read_key(url, ROOT)
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
            name: form_of(metadata, f"{job} {name}")
            for name, metadata in consolidated["metadata"].items()
            if name not in metadata["dimension_names"]  # a coordinate
        }
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise StoreDamaged(f"the store's metadata cannot be read: {type(error).__name__}: {error}") from None
    if OUTCOME not in arrays:
        raise StoreDamaged("the store's metadata cannot be read: no outcomes in it")
    return arrays


def _parts_of(
    arrays: Mapping[str, ArrayForm], where: tuple[Index, ...]
) -> dict[str, dict[ChunkCoords, list[_Part]]]:
    """The inner chunks of each array that contain the cells at these indices, by chunk."""
    by_sizes: dict[_Sizes, dict[ChunkCoords, list[_Part]]] = {}
    by_name = {}
    for name, form in arrays.items():
        sizes = tuple(zip(form.shape, form.chunks, form.inner, strict=True))[: len(where)]
        if sizes not in by_sizes:
            by_sizes[sizes] = _parts(sizes, where)
        by_name[name] = by_sizes[sizes]
    if any(parts.keys() != by_name[OUTCOME].keys() for parts in by_sizes.values()):
        raise StoreDamaged("the store's metadata cannot be read: its arrays have different chunks")
    return by_name


def _parts(sizes: _Sizes, where: tuple[Index, ...]) -> dict[ChunkCoords, list[_Part]]:
    axes = [
        [(*divmod(span[0], chunk // inner), *span) for span in _spans(_range(n, index), inner)]
        for (n, chunk, inner), index in zip(sizes, where, strict=True)
    ]
    by_chunk: dict[ChunkCoords, list[_Part]] = {}
    for spans in product(*axes):
        coords, *part = zip(*spans, strict=True)
        by_chunk.setdefault(coords, []).append(_Part(*part))
    return by_chunk


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
