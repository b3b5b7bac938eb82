"""A study as Parquet: of a sweep one row per cell, its flights as lists; or one row per flight."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from kernel.labels import LABELS
from service.render.blocks import GROUP_BYTES, Block, exported, is_of_flights, of_sweep
from service.render.study_rows import lists, rows_of, schema_of
from service.results.counting import LABEL
from service.results.selection import Stored
from worker import schema
from worker.schema import Layout
from worker.spec import AXES, SweepSpec

#: A row group is written once it has as many rows, or GROUP_BYTES: large enough to be read fast, small enough
#: to be skipped, and held in memory until then.
GROUP_ROWS: Final = 2**17

#: Rows of cells that become rows of flights at once.
_SLICE_ROWS: Final = 2**12

#: The column that counts a cell's flights, from 0.
_FLIGHT: Final = "flight"


def _column(array: schema.Array) -> tuple[str, pa.DataType]:
    dtype = pa.from_numpy_dtype(np.dtype(array.dtype))
    return array.name, pa.list_(dtype) if array.extra_dims else dtype


#: The columns of names instead of codes.
_NAMED: Final = (schema.OUTCOME.name, LABEL.name)


def _schema(spec: SweepSpec) -> pa.Schema:
    """Where the cell is, its outcome and label by name, then the stored arrays: counts first, lists last."""
    arrays = {array.name: array for array in of_sweep(spec)}
    named = [name for name in _NAMED if name in arrays]
    return pa.schema(
        [
            ("direction", pa.string()),
            *((axis, pa.float64()) for axis in reversed(AXES)),
            *((name, pa.string()) for name in named),
            *map(
                _column,
                sorted(
                    (array for name, array in arrays.items() if name not in named),
                    key=lambda array: len(array.extra_dims),
                ),
            ),
        ]
    )


def write(
    study: Stored[Any],
    layout: Layout,
    attributes: Mapping[str, str | int | float],
    blocks: Iterable[Block],
    path: Path,
    *,
    by_flight: bool = False,
) -> None:
    """Write the study's file, `by_flight` with a row for each flight.

    Raises OSError, and what `blocks` raises.
    """
    is_sweep = isinstance(study.spec, SweepSpec)
    cells = _schema(study.spec) if is_sweep else schema_of(layout)
    rows: Iterator[pa.RecordBatch] = (
        _rows(study.spec, block, cells) if is_sweep else rows_of(layout, block, cells) for block in blocks
    )
    names = [array.name for array in exported(study, layout) if is_of_flights(array)]
    table, rows = (_flight_schema(cells, names), _flights(rows, names)) if by_flight else (cells, rows)
    table = table.with_metadata({name: str(value) for name, value in attributes.items()})
    try:
        with parquet.ParquetWriter(path, table, compression="zstd") as file:
            for group in _groups(rows):
                file.write_table(pa.Table.from_batches(group, table), row_group_size=GROUP_ROWS)
    finally:
        pa.default_memory_pool().release_unused()  # it keeps what it had for its next arrays


def _groups(batches: Iterable[pa.RecordBatch]) -> Iterator[list[pa.RecordBatch]]:
    """The batches in groups that are large enough, the last one perhaps not."""
    group: list[pa.RecordBatch] = []
    rows = size = 0
    for batch in batches:
        group.append(batch)
        rows, size = rows + batch.num_rows, size + batch.nbytes
        if rows >= GROUP_ROWS or size >= GROUP_BYTES:
            yield group
            group, rows, size = [], 0, 0
    if group:
        yield group


def _flight_schema(table: pa.Schema, names: list[str]) -> pa.Schema:
    """The columns of rows of flights: the cell's that are no lists, the flight's number, its values."""
    return pa.schema(
        [
            *(column for column in table if not pa.types.is_list(column.type)),
            (_FLIGHT, pa.int32()),
            *((name, table.field(name).type.value_type) for name in names),
        ]
    )


def _flights(batches: Iterable[pa.RecordBatch], names: list[str]) -> Iterator[pa.RecordBatch]:
    """Rows of cells as rows of flights; `names`: the columns with a list of flights."""
    for batch in batches:
        table = _flight_schema(batch.schema, names)
        for first in range(0, batch.num_rows, _SLICE_ROWS):
            yield _flights_of(batch.slice(first, _SLICE_ROWS), table, names)


def _flights_of(batch: pa.RecordBatch, table: pa.Schema, names: list[str]) -> pa.RecordBatch:
    lengths = np.asarray(batch[names[0]].value_lengths())
    cell = np.repeat(np.arange(batch.num_rows), lengths)
    first = np.repeat(np.cumsum(lengths) - lengths, lengths)
    columns = {name: batch[name].flatten() for name in names}
    columns[_FLIGHT] = pa.array(np.arange(len(cell)) - first, pa.int32())
    columns |= {name: batch[name].take(pa.array(cell)) for name in table.names if name not in columns}
    return pa.record_batch([columns[name] for name in table.names], schema=table)


def _rows(spec: SweepSpec, block: Block, table: pa.Schema) -> pa.RecordBatch:
    values = [spec.axis_values(axis)[block.cells[axis]] for axis in AXES]
    grid = dict(zip(AXES, np.meshgrid(*values, indexing="ij"), strict=True))
    columns = {array.name: _values(array, block.arrays) for array in of_sweep(spec)}
    columns |= {axis: grid[axis].ravel() for axis in AXES}
    columns["direction"] = np.full(len(columns["flights"]), block.direction)
    columns |= {name: np.array(LABELS)[columns[name]] for name in _NAMED if name in columns}
    return pa.record_batch([pa.array(columns[name]) for name in table.names], schema=table)


def _values(array: schema.Array, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """One value per cell; a list of all, as of the exponents; a list of the flights that are kept."""
    values = arrays[array.name]
    if not array.extra_dims:
        return values.ravel()
    flights = arrays["flights"].ravel()
    return lists(values, flights if is_of_flights(array) else np.full_like(flights, values.shape[-1]))
