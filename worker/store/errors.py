"""What can be wrong with a store.

StoreError              something is wrong with a store
├── PlaceUnusable       no store can be kept at this address
├── StoreMissing        there is no store at this address
├── StoreConflict       another study, or another cut of this one, is stored there already
└── StoreDamaged        stored bytes cannot be read back
"""

#: Where a chunk lies in the grid of chunks, one number for each cell dimension.
ChunkCoords = tuple[int, ...]


class StoreError(Exception):
    """Something is wrong with a store."""


class PlaceUnusable(StoreError):
    """No store can be kept at this address; says why."""


class StoreMissing(StoreError):
    """There is no store at this address."""


class StoreConflict(StoreError):
    """What is stored there is not what was to be stored there."""


class StoreDamaged(StoreError):
    """Stored bytes cannot be read back, or are gone; `chunks` says where, if in chunks."""

    chunks: tuple[ChunkCoords, ...] = ()
