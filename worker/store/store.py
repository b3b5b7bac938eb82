"""Results of a study as a zarr v3 store, which `xarray.open_zarr(url)` opens.

One task owns one chunk of every array and writes it whole, so no two tasks write the same file. Files appear
by renaming, once they are whole and on the disk, and checksums cover every byte. A cell is computed if its
`outcome` is not `missing`.
"""

import math
import time
from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.errors import GroupNotFoundError

from worker.schema import Array, Layout, structured_attributes
from worker.store import chunks
from worker.store.backend import ROOT, in_bucket, make_partial_folder, open_store, read_key
from worker.store.chunks import HasSlices, Index, Stored, fsync_files, key, write_keys
from worker.store.encoding import ArrayForm, encode
from worker.store.errors import ChunkCoords, StoreConflict, StoreDamaged, StoreMissing
from worker.store.metadata import empty_store
from worker.store.reader import OUTCOME, forms_of, read_cells, root_of

#: How long a process assumes that a bucket's store still exists, and for how many stores. A store
#: removed meanwhile may get chunks for this long; the same study stored there again has the same bytes.
REMEMBERED_SECONDS: Final = 5.0
MOST_REMEMBERED: Final = 256
_recent: dict[str, tuple[float, Mapping[str, ArrayForm]]] = {}


def create(url: str, layout: Layout, attrs: Mapping[str, Any] | None = None) -> None:
    """Create an empty store, with `attrs` added to the layout's attributes.

    Completes a store whose creation was interrupted, and repairs wrong metadata. Raises
    `StoreConflict` if the store holds another job or has other chunks. `attrs` must not contain a time of
    day: the same layout must give the same bytes.
    """
    _check_identity(url, layout)
    repair_metadata(url, layout, attrs)


def repair_metadata(url: str, layout: Layout, attrs: Mapping[str, Any] | None = None) -> list[str]:
    """Rewrite metadata and coordinates that differ from the layout's; return the keys rewritten."""
    expected = metadata_of(layout, attrs)
    wrong = [name for name, content in expected.items() if read_key(url, name) != content]
    # The root comes last: a store with consolidated metadata is complete.
    wrong.sort(key=lambda name: name == ROOT)
    make_partial_folder(url)
    if wrong:
        write_keys(url, {name: expected[name] for name in wrong})
        fsync_files(url, wrong)
    return wrong


def metadata_of(layout: Layout, attrs: Mapping[str, Any] | None = None) -> dict[str, bytes]:
    """Metadata and coordinates of a store with this layout, by key; `attrs` as given to `create`."""
    return {name: content.to_bytes() for name, content in empty_store(layout, attrs or {}).items()}


def check_chunk(url: str, chunk: HasSlices, arrays: Iterable[Array]) -> None:
    """Raise the StoreError that `write_chunk` would raise: missing, damaged, or chunks of another shape.

    arrays: the study's stored arrays; a store that says otherwise is damaged.
    """
    forms = _forms(url)
    if any(array.name not in forms or forms[array.name].dtype != array.dtype for array in arrays):
        raise StoreDamaged(f"{url}: the store's metadata are not those of its specification")
    _owned_coords(forms, url, chunk)


def write_chunk(url: str, chunk: HasSlices, record: Mapping[str, NDArray[Any]]) -> Stored:
    """Store one chunk of every array.

    record: every array of the store by name, in the order of its layout (`outcome` last), each of shape
    chunk.shape + its extra dimensions. Writing the same record again gives the same bytes. Each file is whole
    and synced before it has its name; `sync_folders` syncs the names. Raises `StoreMissing`, `StoreDamaged`,
    or `StoreConflict` if the chunk is not one of the store's.
    """
    forms = _forms(url)
    coords = _owned_coords(forms, url, chunk)
    lengths = [span.stop - span.start for span in chunk.slices]
    contents = {}
    for name, array in record.items():
        form = forms[name]
        contents[name] = encode(form, array.reshape(*lengths, *form.shape[len(lengths) :]), coords)
    keys = {name: key(name, len(forms[name].dims), coords) for name in record}
    try:
        files = {keys[name]: content for name, content in contents.items()}
        write_keys(url, files)
    except FileNotFoundError:
        raise StoreMissing(f"{url}: no store here") from None
    return Stored(chunks.digest(contents.items()), sum(map(len, contents.values())))


