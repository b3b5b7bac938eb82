"""Room: what a sweep has found, on disk as zarr v3; the only importer of zarr.

A store opens with plain `xarray.open_zarr(url)`. One task owns one chunk of every array
and writes it whole, so two writers never meet; a file appears by renaming, never half
written; every byte is under a checksum. Whether a cell is there is said by its outcome,
never by a file's existence.

    StoreError              something about a store
    ├── PlaceUnusable       no store can be kept at this address (worker.places)
    ├── StoreMissing        there is none at that place
    ├── StoreConflict       another sweep, or another cut of this one, is there already
    └── StoreDamaged        what is there cannot be read back
"""

import hashlib
import threading
import warnings
from collections.abc import Iterable, Mapping
from typing import Any, Final, Literal

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import ZstdCodec
from zarr.core.buffer import default_buffer_prototype
from zarr.core.sync import sync
from zarr.errors import GroupNotFoundError, ZarrUserWarning

from kernel.params import KERNEL_VERSION
from worker import layout
from worker.marks import clear_cancelled, is_cancelled, set_cancelled, sweep_leftovers
from worker.places import StoreError, open_store, remove
from worker.plan import Chunk, Plan
from worker.spec import AXES, SweepSpec

__all__ = [
    "StoreConflict",
    "StoreDamaged",
    "StoreError",
    "StoreMissing",
    "check_chunk",
    "checksum",
    "chunk_shape",
    "clear_cancelled",
    "create",
    "is_cancelled",
    "read_attrs",
    "read_chunk",
    "read_coordinates",
    "read_slice",
    "remove",
    "set_cancelled",
    "sweep_leftovers",
    "verify",
    "write_chunk",
]  # fmt: skip

_CODEC: Final = ZstdCodec(level=3, checksum=True)
_consolidating = threading.Lock()

Index = int | slice
_EVERYTHING: Final = slice(None)


class StoreMissing(StoreError):
    """There is no store at that place."""


class StoreConflict(StoreError):
    """What is stored there is not what was to be stored there."""


class StoreDamaged(StoreError):
    """Stored bytes cannot be read back."""


def create(url: str, spec: SweepSpec, plan: Plan, attrs: Mapping[str, Any] | None = None) -> None:
    """Lay out an empty store for `spec`, cut as `plan` says, with `attrs` beside our own.

    Does nothing if this very store is complete already, and mends one whose creation was
    interrupted. Raises `StoreConflict` if something else is there. For the same bytes from
    the same specification, `attrs` must hold no time of day.
    """
    identity: dict[str, Any] = {"job": spec.job_id(KERNEL_VERSION), "chunk_shape": list(plan.chunk_shape)}
    if _already_there(url, identity):
        return
    store = open_store(url, read_only=False)
    group = zarr.open_group(store, mode="a", zarr_format=3)
    for coordinate in layout.COORDINATES:
        _create_coordinate(group, coordinate, spec)
    for array in layout.arrays(spec):
        _create_array(group, array, spec, plan)
    group.attrs.put({**_provenance(spec), **(attrs or {}), **identity})
    # The last step: whoever finds consolidated metadata finds a complete store.
    with _consolidating, warnings.catch_warnings():
        warnings.simplefilter("ignore", ZarrUserWarning)
        zarr.consolidate_metadata(store, zarr_format=3)


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
    return _checksum(group, chunk)


def checksum(url: str, chunk: Chunk) -> str:
    """SHA-256 over the chunk's stored bytes in all arrays, 64 hex digits; absent ones count too."""
    return _checksum(_open(url, "r"), chunk)


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
) -> dict[str, NDArray[Any]]:
    """Part of some arrays, by grid index; touches only the chunks it needs.

    A whole number drops its dimension, a slice keeps it; flights (or state fields) come last.
    Raises `StoreMissing`, `StoreDamaged`, or `IndexError` outside the grid.
    """
    group = _open(url, "r")
    where = (direction, xi, omega, gamma)
    return {name: _read(_array(group, name), where) for name in names}


def read_chunk(url: str, chunk: Chunk, names: Iterable[str]) -> dict[str, NDArray[Any]]:
    """A block of cells anywhere in the grid; each array is of chunk.shape + its extra dimension."""
    _, xi, omega, gamma = chunk.slices
    return read_slice(url, names, direction=chunk.direction, xi=xi, omega=omega, gamma=gamma)


def read_coordinates(url: str) -> dict[str, NDArray[Any]]:
    """`xi`, `omega`, `gamma` as float64 and `direction` as text, each (n,)."""
    group = _open(url, "r")
    return {coordinate.name: _read(_array(group, coordinate.name), ()) for coordinate in layout.COORDINATES}


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


