"""Room: what a sweep has found, on disk as zarr v3; the only importer of zarr.

A store opens with plain `xarray.open_zarr(url)`. One task owns one chunk of every array
and writes it whole, so two writers never meet; a file appears by renaming, never half
written; every byte is under a checksum. Whether a cell is there is said by its outcome,
never by a file's existence.
"""

from collections.abc import Iterable, Mapping
from typing import Any, Final, Literal

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.core.sync import sync
from zarr.errors import GroupNotFoundError

from worker import schema
from worker.plan import Chunk, Plan
from worker.spec import AXES, SweepSpec
from worker.store import chunks
from worker.store.backend import open_store, read_key
from worker.store.chunks import Index, chunk_coords, fsync_files, key
from worker.store.errors import StoreConflict, StoreDamaged, StoreMissing
from worker.store.metadata import identity, skeleton
from worker.store.reader import ROOT, read_cells

_EVERYTHING: Final = slice(None)


def create(url: str, spec: SweepSpec, plan: Plan, attrs: Mapping[str, Any] | None = None) -> None:
    """Lay out an empty store for `spec`, cut as `plan` says, with `attrs` beside our own.

    Does nothing if this very store is complete already, and mends one whose creation was
    interrupted. Raises `StoreConflict` if something else is there. For the same bytes from
    the same specification, `attrs` must hold no time of day.
    """
    if not _already_there(url, identity(spec, plan)):
        repair_metadata(url, spec, plan, attrs)


def repair_metadata(
    url: str, spec: SweepSpec, plan: Plan, attrs: Mapping[str, Any] | None = None
) -> list[str]:
    """Put right everything in a store but its chunks: metadata, coordinates. Returns what was not right."""
    right = skeleton(spec, plan, attrs or {})
    wrong = [address for address, content in right.items() if read_key(url, address) != content.to_bytes()]
    # The root comes last: whoever finds consolidated metadata finds a complete store.
    wrong.sort(key=lambda address: address == ROOT)
    store = open_store(url, read_only=False)
    for address in wrong:
        sync(store.set(address, right[address]))
    fsync_files(url, wrong)
    return wrong


def check_chunk(url: str, chunk: Chunk) -> None:
    """Raise what `write_chunk` would raise for a store that is missing, damaged or cut otherwise."""
    _check_owns(_open(url, "r"), url, chunk)


def write_chunk(url: str, chunk: Chunk, record: Mapping[str, NDArray[Any]]) -> str:
    """Store one chunk of every array and return the checksum of the bytes now stored.

    record: an array of shape chunk.shape + (flights or state fields, if it has them) by name.
    Writing the same record again gives the same bytes.
    """
    group = _open(url, "r+")
    _check_owns(group, url, chunk)
    for name in _names(group):
        # Without this a chunk of nothing but fill values would have no file, and no checksum.
        array = _array(group, name).with_config({"write_empty_chunks": True})
        array[chunk.slices] = record[name][np.newaxis]
    place = chunk_coords(chunk, _chunk_shape(group))
    fsync_files(url, [key(name, place) for name in _names(group)])
    return chunks.checksum(url, _names(group), place)


def checksum(url: str, chunk: Chunk) -> str:
    """SHA-256 over the chunk's stored bytes in all arrays, 64 hex digits; absent ones count too."""
    group = _open(url, "r")
    return chunks.checksum(url, _names(group), chunk_coords(chunk, _chunk_shape(group)))


def verify(url: str, chunk: Chunk, expected: str) -> bool:
    """Whether the chunk's stored bytes are still those `write_chunk` reported."""
    return checksum(url, chunk) == expected


def read_slice(
    url: str,
    names: Iterable[str],
    *,
    direction: Index = _EVERYTHING,
    xi: Index = _EVERYTHING,
    omega: Index = _EVERYTHING,
    gamma: Index = _EVERYTHING,
    complete: bool = False,
) -> dict[str, NDArray[Any]]:
    """Part of some arrays, by grid index; touches only the chunks it needs.

    `complete`: everything was written, so what is not there is damage and not still to come.

    A whole number drops its dimension, a slice (its step, if any, above 0) keeps it; flights (or state
    fields) come last. Cells without an outcome yet read as fill values throughout.
    Raises `StoreMissing`, `StoreDamaged`, or `IndexError` outside the grid.
    """
    return read_cells(url, names, (direction, xi, omega, gamma), complete)


def read_chunk(
    url: str, chunk: Chunk, names: Iterable[str], *, complete: bool = False
) -> dict[str, NDArray[Any]]:
    """A block of cells anywhere in the grid; each array is of chunk.shape + its extra dimension."""
    block = dict(zip(AXES, chunk.slices[1:], strict=True))
    return read_slice(url, names, direction=chunk.direction, **block, complete=complete)


def read_coordinates(url: str) -> dict[str, NDArray[Any]]:
    """`xi`, `omega`, `gamma` as float64 and `direction` as text, each (n,)."""
    group = _open(url, "r")
    return {coordinate.name: _read(_array(group, coordinate.name)) for coordinate in schema.COORDINATES}


def read_attrs(url: str) -> dict[str, Any]:
    """The store's attributes: the specification, versions, and what its creator added."""
    return dict(_open(url, "r").attrs)


def chunk_shape(url: str) -> tuple[int, int, int]:
    """Cells of a chunk along (xi, omega, gamma), for planning the same cut again."""
    xi, omega, gamma = _chunk_shape(_open(url, "r"))
    return xi, omega, gamma


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


def _names(group: zarr.Group) -> list[str]:
    """The stored arrays in the order they are written."""
    order = (*schema.RECORD, schema.END_STATE, schema.OUTCOME)
    return [array.name for array in order if array.name in group]


def _read(array: zarr.Array[Any]) -> NDArray[Any]:
    try:
        return np.asarray(array[...])
    except (RuntimeError, ValueError) as error:  # what codecs raise for bytes that are not theirs
        trouble = str(error)
    raise StoreDamaged(f"{array.path}: cannot be read back: {trouble}")


def _chunk_shape(group: zarr.Group) -> tuple[int, ...]:
    return _array(group, schema.OUTCOME.name).chunks[1:]


def _check_owns(group: zarr.Group, url: str, chunk: Chunk) -> None:
    """Two tasks in one stored chunk would lose data: a task's chunk is exactly one of the store's."""
    grid = _array(group, schema.OUTCOME.name).shape[1:]
    spans = (chunk.xi, chunk.omega, chunk.gamma)
    for axis, (low, high), size, n in zip(AXES, spans, _chunk_shape(group), grid, strict=True):
        if low % size or high != min(low + size, n):
            rule = f"chunk {chunk.index} spans {axis} {low} to {high}, but chunks here are {size} long"
            raise StoreConflict(f"{url}: {rule}; plan with chunk_shape=store.chunk_shape(url)")
