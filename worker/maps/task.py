"""Computes a tile of an adaptive map, stores it, and returns a report; repeated, it writes the same bytes."""

import itertools
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from worker.maps.refinement import Beyond, Refinement, refine_of, surroundings
from worker.study.chunks import Chunk, ChunkReport
from worker.study.layout import COMPUTED, empty_record
from worker.sweep.schema import MODE_ARRAYS, sizes
from worker.sweep.schema import arrays as stored_arrays
from worker.sweep.specification import AXES, SweepSpec
from worker.sweep.task import cells_of, compute
from worker.work import Work

_Arrays = dict[str, NDArray[Any]]


def run_chunk(spec: SweepSpec, chunk: Chunk, store_url: str) -> ChunkReport:
    """Compute the cells that a tile needs, fill in the others, and store it; the store must exist.

    Each round of the refinement is a line. Errors and checkpoints as in `worker.sweep.task`.
    """
    arrays = tuple(stored_arrays(spec))
    work = Work(store_url, chunk, arrays, empty_record(_surrounded(spec, chunk).shape, arrays, sizes(spec)))
    return work.write(_refine_tile(spec, chunk, work))


def _refine_tile(spec: SweepSpec, chunk: Chunk, work: Work) -> _Arrays:
    """Compute the cells that a tile needs, each round of the refinement as one line, and fill in the others.

    The work's record is of the tile and its surroundings; returns the tile's alone. Rounds that an earlier
    task computed are in the record; the refinement repeats them from there.
    """
    around, record = _surrounded(spec, chunk), work.record
    flat = {name: array.reshape(around.cells, *array.shape[3:]) for name, array in record.items()}
    cells = {name: array.ravel() for name, array in cells_of(spec, around).items()}
    computed = flat[COMPUTED]
    tile = Refinement((chunk.shape[1], chunk.shape[2]), refine_of(spec), _beyond(spec, chunk))
    finished = work.done
    for number in itertools.count():
        if not tile.cells.size:
            break
        if number >= finished:
            done = compute(spec, work, {axis: cells[axis][tile.cells] for axis in AXES}, [])
            for name, array in flat.items():
                array[tile.cells] = 1 if array is computed else getattr(done, name)
            work.finish()
        tile.split(*(record[name][0] for name in MODE_ARRAYS))
    result = {name: array[:, *tile.inside] for name, array in record.items()}
    source = tile.sources()
    for name in MODE_ARRAYS:
        result[name] = result[name].ravel()[source].reshape(chunk.shape)
    return result


def _beyond(spec: SweepSpec, chunk: Chunk) -> Beyond:
    """The map's cells around a tile: rows above and below, columns left and right."""
    _, (top, bottom), (left, right) = chunk.spans
    return top, spec.shape[2] - bottom, left, spec.shape[3] - right


def _surrounded(spec: SweepSpec, chunk: Chunk) -> Chunk:
    """A tile with its surroundings."""
    xi, (top, bottom), (first, last) = chunk.spans
    above, below, left, right = surroundings(refine_of(spec), _beyond(spec, chunk))
    return replace(chunk, spans=(xi, (top - above, bottom + below), (first - left, last + right)))
