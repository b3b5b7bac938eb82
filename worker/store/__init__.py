"""Stores of results, zarr v3: the public interface.

Code outside this package uses only the names listed here. In worker, only this package imports zarr.
"""

from worker.store.backend import (
    ROOT,
    UNREACHABLE,
    check_address,
    created_at,
    in_bucket,
    is_writable,
    names_in,
    read_key,
    remove,
    rename_for_deletion,
)
from worker.store.cancel_flag import clear_cancelled, is_cancelled, set_cancelled, sweep_leftovers
from worker.store.checkpoints import checkpoints_in, read_checkpoint, remove_checkpoint, write_checkpoint
from worker.store.chunks import Stored, checksum_of, discard, find_corrupt, stored_sizes, sync_folders
from worker.store.encoding import ArrayForm, forms_in
from worker.store.errors import (
    ChunkCoords,
    PlaceUnusable,
    StoreConflict,
    StoreDamaged,
    StoreError,
    StoreMissing,
)
from worker.store.marker import MARKER, read_marker, write_marker
from worker.store.reader import read_file, stored_forms
from worker.store.store import (
    check_chunk,
    chunk_shape,
    create,
    metadata_of,
    read_attrs,
    read_chunk,
    read_coordinates,
    read_slice,
    repair_metadata,
    write_chunk,
)

__all__ = [
    "MARKER",
    "ROOT",
    "UNREACHABLE",
    "ArrayForm",
    "ChunkCoords",
    "PlaceUnusable",
    "StoreConflict",
    "StoreDamaged",
    "StoreError",
    "StoreMissing",
    "Stored",
    "check_address",
    "check_chunk",
    "checkpoints_in",
    "checksum_of",
    "chunk_shape",
    "clear_cancelled",
    "create",
    "created_at",
    "discard",
    "find_corrupt",
    "forms_in",
    "in_bucket",
    "is_cancelled",
    "is_writable",
    "metadata_of",
    "names_in",
    "read_attrs",
    "read_checkpoint",
    "read_chunk",
    "read_coordinates",
    "read_file",
    "read_key",
    "read_marker",
    "read_slice",
    "remove",
    "remove_checkpoint",
    "rename_for_deletion",
    "repair_metadata",
    "set_cancelled",
    "stored_forms",
    "stored_sizes",
    "sweep_leftovers",
    "sync_folders",
    "write_checkpoint",
    "write_chunk",
    "write_marker",
]
