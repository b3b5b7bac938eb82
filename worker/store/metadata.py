"""The metadata and coordinates of a store, as zarr writes them: in worker, only this module imports zarr."""

import json
from collections.abc import Mapping
from typing import Any, Final

import zarr
from numpy.typing import NDArray
from zarr.codecs import ZstdCodec
from zarr.core.buffer import Buffer
from zarr.storage import MemoryStore

from worker.store.backend import ROOT
from worker.store.encoding import LEVEL
from worker.study.layout import Layout, flat_attributes

_CODEC: Final = ZstdCodec(level=LEVEL, checksum=True)


def metadata_of(layout: Layout, attrs: Mapping[str, Any] | None) -> dict[str, bytes]:
    """Metadata and coordinates of a store with this layout, by key; `attrs` as given to `create`."""
    buffers: dict[str, Buffer] = {}
    group = zarr.open_group(MemoryStore(buffers), mode="w", zarr_format=3)
    for dim, values in layout.coordinates.items():
        _create_along(group, dim, dim, values, layout.coordinate_attrs.get(dim, {}))
    for name, code in layout.codes.items():
        _create_along(group, name, code.dim, code.values, code.attrs)
    for array in layout.arrays:
        chunk, inner = layout.chunk_shape(array), layout.inner_shape(array)
        group.create_array(
            array.name, shape=layout.shape(array), dtype=array.dtype, fill_value=array.fill,
            compressors=_CODEC, chunks=inner or chunk, shards=chunk if inner else None,
            chunk_key_encoding={"name": "default", "separator": "."},
            dimension_names=array.dims, attributes=layout.array_attrs(array),
        )  # fmt: skip
    group.attrs.put({**flat_attributes({**layout.attributes, **(attrs or {}), **layout.identity})})
    content = {key: buffer.to_bytes() for key, buffer in buffers.items()}
    return content | {ROOT: _consolidated(content)}


def _create_along(
    group: zarr.Group, name: str, dim: str, values: NDArray[Any], attrs: Mapping[str, Any]
) -> None:
    array = group.create_array(
        name, shape=values.shape, chunks=values.shape, dtype=values.dtype, compressors=_CODEC,
        dimension_names=(dim,), attributes=dict(attrs),
    )  # fmt: skip
    array[:] = values


def _consolidated(content: Mapping[str, bytes]) -> bytes:
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
    return json.dumps(root, indent=zarr.config.get("json_indent")).encode()
