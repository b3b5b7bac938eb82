"""What a study has computed, on disk as zarr v3.

A store opens with plain `xarray.open_zarr(url)`. One task owns one chunk of every array
and writes it whole, so two writers never meet; a file appears by renaming, never half
written; every byte is under a checksum. Whether a cell is there is told by its outcome,
never by a file's existence.
"""

from collections.abc import Iterable, Mapping
from typing import Any, Literal

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.core.sync import sync
from zarr.errors import GroupNotFoundError

from worker.schema import Layout
from worker.store import chunks
from worker.store.backend import open_store, read_key
from worker.store.chunks import HasSlices, Index, fsync_files, key
from worker.store.errors import ChunkCoords, StoreConflict, StoreDamaged, StoreMissing
from worker.store.metadata import empty_store
from worker.store.reader import OUTCOME, ROOT, read_cells


def create(url: str, layout: Layout, attrs: Mapping[str, Any] | None = None) -> None:
    """Lay out an empty store, with `attrs` beside the layout's own attributes.

    Does nothing if this very store is complete already, and repairs one whose creation was
    interrupted. Raises `StoreConflict` if something else is there. For the same bytes from
    the same layout, `attrs` must hold no time of day.
    """
    if not _already_there(url, layout.identity):
        repair_metadata(url, layout, attrs)


def repair_metadata(url: str, layout: Layout, attrs: Mapping[str, Any] | None = None) -> list[str]:
    """Put right everything in a store but its chunks: metadata, coordinates. Returns what was not right."""
    right = empty_store(layout, attrs or {})
    wrong = [address for address, content in right.items() if read_key(url, address) != content.to_bytes()]
    # The root comes last: whoever finds consolidated metadata finds a complete store.
    wrong.sort(key=lambda address: address == ROOT)
    store = open_store(url, read_only=False)
    for address in wrong:
        sync(store.set(address, right[address]))
    fsync_files(url, wrong)
    return wrong


def check_chunk(url: str, chunk: HasSlices) -> None:
    """Raise what `write_chunk` would raise for a store that is missing, damaged or cut otherwise."""
    _owned_coords(_open(url, "r"), url, chunk)


def write_chunk(url: str, chunk: HasSlices, record: Mapping[str, NDArray[Any]]) -> str:
    """Store one chunk of every array and return the checksum of the bytes now stored.

    record: every array of the store by name, in the order of its layout (`outcome` last), each of shape
    chunk.shape + its extra dimensions. Writing the same record again gives the same bytes.
    """
    group = _open(url, "r+")
    coords = _owned_coords(group, url, chunk)
    names = [(name, len(_array(group, name).shape)) for name in record]
    for name, array in record.items():
        # Without this a chunk of nothing but fill values would have no file, and no checksum.
        stored = _array(group, name).with_config({"write_empty_chunks": True})
        lengths = [span.stop - span.start for span in chunk.slices]
        stored[chunk.slices] = array.reshape(*lengths, *stored.shape[len(lengths) :])
    fsync_files(url, [key(name, dims, coords) for name, dims in names])
    return chunks.checksum(url, names, coords)


def read_slice(
    url: str,
    names: Iterable[str],
    *,
    complete: bool = False,
    **where: Index,
) -> dict[str, NDArray[Any]]:
    """Part of some arrays, by index along the cell dimensions; touches only the chunks it needs.

    `complete`: everything was written, so what is not there is damage and not still to come.

    A whole number drops its dimension, a slice (its step, if any, above 0) keeps it; flights (or state
    fields) come last. Cells without an outcome yet read as fill values throughout.
    Raises `StoreMissing`, `StoreDamaged`, or `IndexError` outside the grid.
    """
    return read_cells(url, names, where, complete)


