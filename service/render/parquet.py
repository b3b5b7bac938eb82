"""A study as Parquet, chunk by chunk; of a sweep one row per cell, its flights as lists."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from kernel.labels import LABELS
from service.render.blocks import Block, of_sweep
from service.render.study_rows import lists, rows_of, schema_of
from service.results.counting import LABEL
from service.results.selection import Stored, Sweep
from worker import schema
from worker.schema import Layout
from worker.spec import AXES, SweepSpec


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


def write(study: Stored[Any], layout: Layout, blocks: Iterable[Block], path: Path) -> None:
    """Write the study's file. Raises OSError, and what `blocks` raises."""
    origin = study.origin
    is_sweep = isinstance(study, Sweep)
    table = _schema(study.spec) if is_sweep else schema_of(layout)
    table = table.with_metadata(origin)
    try:
        with parquet.ParquetWriter(path, table, compression="zstd") as file:
            for block in blocks:
                rows = _rows(study.spec, block, table) if is_sweep else rows_of(layout, block, table)
                file.write_batch(rows)
    finally:
        pa.default_memory_pool().release_unused()  # it keeps what it had for its next arrays


def _rows(spec: SweepSpec, block: Block, table: pa.Schema) -> pa.RecordBatch:
    values = [spec.axis_values(axis)[block.cells[axis]] for axis in AXES]
    grid = dict(zip(AXES, np.meshgrid(*values, indexing="ij"), strict=True))
    columns = {array.name: _values(array, block.arrays) for array in of_sweep(spec)}
    columns |= {axis: grid[axis].ravel() for axis in AXES}
    columns["direction"] = np.full(len(columns["flights"]), block.direction)
    columns |= {name: np.array(LABELS)[columns[name]] for name in _NAMED if name in columns}
    return pa.record_batch([pa.array(columns[name]) for name in table.names], schema=table)


def _values(array: schema.Array, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """One value per cell; a list of the exponents; a list of the flights that are kept."""
    values = arrays[array.name]
    if not array.extra_dims:
        return values.ravel()
    flights = arrays["flights"].ravel()
    return lists(values, flights if "flight" in array.dims else np.full_like(flights, values.shape[-1]))
