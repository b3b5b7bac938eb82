"""The results of studies other than sweeps as rows of a table.

One row per cell or, where cells have attractors, one for each attractor of a cell. Arrays with further
dimensions are lists, the last dimension fastest. The map of a basin is told by the starts of each attractor.
"""

from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from kernel.labels import LABELS
from kernel.params import Outcome
from service.render.blocks import Block
from worker import schema
from worker.schema import Layout

#: The dimension of arrays with a value for each attractor of a cell; those of a map of starts.
_ATTRACTOR: Final = "id"
_MAP: Final = ("row", "column")

#: A column beside those of the arrays: the starts that reach an attractor, row times columns plus column.
_STARTS: Final = "starts"
_BY_NAME: Final = "attractor_outcome"


def _has_attractors(layout: Layout) -> bool:
    return _ATTRACTOR in layout.extra_sizes


def _columns(layout: Layout) -> list[schema.Array]:
    """The arrays that become columns: not the map of starts; nor whether a cell without rows is computed."""
    left_out = {schema.OUTCOME.name} if _has_attractors(layout) else set()
    return [array for array in layout.arrays if array.dims[-2:] != _MAP and array.name not in left_out]


def _maps(layout: Layout) -> list[schema.Array]:
    return [array for array in layout.arrays if array.dims[-2:] == _MAP]


def schema_of(layout: Layout) -> pa.Schema:
    """The columns: where the cell is, the attractor, then the stored arrays: counts first, lists last."""
    kept = {*layout.chunk_sizes, *([_ATTRACTOR] if _has_attractors(layout) else [])}
    arrays = _columns(layout)
    columns = [
        (array.name, pa.string() if array.name == _BY_NAME else _type(array, kept)) for array in arrays
    ]
    columns.sort(key=lambda column: pa.types.is_list(column[1]))
    return pa.schema(
        [
            *((axis, pa.float64()) for axis in reversed(tuple(layout.chunk_sizes))),
            *([(_ATTRACTOR, pa.int32())] if _has_attractors(layout) else []),
            *columns,
            *((_STARTS, pa.list_(pa.int32())) for _ in _maps(layout)),
        ]
    )


def _type(array: schema.Array, kept: set[str]) -> pa.DataType:
    dtype = pa.from_numpy_dtype(np.dtype(array.dtype))
    return dtype if set(array.dims) <= kept else pa.list_(dtype)


def rows_of(layout: Layout, block: Block, table: pa.Schema) -> pa.RecordBatch:
    """The rows of one chunk, with the columns of `table`."""
    dims = tuple(layout.chunk_sizes)
    shape = tuple(span.stop - span.start for span in block.cells.values())
    cells = int(np.prod(shape))
    values = [layout.coordinates[dim][block.cells[dim]] for dim in dims]
    columns = dict(zip(dims, (grid.ravel() for grid in np.meshgrid(*values, indexing="ij")), strict=True))
    flat = {array.name: block.arrays[array.name].reshape(cells, -1) for array in layout.arrays}
    rows = np.arange(cells)
    if _has_attractors(layout):
        there = block.arrays["attractor_outcome"].reshape(cells, -1) != Outcome.MISSING
        rows, attractor = np.nonzero(there)
        columns[_ATTRACTOR] = np.tile(layout.coordinates[_ATTRACTOR], cells)[there.ravel()]
    columns = {name: column if name == _ATTRACTOR else column[rows] for name, column in columns.items()}
    for array in _columns(layout):
        found = flat[array.name]
        if _ATTRACTOR in array.dims:
            found = found.reshape(cells, layout.extra_sizes[_ATTRACTOR], -1)[rows, attractor]
        else:
            found = found[rows]
        if array.name == _BY_NAME:
            columns[array.name] = np.array(LABELS)[found[:, 0]]
        elif pa.types.is_list(table.field(array.name).type):
            columns[array.name] = lists(found, _lengths(array, found))
        else:
            columns[array.name] = found[:, 0]
    for array in _maps(layout):
        reached = [np.flatnonzero(flat[array.name][row] == id) for row, id in
                   zip(rows, columns[_ATTRACTOR], strict=True)]  # fmt: skip
        columns[_STARTS] = pa.array(reached, pa.list_(pa.int32()))
    return pa.record_batch([pa.array(columns[name]) for name in table.names], schema=table)


def _lengths(array: schema.Array, values: NDArray[Any]) -> NDArray[np.int32]:
    """How many of the values of each row count: of flights those that are there, else all."""
    if array.dims[-1] != "flight":
        return np.full(len(values), values.shape[1], np.int32)
    return np.asarray(np.isfinite(values).sum(axis=1), np.int32)


def lists(values: NDArray[Any], flights: NDArray[np.int32]) -> pa.Array:
    """(…, keep) → for each cell the list of the first of them, as many as `flights` (cells,) says."""
    keep = values.shape[-1]
    kept = np.minimum(flights, keep)
    offsets = np.concatenate([[0], np.cumsum(kept)]).astype(np.int32)
    flat = values.reshape(-1, keep)[np.arange(keep) < kept[:, None]]
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(flat))
