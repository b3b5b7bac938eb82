"""Computes a chunk of a sweep, stores it, and returns a report; repeated, it writes the same bytes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kernel.line import LineRun
from kernel.params import Cell, Line, Outcome, Start
from kernel.stopping import check
from worker import store
from worker.study.chunks import Chunk, ChunkReport, PredecessorMissing
from worker.sweep import schema
from worker.sweep.plan import cells_at_once
from worker.sweep.protocols import Ramp
from worker.sweep.specification import AXES, SweepSpec, start_of
from worker.work import FIRST_STEPS, Work, plate_of

_Arrays = dict[str, NDArray[Any]]


def run_chunk(spec: SweepSpec, chunk: Chunk, store_url: str) -> ChunkReport:
    """Compute every cell of `chunk` and store it; the store must exist.

    Continues from the chunk's checkpoint, if there is one. Raises `ChunkCancelled`, `ChunkPaused` after
    the slice of `OPTIONS`, `PredecessorMissing`, or a `store.StoreError`. In each case the chunk's cells stay
    missing and the chunk can be run again.
    """
    work = Work(store_url, chunk, tuple(schema.arrays(spec)), schema.sizes(spec))
    starts = starts_of(spec, chunk, store_url)
    lines = _in_visiting_order(spec, chunk, work.record)
    cells = _in_visiting_order(spec, chunk, cells_of(spec, chunk))
    indices = list(np.ndindex(lines["outcome"].shape[:2]))
    groups = [indices] if cells_at_once(spec) > 1 else [[index] for index in indices]  # lines side by side
    for group in groups[work.done :]:
        group_cells = {axis: np.concatenate([cells[axis][index] for index in group]) for axis in AXES}
        computed = compute(spec, work, group_cells, [starts.get(index) for index in group])
        for name, array in lines.items():
            for index, part in zip(group, np.split(getattr(computed, name), len(group)), strict=True):
                array[index] = part
        work.finish(last=group is groups[-1])
    return work.write()


def compute(spec: SweepSpec, work: Work, cells: _Arrays, starts: list[Start | None]) -> Line:
    """Compute a line to its end. Raises as `Work.compute`; any error has a note with the cells."""
    try:
        return work.compute(line_run(spec, [cells[name] for name in Cell._fields], starts))
    except Exception as error:
        spans = [f"{name} {cells[name][0]:g} to {cells[name][-1]:g}" for name in Cell._fields]
        error.add_note(f"in the cells {', '.join(spans)}")
        raise


def run_cells(
    spec: SweepSpec, cells: Sequence[NDArray[np.float64]], start: Start | None, settle: int | None = None
) -> Line:
    """Compute a line of cells as a sweep does.

    cells: gamma, omega, xi (n,), in the order of the ramp. start: on a ramp, the state before the first cell;
    None starts from rest. settle: plate periods before the window, if not the sweep's. Raises
    KernelInputError for values that the kernel does not accept.
    """
    return to_end(line_run(spec, cells, [start], settle))


def to_end(run: LineRun) -> Line:
    """Compute a line to its end. Raises `stopping.Stopped`."""
    while not run.advance(FIRST_STEPS):
        check()
    return run.line


def line_run(
    spec: SweepSpec, cells: Sequence[NDArray[Any]], starts: list[Start | None], settle: int | None = None
) -> LineRun:
    """Lines of cells as a sweep computes them, at their beginning; on ramps one line for each start.

    cells: gamma, omega, xi (n,).
    """
    carry = spec.ramp_axis is not None
    usual, observe = spec.window
    return LineRun(
        *cells,
        plate=plate_of(spec.model, *cells),
        carry=carry,
        settle=usual if settle is None else settle,
        observe=observe,
        keep=spec.keep,
        micro_flight=spec.micro_flight,
        certify=spec.certifies,
        settle_until=spec.settles_until,
        exponents=spec.exponents,
        start=starts if carry else None,
    )


def starts_of(
    spec: SweepSpec, chunk: Chunk, store_url: str, *, complete: bool = False
) -> dict[tuple[int, int], Start | None]:
    """The start of each line of a ramp's chunk, by its place there; empty if all lines start from rest.

    complete: as in `store.read_chunk`. Raises PredecessorMissing, or a `store.StoreError`.
    """
    layer = _layer_before(spec, chunk)
    if layer is None:
        return _starts_on_cycles(spec, chunk)
    stored = store.read_chunk(store_url, layer, ("end_state", "outcome"), complete=complete)
    previous = _in_visiting_order(spec, layer, stored | cells_of(spec, layer))
    if np.any(previous["outcome"] == Outcome.MISSING):
        before = f"chunk {chunk.after} of the ramp, which is not stored"
        raise PredecessorMissing(f"chunk {chunk.index} continues {before}")
    return {index: _start_at(previous, (*index, 0)) for index in np.ndindex(previous["outcome"].shape[:2])}


def _starts_on_cycles(spec: SweepSpec, chunk: Chunk) -> dict[tuple[int, int], Start | None]:
    """The start of each line in the first chunk of a ramp, on a cycle if the specification says so."""
    cycle = spec.protocol.start if isinstance(spec.protocol, Ramp) else None
    if cycle is None:
        return {}
    cells = _in_visiting_order(spec, chunk, cells_of(spec, chunk))
    indices = np.ndindex(cells["gamma"].shape[:2])
    return {index: start_of(_cell(cells, (*index, 0)), cycle.periods) for index in indices}


def _start_at(arrays: _Arrays, index: tuple[int, ...]) -> Start | None:
    """The start of the next cell on a ramp; None, from rest, after a diverged cell."""
    if arrays["outcome"][index] == Outcome.DIVERGED:
        return None
    return Start(np.ascontiguousarray(arrays["end_state"][index]), _cell(arrays, index))


def _cell(arrays: _Arrays, index: tuple[int, ...]) -> Cell:
    return Cell(*(float(arrays[name][index]) for name in Cell._fields))


def _layer_before(spec: SweepSpec, chunk: Chunk) -> Chunk | None:
    """The cells, one per line, that precede the chunk's first cells on the ramp."""
    axis, direction = spec.ramp_axis, chunk.direction or 0
    if axis is None:
        return None
    spans = dict(zip(AXES, chunk.spans, strict=True))
    low, high = spans[axis]
    position = high if spec.directions[direction] == "down" else low - 1
    if not 0 <= position < len(spec.axis_values(axis)):
        if direction == 0:
            return None
        # A "down" ramp starts from the end of "up", whose last cell has the same parameters.
        direction, position = direction - 1, high - 1
    spans[axis] = position, position + 1
    return Chunk(chunk.index, tuple(spans.values()), direction)


def cells_of(spec: SweepSpec, chunk: Chunk) -> _Arrays:
    """The parameters of every cell by axis, arrays of shape chunk.shape."""
    values = [spec.axis_values(axis)[slice(*span)] for axis, span in zip(AXES, chunk.spans, strict=True)]
    return dict(zip(AXES, np.meshgrid(*values, indexing="ij"), strict=True))


def _in_visiting_order(spec: SweepSpec, chunk: Chunk, arrays: _Arrays) -> _Arrays:
    """Views of a chunk's arrays, whose third axis has the cells of a line in the order of the ramp.

    From rest all cells form one line. On a ramp each pair of the other two parameters has a line.
    """
    if spec.ramp_axis is None:
        return {name: array.reshape(1, 1, chunk.cells, *array.shape[3:]) for name, array in arrays.items()}
    axis, step = AXES.index(spec.ramp_axis), -1 if spec.directions[chunk.direction or 0] == "down" else 1
    return {name: np.moveaxis(array, axis, 2)[:, :, ::step] for name, array in arrays.items()}
