"""The study `basin`: which attractor each start of a plane reaches, in every cell of a grid (docs/basins.md).

A task computes whole cells, since attractors are distinguished among all starts of a cell.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kernel.params import Cell, Line, Outcome
from worker.basins.attractors import Found, Request, find
from worker.basins.schema import BOX, LIFETIME, MAX_ATTRACTORS, OF_ATTRACTORS, basin_arrays, basin_sizes
from worker.basins.specification import BasinSpec
from worker.basins.starts import Steps, starts_of
from worker.study.chunks import Chunk, ChunkReport
from worker.sweep import AXES

_Arrays = dict[str, NDArray[Any]]


def run_chunk(spec: BasinSpec, chunk: Chunk, store_url: str) -> ChunkReport:
    """Compute every cell of `chunk` and store it; the store must exist.

    Continues from the chunk's checkpoint, if there is one. Raises `ChunkCancelled`, `ChunkPaused` after
    the slice of `study.chunks.OPTIONS`, or a `store.StoreError`.
    """
    values = [spec.axis_values(axis)[span] for axis, span in zip(AXES, chunk.slices, strict=True)]
    work = Steps(store_url, chunk, basin_arrays(spec), basin_sizes(spec))
    for index in list(np.ndindex(chunk.shape))[work.done :]:
        xi, omega, gamma = (float(axis[i]) for axis, i in zip(values, index, strict=True))
        cell = Cell(gamma, omega, xi)
        basins = find(starts_of(spec, *cell), spec, partial(_answer, spec, cell, work))
        _fill_in(spec, basins, work.record, index)
        work.finish_step()
    return work.write()


def _answer(
    spec: BasinSpec, cell: Cell, work: Steps, request: Request, reduce: Callable[[Line], _Arrays]
) -> _Arrays:
    """The answer to a request of a search, computed now or in an earlier slice."""
    cells = [np.full(len(request.states), value) for value in cell]
    return work.answer(spec, cells, reduce, **request.window())


def _fill_in(spec: BasinSpec, basins: Found, record: _Arrays, index: tuple[int, ...]) -> None:
    ids = np.where(basins.ids <= MAX_ATTRACTORS, basins.ids, 0).astype(np.uint8)
    ids = ids.reshape(spec.protocol.rows, spec.protocol.columns)
    record["attractor"][index] = ids
    for i, attractor in enumerate(basins.attractors[:MAX_ATTRACTORS]):
        for name in (row.name for row in (*OF_ATTRACTORS, LIFETIME)):
            record[name][*index, i] = getattr(attractor, name.removeprefix("attractor_"))
        if spec.exponents:
            record["lyapunov"][*index, i] = attractor.lyapunov
            record["lyapunov_error"][*index, i] = attractor.lyapunov_error
    record["attractor_count"][index] = len(basins.attractors)
    record["undecided"][index] = np.mean(ids == 0)
    record["basin_entropy"][index], record["boundary_entropy"][index] = entropies(ids)
    record["outcome"][index] = Outcome.PERIODIC if basins.attractors else Outcome.UNRESOLVED


def entropies(ids: NDArray[np.uint8]) -> tuple[float, float]:
    """Basin entropy and boundary basin entropy of a map (rows, columns) of attractors.

    Means of the entropy -sum p ln p of the attractors' shares in boxes of BOX by BOX starts: over all boxes,
    and over those with more than one attractor (Daza et al., Scientific Reports 6, 31416, 2016). Rows and
    columns beyond whole boxes do not count, nor do undecided starts. NaN without a whole box.
    """
    rows, columns = (n // BOX for n in ids.shape)
    if not rows * columns:
        return math.nan, math.nan
    sides = ids[: rows * BOX, : columns * BOX].reshape(rows, BOX, columns, BOX)
    boxes = sides.swapaxes(1, 2).reshape(rows * columns, BOX * BOX)
    counts = np.stack([(boxes == i).sum(axis=1) for i in range(1, max(int(ids.max()), 1) + 1)])
    share = counts / np.maximum(counts.sum(axis=0), 1)
    entropy = -np.where(share > 0.0, share * np.log(np.where(share > 0.0, share, 1.0)), 0.0).sum(axis=0)
    mixed = (counts > 0).sum(axis=0) > 1
    return float(entropy.mean()), float(entropy[mixed].mean()) if mixed.any() else 0.0
