"""Room: what a sweep has found, on disk as zarr v3: the one public face of the store.

Everything outside this package uses what is listed here; only the modules behind it import zarr.
"""

from worker.store.backend import UNREACHABLE, check_address, in_bucket, read_key, remove, set_aside
from worker.store.cancel_flag import clear_cancelled, is_cancelled, set_cancelled, sweep_leftovers
from worker.store.chunks import changed, discard, place_of
from worker.store.errors import (
    Place,
    PlaceUnusable,
    StoreConflict,
    StoreDamaged,
    StoreError,
    StoreMissing,
)
from worker.store.store import (
    check_chunk,
    checksum,
    chunk_shape,
    create,
    mend,
    read_attrs,
    read_chunk,
    read_coordinates,
    read_slice,
    verify,
    write_chunk,
)

__all__ = [
    "UNREACHABLE",
    "Place",
    "PlaceUnusable",
    "StoreConflict",
    "StoreDamaged",
    "StoreError",
    "StoreMissing",
    "changed",
    "check_address",
    "check_chunk",
    "checksum",
    "chunk_shape",
    "clear_cancelled",
    "create",
    "discard",
    "in_bucket",
    "is_cancelled",
    "mend",
    "place_of",
    "read_attrs",
    "read_chunk",
    "read_coordinates",
    "read_key",
    "read_slice",
    "remove",
    "set_aside",
    "set_cancelled",
    "sweep_leftovers",
    "verify",
    "write_chunk",
]
