"""A sweep as Parquet: one row per cell, its flights as lists, chunk by chunk."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from kernel.labels import LABELS
from service.render.blocks import Block, exported
from service.results.counting import LABEL
from service.results.selection import Sweep
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
    arrays = {array.name: array for array in exported(spec)}
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


def write(sweep: Sweep, layout: Layout, blocks: Iterable[Block], path: Path) -> None:
    """Write the sweep's file. Raises OSError, and what `blocks` raises."""
    origin = {**sweep.attributes, "spec": json.dumps(sweep.spec.as_submitted())}
    table = _schema(sweep.spec).with_metadata(origin)
    try:
        with parquet.ParquetWriter(path, table, compression="zstd") as file:
            for block in blocks:
                file.write_batch(_rows(sweep.spec, block, table))
    finally:
        pa.default_memory_pool().release_unused()  # it keeps what it had for its next arrays


def _rows(spec: SweepSpec, block: Block, table: pa.Schema) -> pa.RecordBatch:
    values = [spec.axis_values(axis)[block.cells[axis]] for axis in AXES]
    grid = dict(zip(AXES, np.meshgrid(*values, indexing="ij"), strict=True))
    columns = {array.name: _values(array, block.arrays) for array in exported(spec)}
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
    return _lists(values, flights if "flight" in array.dims else np.full_like(flights, values.shape[-1]))


def _lists(values: NDArray[Any], flights: NDArray[np.int32]) -> pa.Array:
    """(…, keep) → for each cell the list of the first of them, as many as `flights` (cells,) says."""
    keep = values.shape[-1]
    kept = np.minimum(flights, keep)
    offsets = np.concatenate([[0], np.cumsum(kept)]).astype(np.int32)
    flat = values.reshape(-1, keep)[np.arange(keep) < kept[:, None]]
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(flat))
