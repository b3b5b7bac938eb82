"""An empty store: its metadata and coordinates, the same bytes every time."""

import threading
import warnings
from collections.abc import Mapping
from typing import Any, Final

import zarr
from zarr.codecs import ZstdCodec
from zarr.core.buffer import Buffer
from zarr.errors import ZarrUserWarning
from zarr.storage import MemoryStore

from worker.schema import Array, Layout

_CODEC: Final = ZstdCodec(level=3, checksum=True)
_consolidating = threading.Lock()


def empty_store(layout: Layout, attrs: Mapping[str, Any]) -> dict[str, Buffer]:
    """Every file or object of a store without chunks by its address, with `attrs` beside the layout's own."""
    content: dict[str, Buffer] = {}
    store = MemoryStore(content)
    group = zarr.open_group(store, mode="w", zarr_format=3)
    for dim in layout.coordinates:
        _create_coordinate(group, dim, layout)
    for array in layout.arrays:
        _create_array(group, array, layout)
    group.attrs.put({**layout.attributes, **attrs, **layout.identity})
    with _consolidating, warnings.catch_warnings():
        warnings.simplefilter("ignore", ZarrUserWarning)
        zarr.consolidate_metadata(store, zarr_format=3)
    return content


def _create_coordinate(group: zarr.Group, dim: str, layout: Layout) -> None:
    values = layout.coordinates[dim]
    array = group.create_array(
        dim, shape=values.shape, chunks=values.shape, dtype=values.dtype, compressors=_CODEC,
        dimension_names=(dim,), attributes=dict(layout.coordinate_attrs.get(dim, {})),
    )  # fmt: skip
    array[:] = values


def _create_array(group: zarr.Group, array: Array, layout: Layout) -> None:
    group.create_array(
        array.name, shape=layout.shape(array), chunks=layout.chunk_shape(array), dtype=array.dtype,
        fill_value=array.fill, compressors=_CODEC, dimension_names=array.dims, attributes=array.attrs,
    )  # fmt: skip
