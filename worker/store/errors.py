"""What can be wrong with a store.

StoreError              something about a store
├── PlaceUnusable       no store can be kept at this address
├── StoreMissing        there is none at that place
├── StoreConflict       another sweep, or another cut of this one, is there already
└── StoreDamaged        what is there cannot be read back
"""

from typing import NamedTuple


class ChunkCoords(NamedTuple):
    """A chunk's address in the grid of chunks."""

    direction: int
    xi: int
    omega: int
    gamma: int


class StoreError(Exception):
    """Something about a store."""


class PlaceUnusable(StoreError):
    """No store can be kept at this address; says why."""


class StoreMissing(StoreError):
    """There is no store at that place."""


class StoreConflict(StoreError):
    """What is stored there is not what was to be stored there."""


class StoreDamaged(StoreError):
    """Stored bytes cannot be read back, or are gone; `places` says which chunks, where it is a chunk."""

    places: tuple[ChunkCoords, ...] = ()
