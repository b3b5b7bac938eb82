"""Results of a study as a zarr v3 store, which `xarray.open_zarr(url)` opens.

One task owns one chunk of every array and writes it whole, so no two tasks write the same file. Files appear
by renaming, once they are whole and on the disk, and checksums cover every byte. A cell is computed if its
`outcome` is not `missing`.
"""

import json
import math
import time
from collections.abc import Iterable, Mapping
from concurrent.futures import wait
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from numpy.typing import NDArray

from worker import files
from worker.store import backend
from worker.store.backend import ROOT, ChunkCoords, StoreConflict, StoreDamaged, StoreMissing, in_bucket
from worker.store.encoding import LEVEL, ArrayForm, chunk_key, encode
from worker.store.reader import OUTCOME, forms_of, read_attrs, root_of
from worker.study import Array, Chunk, Layout
from worker.study.layout import flat_attributes

#: How long a process assumes that a bucket's store still exists, and for how many stores. A store
#: removed meanwhile may get chunks for this long.
REMEMBERED_SECONDS: Final = 5.0
MOST_REMEMBERED: Final = 256
_recent: dict[str, tuple[float, Mapping[str, ArrayForm]]] = {}


def create(url: str, layout: Layout, attrs: Mapping[str, Any] | None = None) -> None:
    """Create an empty store, with `attrs` added to the layout's attributes.

    Completes a store whose creation was interrupted, and repairs wrong metadata. Raises
    `StoreConflict` if the store holds another job or has other chunks. `attrs` must not contain a time of
    day: the same layout must give the same bytes.
    """
    identity = stored = layout.identity
    with suppress(StoreMissing, StoreDamaged):
        stored = read_attrs(url)
    job, chunk_shape = stored.get("job"), stored.get("chunk_shape")
    if job != identity.get("job"):
        raise StoreConflict(f"{url}: holds job {job}, not {identity['job']}")
    if chunk_shape != identity.get("chunk_shape"):
        raise _other_chunks(url, f"is cut into chunks of {chunk_shape}, not {identity['chunk_shape']}")
    repair_metadata(url, layout, attrs)


def _other_chunks(url: str, rule: str) -> StoreConflict:
    return StoreConflict(f"{url}: {rule}; plan with the store's chunk_shape")


def repair_metadata(url: str, layout: Layout, attrs: Mapping[str, Any] | None = None) -> list[str]:
    """Rewrite metadata and coordinates that differ from the layout's; return the keys rewritten."""
    expected = metadata_of(layout, attrs)
    wrong = [key for key, content in expected.items() if backend.read_key(url, key) != content]
    # The root comes last: a store with consolidated metadata is complete.
    wrong.sort(key=lambda name: name == ROOT)
    if wrong:
        if not in_bucket(url) and Path(url).is_file():
            Path(url).rename(f"{url}.replaced")
        backend.make_place(url)
        write_keys(url, {name: expected[name] for name in wrong})
        root = Path(url)
        folders = {above for name in wrong for above in (root / name).parents if above.is_relative_to(root)}
        fsync(url, [*folders, root.parent])
    return wrong


def metadata_of(layout: Layout, attrs: Mapping[str, Any] | None = None) -> dict[str, bytes]:
    """Metadata and coordinates of a store with this layout, by key; `attrs` as given to `create`."""
    # zarr takes half a second to load, and few processes create or check a store.
    import zarr  # noqa: PLC0415
    from zarr.codecs import ZstdCodec  # noqa: PLC0415
    from zarr.core.buffer import Buffer  # noqa: PLC0415
    from zarr.storage import MemoryStore  # noqa: PLC0415

    buffers: dict[str, Buffer] = {}
    group = zarr.open_group(MemoryStore(buffers), mode="w", zarr_format=3)
    codec = ZstdCodec(level=LEVEL, checksum=True)

    def create_along(name: str, dim: str, values: NDArray[Any], attrs: Mapping[str, Any]) -> None:
        array = group.create_array(
            name, shape=values.shape, chunks=values.shape, dtype=values.dtype, compressors=codec,
            dimension_names=(dim,), attributes=dict(attrs),
        )  # fmt: skip
        array[:] = values

    for dim, values in layout.coordinates.items():
        create_along(dim, dim, values, layout.coordinate_attrs.get(dim, {}))
    for name, code in layout.codes.items():
        create_along(name, code.dim, code.values, code.attrs)
    for array in layout.arrays:
        chunk, inner = layout.chunk_shape(array), layout.inner_shape(array)
        group.create_array(
            array.name, shape=layout.shape(array), dtype=array.dtype, fill_value=array.fill,
            compressors=codec, chunks=inner or chunk, shards=chunk if inner else None,
            chunk_key_encoding={"name": "default", "separator": "."},
            dimension_names=array.dims, attributes=layout.array_attrs(array),
        )  # fmt: skip
    group.attrs.put({**flat_attributes({**layout.attributes, **(attrs or {}), **layout.identity})})
    content = {key: buffer.to_bytes() for key, buffer in buffers.items()}
    return content | {ROOT: _consolidated(content, zarr.config.get("json_indent"))}


def _consolidated(content: Mapping[str, bytes], indent: int | None) -> bytes:
    """The root's metadata with those of every array, as `zarr.consolidate_metadata` writes them.

    That function warns that consolidated metadata is not part of the zarr v3 specification, and warning
    filters are process-wide: a thread of the service must not suppress the warning.
    """
    root = json.loads(content[ROOT])
    names = sorted(path.removesuffix(f"/{ROOT}") for path in content if path.endswith(f"/{ROOT}"))
    arrays = {name: json.loads(content[f"{name}/{ROOT}"]) for name in names}
    consolidated = {"kind": "inline", "must_understand": False, "metadata": arrays}
    # The order of the fields is that of zarr, with which existing stores were written.
    root |= {"consolidated_metadata": consolidated, "node_type": root.pop("node_type")}
    return json.dumps(root, indent=indent).encode()