def read_chunk(
    url: str, chunk: HasSlices, names: Iterable[str], *, complete: bool = False
) -> dict[str, NDArray[Any]]:
    """A block of cells anywhere in the grid; each array is of chunk.shape + its extra dimensions."""
    block = read_cells(url, names, chunk.slices, complete)
    return {
        name: array.reshape(*chunk.shape, *array.shape[len(chunk.slices) :]) for name, array in block.items()
    }


def read_coordinates(url: str) -> dict[str, NDArray[Any]]:
    """The values along every dimension of a cell, each (n,): numbers as float64, `direction` as text."""
    group = _open(url, "r")
    return {dim: _read(_array(group, dim)) for dim in _cell_dims(group)}


def read_attrs(url: str) -> dict[str, Any]:
    """The store's attributes: the specification, versions, and what its creator added."""
    return dict(_open(url, "r").attrs)


def chunk_shape(url: str) -> tuple[int, ...]:
    """Cells of a chunk along every dimension that is cut, for planning the same cut again."""
    return tuple(read_attrs(url)["chunk_shape"])


def _open(url: str, mode: Literal["r", "r+"]) -> zarr.Group:
    group, trouble = None, ""
    try:
        group = zarr.open_group(open_store(url, read_only=mode == "r"), mode=mode, zarr_format=3)
    except (FileNotFoundError, GroupNotFoundError):
        pass
    except (ValueError, KeyError, TypeError) as error:
        trouble = f"{type(error).__name__}: {error}"
    # Raised out here, because zarr's errors, kept as ours' context, would not survive the way back
    # from a worker.
    if trouble:
        raise StoreDamaged(f"{url}: the store's metadata cannot be read: {trouble}")
    if group is None:
        raise StoreMissing(f"{url}: no store here")
    if group.metadata.consolidated_metadata is None:
        raise StoreMissing(f"{url}: the store was never finished; create it again")
    return group


def _already_there(url: str, wanted: Mapping[str, Any]) -> bool:
    try:
        found = read_attrs(url)
    except (StoreMissing, StoreDamaged):
        return False
    if found.get("job") != wanted["job"]:
        raise StoreConflict(f"{url}: holds job {found.get('job')}, not {wanted['job']}")
    if found.get("chunk_shape") != wanted["chunk_shape"]:
        rule = f"is cut into chunks of {found.get('chunk_shape')}, not {wanted['chunk_shape']}"
        raise StoreConflict(f"{url}: {rule}; plan with chunk_shape=store.chunk_shape(url)")
    return True


def _array(group: zarr.Group, name: str) -> zarr.Array[Any]:
    found = group[name]
    if not isinstance(found, zarr.Array):
        raise StoreDamaged(f"{group.store}: '{name}' is no array")
    return found


def _cell_dims(group: zarr.Group) -> tuple[str, ...]:
    metadata: Any = _array(group, OUTCOME).metadata
    return tuple(metadata.dimension_names)


def _read(array: zarr.Array[Any]) -> NDArray[Any]:
    try:
        return np.asarray(array[...])
    except (RuntimeError, ValueError) as error:  # what codecs raise for bytes that are not theirs
        trouble = str(error)
    raise StoreDamaged(f"{array.path}: cannot be read back: {trouble}")


def _owned_coords(group: zarr.Group, url: str, chunk: HasSlices) -> ChunkCoords:
    """Where a task's chunk lies in the grid of chunks.

    Raises StoreConflict unless it is one of the store's: two tasks in one stored chunk would lose data.
    """
    outcome = _array(group, OUTCOME)
    dims = zip(_cell_dims(group), chunk.slices, outcome.chunks, outcome.shape, strict=True)
    for dim, span, size, n in dims:
        if span.start % size or span.stop != min(span.start + size, n):
            rule = f"a chunk spans {dim} {span.start} to {span.stop}, but chunks here are {size} long"
            raise StoreConflict(f"{url}: {rule}; plan with chunk_shape=store.chunk_shape(url)")
    return tuple(span.start // size for span, size in zip(chunk.slices, outcome.chunks, strict=True))
