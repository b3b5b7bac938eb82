"""Errors of stores."""

#: Position of a chunk in the grid of chunks, one index per cell dimension.
ChunkCoords = tuple[int, ...]


class StoreError(Exception):
    """Base class of a store's errors; itself: the address cannot hold a store."""


class StoreMissing(StoreError):
    """There is no store at the address, or its creation was interrupted."""


class StoreConflict(StoreError):
    """The store holds another job, or has chunks of another shape."""


class StoreDamaged(StoreError):
    """Stored bytes are missing or cannot be decoded; `chunks`: the damaged chunks, if any."""

    def __init__(self, message: str, chunks: tuple[ChunkCoords, ...] = ()) -> None:
        super().__init__(message)
        self.chunks = chunks