def check_chunk(url: str, chunk: Chunk, arrays: Iterable[Array]) -> None:
    """Raise the StoreError that `write_chunk` would raise: missing, damaged, or chunks of another shape.

    arrays: the study's stored arrays; a store with others is damaged.
    """
    forms = _forms(url)
    if any(array.name not in forms or forms[array.name].dtype != array.dtype for array in arrays):
        raise StoreDamaged(f"{url}: the store's metadata are not those of its specification")
    _owned_coords(forms, url, chunk)


def write_chunk(url: str, chunk: Chunk, record: Mapping[str, NDArray[Any]]) -> None:
    """Store one chunk of every array.

    record: every array of the store by name, in the order of its layout (`outcome` last), each of shape
    chunk.shape + its extra dimensions. Writing the same record again gives the same bytes. Each file is
    complete and synced before it gets its name; `sync_folders` syncs the names. Raises `StoreMissing`,
    `StoreDamaged`, or `StoreConflict` if the chunk is not one of the store's.
    """
    forms = _forms(url)
    coords = _owned_coords(forms, url, chunk)
    lengths = [span.stop - span.start for span in chunk.slices]
    contents = {}
    for name, array in record.items():
        form = forms[name]
        values = array.reshape(*lengths, *form.shape[len(lengths) :])
        contents[chunk_key(name, len(form.dims), coords)] = encode(form, values, coords)
    try:
        write_keys(url, contents)
    except FileNotFoundError:
        raise StoreMissing(f"{url}: no store here") from None


def _forms(url: str) -> Mapping[str, ArrayForm]:
    """The forms of a store's arrays; those of a bucket are remembered for a moment, to save requests."""
    if not in_bucket(url):
        return forms_of(root_of(url))
    seen, forms = _recent.get(url, (-math.inf, {}))
    if time.monotonic() - seen > REMEMBERED_SECONDS:
        forms = forms_of(root_of(url))
        _recent[url] = time.monotonic(), forms
        if len(_recent) > MOST_REMEMBERED:
            del _recent[next(iter(_recent))]
    return forms


def _owned_coords(forms: Mapping[str, ArrayForm], url: str, chunk: Chunk) -> ChunkCoords:
    """Coordinates of a task's chunk in the grid of chunks. Raises StoreConflict."""
    # Two tasks that write to the same stored chunk would overwrite each other's cells.
    outcome = forms[OUTCOME]
    for dim, span, size, n in zip(outcome.dims, chunk.slices, outcome.chunks, outcome.shape, strict=True):
        if span.start % size or span.stop != min(span.start + size, n):
            rule = f"a chunk spans {dim} {span.start} to {span.stop}, but chunks here are {size} long"
            raise _other_chunks(url, rule)
    return tuple(span.start // size for span, size in zip(chunk.slices, outcome.chunks, strict=True))


def _keys_of(layout: Layout, chunk: Chunk) -> list[str]:
    """The keys of a chunk, in the order they are written."""
    coords = layout.coords(chunk.slices)
    return [chunk_key(array.name, len(array.dims), coords) for array in layout.arrays]


def keys_of(layout: Layout, chunks: Iterable[Chunk]) -> list[str]:
    """The keys of a store with these chunks, the root's metadata last."""
    metadata = [key for key in metadata_of(layout) if key != ROOT]
    return [*metadata, *(key for chunk in chunks for key in _keys_of(layout, chunk)), ROOT]


def restore(url: str, contents: Mapping[str, bytes], layout: Layout) -> None:
    """Write a whole store from its bytes. The root comes last: with it the store exists."""
    backend.make_place(url)
    write_keys(url, {key: contents[key] for key in sorted(contents, key=lambda key: key == ROOT)})
    sync_folders(url, layout)


def discard(url: str, layout: Layout, chunk: Chunk) -> None:
    """Remove a chunk's stored bytes, `outcome` first, so that its cells always read as missing."""
    for key in reversed(_keys_of(layout, chunk)):
        backend.delete(url, key)


def sync_folders(url: str, layout: Layout) -> None:
    """Sync the names of written chunks to disk; their contents are synced when written.

    Call it once for many chunks: it syncs the arrays' folders.
    """
    with suppress(FileNotFoundError):  # the store is being removed, or was
        fsync(url, [Path(url, array.name) for array in layout.arrays])


def fsync(url: str, folders: Iterable[Path]) -> None:
    """Sync the names in folders of a store to disk. A bucket's acknowledged objects are durable."""
    if not in_bucket(url):
        list(backend.pool().map(files.sync, folders))


def write_keys(url: str, contents: Mapping[str, bytes]) -> None:
    """Write keys of a store, each completely or not at all, and the last one after all others."""
    keys = list(contents)
    if in_bucket(url):
        list(backend.pool().map(lambda key: backend.put(url, key, contents[key]), keys[:-1]))
        backend.put(url, keys[-1], contents[keys[-1]])
        return
    writing = [backend.pool().submit(backend.write_partial, url, contents[key]) for key in keys]
    wait(writing)
    try:
        for key, partial in zip(keys, [future.result() for future in writing], strict=True):
            backend.place(url, partial, key)
    except OSError:
        for future in writing:
            if future.exception() is None:
                future.result().unlink(missing_ok=True)
        raise
