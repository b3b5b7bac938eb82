"""Computes a tile of an adaptive map, stores it, and returns a report; repeated, it writes the same bytes."""

from worker.maps.refinement import Tile, refine_of
from worker.study.chunks import Chunk, ChunkReport
from worker.study.layout import COMPUTED
from worker.sweep.schema import MODE_ARRAYS, arrays, sizes
from worker.sweep.specification import AXES, SweepSpec
from worker.sweep.task import cells_of, compute
from worker.work import Work


def run_chunk(spec: SweepSpec, chunk: Chunk, store_url: str) -> ChunkReport:
    """Compute the cells that a tile needs, fill in the others, and store it; the store must exist.

    Each round of the refinement is a line. The refinement repeats rounds of an earlier task from the record.
    Errors and checkpoints as in `worker.sweep.task`.
    """
    work = Work(store_url, chunk, tuple(arrays(spec)), sizes(spec))
    flat = {name: array.reshape(chunk.cells, *array.shape[3:]) for name, array in work.record.items()}
    cells = {name: array.ravel() for name, array in cells_of(spec, chunk).items()}
    tile = Tile(chunk.shape[1:], refine_of(spec))
    finished, number = work.done, 0  # rounds
    while tile.cells.size:
        if number >= finished:
            done = compute(spec, work, {axis: cells[axis][tile.cells] for axis in AXES}, [])
            for name, array in flat.items():
                array[tile.cells] = 1 if name == COMPUTED else getattr(done, name)
            work.finish()
        tile.split(*(work.record[name][0] for name in MODE_ARRAYS))
        number += 1
    source = tile.sources()
    for name in MODE_ARRAYS:
        flat[name][...] = flat[name][source]
    return work.write()
