"""Computes the branches of a chunk of springs and their events, and stores them."""

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kernel.cycles.events import POINTS as GRID
from kernel.cycles.events import Branch, Events, Kind, branch_and_events, join_events, rows_of
from kernel.cycles.roots import stretches
from kernel.params import KernelInputError, Outcome
from worker.orbits.schema import ARRAYS, KINDS, sizes
from worker.orbits.specification import DIMS, OrbitsSpec
from worker.study.chunks import Chunk, ChunkReport
from worker.work import Work


def run_chunk(spec: OrbitsSpec, chunk: Chunk, store_url: str) -> ChunkReport:
    """Compute every cell of `chunk` and store it, without pauses; the store must exist.

    Raises ChunkCancelled or a `store.StoreError`; then nothing of the chunk was written.
    """
    xi, omega = (spec.axis_values(axis)[span] for axis, span in zip(DIMS, chunk.slices, strict=True))
    work, began = Work(store_url, chunk, ARRAYS, sizes(spec)), time.perf_counter()
    for i, j in np.ndindex(chunk.shape):
        work.check_cancelled()
        cell = {name: array[i, j : j + 1] for name, array in work.record.items()}
        _compute(spec, float(omega[j]), float(xi[i]), cell)
    work.kernel_seconds = time.perf_counter() - began
    return work.write()


def _compute(spec: OrbitsSpec, omega: float, xi: float, cell: dict[str, NDArray[Any]]) -> None:
    """Fill in one cell: arrays (1, ...) of a record."""
    parts: list[Events] = []
    try:
        for row, periods in enumerate(spec.periods):
            branch, events = branch_and_events(omega, xi, periods, max(GRID, spec.points))
            _put_branch(branch, row, spec, cell)
            parts.append(rows_of(events, events.gamma <= spec.gamma_max))
    except KernelInputError:  # an undamped spring at resonance
        cell["outcome"][0] = Outcome.UNRESOLVED
        return
    inside = join_events(parts)
    stored = rows_of(inside, slice(spec.events))
    count = len(stored.kind)
    cell["event_count"][0] = len(inside.kind)
    cell["event_kind"][0, :count] = [1 + KINDS.index(Kind(kind)) for kind in stored.kind]
    for name in ("gamma", "bounces", "periods", "flight_time", "violations"):
        cell[f"event_{name}"][0, :count] = getattr(stored, name)
    cell["outcome"][0] = Outcome.PERIODIC


def _put_branch(branch: Branch, row: int, spec: OrbitsSpec, cell: dict[str, NDArray[Any]]) -> None:
    """Fill in one branch, thinned to the available points."""
    stored = _stored_rows(branch.gamma <= spec.gamma_max, spec.points)
    points = np.flatnonzero(stored >= 0)
    rows = stored[points]
    for name in ("gamma", "flight_time", "takeoff_phase", "elongation", "elongation_velocity",
                 "impact_velocity", "stable", "violations"):  # fmt: skip
        cell[name][0, row, points] = getattr(branch, name)[rows]
    for i, name in enumerate(("multiplier", "other_multiplier")):
        cell[name][0, row, points] = branch.multiplier[rows, i]


def _stored_rows(inside: NDArray[np.bool_], points: int) -> NDArray[np.intp]:
    """Rows of a branch to store: indices (m,), m <= points, with -1 between its parts.

    Includes the first and last row, and both ends of every part if they fit. Of more parts than fit with the
    -1 after them, some are left out.
    """
    parts = np.array(stretches(inside), np.intp).reshape(-1, 2)
    shown = np.linspace(0, len(parts) - 1, min(len(parts), (points + 1) // 2)).round().astype(np.intp)
    order = np.array([i for part in parts[shown] for i in (*range(*part), -1)][:-1], np.intp)
    if len(order) <= points:
        return order
    gaps = np.flatnonzero(order < 0)
    even = np.unique(np.concatenate([gaps, np.linspace(0, len(order) - 1, points).round().astype(np.intp)]))
    surplus = len(even) - points
    if surplus > 0:  # gaps take the place of rows
        rows = np.flatnonzero(order[even] >= 0)[1:-1]
        even = np.delete(even, rows[np.linspace(0, len(rows) - 1, surplus).round().astype(np.intp)])
    return np.asarray(order[even])
