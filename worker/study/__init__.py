"""What every kind of study has, whatever it computes: without numba, and of no kind itself."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from worker.study.chunks import (
    Chunk,
    ChunkCancelled,
    ChunkOptions,
    ChunkPaused,
    ChunkReport,
    Cost,
    Plan,
    PredecessorMissing,
    TaskError,
)
from worker.study.layout import Array, Layout

__all__ = [
    "Array", "Chunk", "ChunkCancelled", "ChunkOptions", "ChunkPaused", "ChunkReport", "Cost", "Layout",
    "Plan", "PredecessorMissing", "Study", "TaskError",
]  # fmt: skip


@dataclass(frozen=True)
class Study:
    """A kind of study: four pure functions, and the module of its task.

    Ledger, queue, executors, store, progress, cancelling and repair use only these.
    """

    #: The specification from plain JSON values. Raises a `SpecError` that names every broken rule.
    parse: Callable[[object], Any]
    #: (spec, chunk_shape=None, longest=LONGEST_SECONDS): the chunks, of `chunk_shape` or of a shape that the
    #: study chooses. Many chunks may be longer, up to about `longest` core-seconds each.
    plan: Callable[..., Plan]
    #: (spec, chunk_shape): the layout of the store.
    variables: Callable[[Any, tuple[int, ...]], Layout]
    #: (spec, plan): the cost; computes and allocates nothing.
    estimate: Callable[[Any, Plan], Cost]
    #: The module that only workers import, with `run_chunk(spec, chunk, store_url)`: compute one chunk, store
    #: it and return its `ChunkReport`; repeated, it writes the same bytes. Raises a `TaskError` or a
    #: `store.StoreError`. If it takes longer than the slice of `study.chunks.OPTIONS` it should store its
    #: progress and raise `ChunkPaused`: it is called again.
    task: str
    #: (spec, plan): the cells sure to be computed, of a study that fills in others (`layout.COMPUTED`).
    first_cells: Callable[[Any, Plan], int] = lambda spec, plan: 0
