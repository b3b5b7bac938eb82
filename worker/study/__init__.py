"""The interface that every kind of study implements. Imports neither numba nor any kind of study."""

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
    """A kind of study: pure functions, and the module of its task.

    Ledger, queue, executors, store, progress, cancelling and repair use nothing else of a study.
    """

    #: The specification from plain JSON values. Raises a `SpecError` that names every broken rule.
    parse: Callable[[object], Any]
    #: (spec, chunk_shape=None, longest=LONGEST_SECONDS): the chunks, by default of a shape that the study
    #: chooses. In a study of many chunks they may take up to about `longest` core-seconds each.
    plan: Callable[..., Plan]
    #: (spec, chunk_shape): the layout of the store.
    variables: Callable[[Any, tuple[int, ...]], Layout]
    #: (spec, plan): the cost; computes and allocates nothing.
    estimate: Callable[[Any, Plan], Cost]
    #: The module that only workers import. Its `run_chunk(spec, chunk, store_url)` computes one chunk, stores
    #: it and returns its `ChunkReport`; repeated, it writes the same bytes. Raises a `TaskError` or a
    #: `store.StoreError`. After the slice of `study.chunks.OPTIONS` it should store its progress and raise
    #: `ChunkPaused`; then it is called again.
    task: str
    #: (spec, plan): the number of cells that a study with `layout.COMPUTED` is sure to compute; else 0.
    first_cells: Callable[[Any, Plan], int] = lambda spec, plan: 0
