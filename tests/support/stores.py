"""What tests ask of a store's chunks."""

from worker import store
from worker.schema import Layout
from worker.store import chunks
from worker.store.chunks import HasSlices


def checksum(url: str, layout: Layout, chunk: HasSlices) -> str:
    return chunks.checksum(url, layout, layout.coords(chunk.slices))


def is_sound(url: str, layout: Layout, chunk: HasSlices, expected: str) -> bool:
    """Whether a chunk's stored bytes are those that were written."""
    return not list(store.find_corrupt(url, layout, [(chunk, expected)]))