def _forms(url: str) -> Mapping[str, ArrayForm]:
    """The forms of a store's arrays. For a bucket they are kept for a moment, to save a request."""
    if not in_bucket(url):
        return forms_of(root_of(url))
    seen, forms = _recent.get(url, (-math.inf, {}))
    if time.monotonic() - seen > REMEMBERED_SECONDS:
        forms = forms_of(root_of(url))
        _recent[url] = time.monotonic(), forms
        if len(_recent) > MOST_REMEMBERED:
            del _recent[next(iter(_recent))]
    return forms


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
    return read_cells(url, names, where, complete, forms)


def read_chunk(
    url: str, chunk: HasSlices, names: Iterable[str], *, complete: bool = False
) -> dict[str, NDArray[Any]]:
    """A block of cells anywhere in the grid, each array of shape chunk.shape + its extra dimensions.

    `complete` and errors as in `read_slice`.
    """
    block = read_cells(url, names, chunk.slices, complete)
    return {
        name: array.reshape(*chunk.shape, *array.shape[len(chunk.slices) :]) for name, array in block.items()
    }


def read_coordinates(url: str) -> dict[str, NDArray[Any]]:
    """The coordinates of every cell dimension, each (n,): float64, or text for `direction`."""
    group = _open(url)
    return {dim: _values(_array(group, dim)) for dim in _cell_dims(group)}


def read_attrs(url: str) -> dict[str, Any]:
    """The store's attributes with their parts: the layout's and those given to `create`."""
    return structured_attributes(_open(url).attrs)


def chunk_shape(url: str) -> tuple[int, ...]:
    """The plan's chunk shape, which reproduces the plan."""
    return tuple(read_attrs(url)["chunk_shape"])


def _open(url: str) -> zarr.Group:
    group, failure = None, ""
    try:
        group = zarr.open_group(open_store(url, read_only=True), mode="r", zarr_format=3)
    except (FileNotFoundError, GroupNotFoundError):
        pass
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        failure = f"{type(error).__name__}: {error}"
    # Raised outside the `except` block, so that zarr's error is not its context: an error that a worker
    # returns is pickled with its context, and zarr's cannot be.
    if failure:
        raise StoreDamaged(f"{url}: the store's metadata cannot be read: {failure}")
    if group is None:
        raise StoreMissing(f"{url}: no store here")
    if group.metadata.consolidated_metadata is None:
        raise StoreMissing(f"{url}: the store's creation was interrupted; create it again")
    return group


def _check_identity(url: str, layout: Layout) -> None:
    """Raise StoreConflict if there is a store with another identity."""
    identity = layout.identity
    try:
        attrs = read_attrs(url)
    except (StoreMissing, StoreDamaged):
        return
    if attrs.get("job") != identity["job"]:
        raise StoreConflict(f"{url}: holds job {attrs.get('job')}, not {identity['job']}")
    if attrs.get("chunk_shape") != identity["chunk_shape"]:
        rule = f"is cut into chunks of {attrs.get('chunk_shape')}, not {identity['chunk_shape']}"
        raise StoreConflict(f"{url}: {rule}; plan with chunk_shape=store.chunk_shape(url)")


def _array(group: zarr.Group, name: str) -> zarr.Array[Any]:
    array = group[name]
    if not isinstance(array, zarr.Array):
        raise StoreDamaged(f"{group.store}: '{name}' is not an array")
    return array


def _cell_dims(group: zarr.Group) -> tuple[str, ...]:
    metadata: Any = _array(group, OUTCOME).metadata
    return tuple(metadata.dimension_names)


def _values(array: zarr.Array[Any]) -> NDArray[Any]:
    try:
        return np.asarray(array[...])
    except (RuntimeError, ValueError) as error:  # what codecs raise for damaged bytes
        failure = str(error)
    raise StoreDamaged(f"{array.path}: cannot be decoded: {failure}")


def _owned_coords(forms: Mapping[str, ArrayForm], url: str, chunk: HasSlices) -> ChunkCoords:
    """Coordinates of a task's chunk in the grid of chunks.

    Raises StoreConflict unless it is exactly one chunk of the store: two tasks that write to the same
    stored chunk would overwrite each other's cells.
    """
    outcome = forms[OUTCOME]
    for dim, span, size, n in zip(outcome.dims, chunk.slices, outcome.chunks, outcome.shape, strict=True):
        if span.start % size or span.stop != min(span.start + size, n):
            rule = f"a chunk spans {dim} {span.start} to {span.stop}, but chunks here are {size} long"
            raise StoreConflict(f"{url}: {rule}; plan with chunk_shape=store.chunk_shape(url)")
    return tuple(span.start // size for span, size in zip(chunk.slices, outcome.chunks, strict=True))