def _already_there(url: str, identity: Mapping[str, Any]) -> bool:
    try:
        found = read_attrs(url)
    except StoreMissing:
        return False
    if found.get("job") != identity["job"]:
        raise StoreConflict(f"{url}: holds job {found.get('job')}, not {identity['job']}")
    if found.get("chunk_shape") != identity["chunk_shape"]:
        rule = f"is cut into chunks of {found.get('chunk_shape')}, not {identity['chunk_shape']}"
        raise StoreConflict(f"{url}: {rule}; plan with chunk_shape=store.chunk_shape(url)")
    return True


def _provenance(spec: SweepSpec) -> dict[str, Any]:
    return {
        "Conventions": "CF-1.11",
        "title": spec.name or "bouncing spring",
        "kernel_version": KERNEL_VERSION,
        "model": spec.model.kind,
        "spec": spec.as_submitted(),
    }


def _create_coordinate(group: zarr.Group, coordinate: layout.Coordinate, spec: SweepSpec) -> None:
    name = coordinate.name
    # Variable-length text: zarr has no stable form for the fixed-length one.
    values = (
        np.array(spec.directions, dtype=np.dtypes.StringDType())
        if name == "direction"
        else spec.axis_values(name).astype("<f8")
    )
    array = group.create_array(
        name, shape=values.shape, chunks=values.shape, dtype=values.dtype, compressors=_CODEC,
        dimension_names=(name,), attributes=coordinate.attrs, overwrite=True,
    )  # fmt: skip
    array[:] = values


def _create_array(group: zarr.Group, array: layout.Array, spec: SweepSpec, plan: Plan) -> None:
    length = layout.sizes(spec)
    extra = tuple(length[dim] for dim in array.extra_dims)
    group.create_array(
        array.name, shape=(*spec.shape, *extra), chunks=(1, *plan.chunk_shape, *extra), dtype=array.dtype,
        fill_value=array.fill, compressors=_CODEC, dimension_names=array.dims, attributes=array.attrs,
        overwrite=True,
    )  # fmt: skip


def _array(group: zarr.Group, name: str) -> zarr.Array[Any]:
    found = group[name]
    if not isinstance(found, zarr.Array):
        raise StoreDamaged(f"{group.store}: '{name}' is no array")
    return found


def _names(group: zarr.Group) -> list[str]:
    """The stored arrays in the order they are written."""
    order = (*layout.RECORD, layout.END_STATE, layout.OUTCOME)
    return [array.name for array in order if array.name in group]


def _read(array: zarr.Array[Any], where: tuple[Index, ...]) -> NDArray[Any]:
    try:
        return np.asarray(array[where or ...])
    except (RuntimeError, ValueError) as error:  # what codecs raise for bytes that are not theirs
        trouble = str(error)
    raise StoreDamaged(f"{array.store_path}: cannot be read back: {trouble}")


def _chunk_shape(group: zarr.Group) -> tuple[int, ...]:
    return _array(group, layout.OUTCOME.name).chunks[1:]


def _check_owns(group: zarr.Group, url: str, chunk: Chunk) -> None:
    """Two tasks in one stored chunk would lose data: a task's chunk is exactly one of the store's."""
    grid = _array(group, layout.OUTCOME.name).shape[1:]
    spans = (chunk.xi, chunk.omega, chunk.gamma)
    for axis, (low, high), size, n in zip(AXES, spans, _chunk_shape(group), grid, strict=True):
        if low % size or high != min(low + size, n):
            rule = f"chunk {chunk.index} spans {axis} {low} to {high}, but chunks here are {size} long"
            raise StoreConflict(f"{url}: {rule}; plan with chunk_shape=store.chunk_shape(url)")


def _checksum(group: zarr.Group, chunk: Chunk) -> str:
    digest = hashlib.sha256()
    starts = (chunk.direction, chunk.xi[0], chunk.omega[0], chunk.gamma[0])
    place = [start // size for start, size in zip(starts, (1, *_chunk_shape(group)), strict=True)]
    for name in _names(group):
        array = _array(group, name)
        key = array.metadata.encode_chunk_key((*place, *(0,) * (array.ndim - len(place))))
        stored = sync(group.store.get(f"{array.path}/{key}", default_buffer_prototype()))
        content = b"" if stored is None else stored.to_bytes()
        digest.update(f"{name} {len(content) if stored is not None else 'absent'}\n".encode())
        digest.update(content)
    return digest.hexdigest()
