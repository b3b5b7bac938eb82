"""A sweep as Parquet: one row per cell, its flights as lists, chunk by chunk."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from kernel.params import Outcome
from service.render.blocks import EXPORTED, Block, blocks
from service.results.selection import Sweep
from worker import schema
from worker.spec import AXES, SweepSpec
from worker.studies import Plan


def _column(array: schema.Array) -> tuple[str, pa.DataType]:
    dtype = pa.from_numpy_dtype(np.dtype(array.dtype))
    return array.name, pa.list_(dtype) if array.extra_dims else dtype


_OUTCOME: Final = schema.OUTCOME.name
#: Where the cell is and its outcome by name, then the stored arrays: counts first, lists last.
_SCHEMA: Final = pa.schema(
    [
        ("direction", pa.string()),
        *((axis, pa.float64()) for axis in reversed(AXES)),
        (_OUTCOME, pa.string()),
        *map(_column, sorted(schema.RECORD, key=lambda array: len(array.extra_dims))),
    ]
)


def write(sweep: Sweep, plan: Plan, path: Path) -> None:
    """Write the sweep's file. Raises OSError, a `store.StoreError`."""
    origin = {**sweep.attributes, "spec": json.dumps(sweep.spec.as_submitted())}
    table = _SCHEMA.with_metadata(origin)
    with parquet.ParquetWriter(path, table, compression="zstd") as file:
        for block in blocks(sweep, plan):
            file.write_batch(_rows(sweep.spec, block, table))


def _rows(spec: SweepSpec, block: Block, table: pa.Schema) -> pa.RecordBatch:
    values = [spec.axis_values(axis)[block.cells[axis]] for axis in AXES]
    grid = dict(zip(AXES, np.meshgrid(*values, indexing="ij"), strict=True))
    outcomes = np.array([outcome.name.lower() for outcome in Outcome])
    columns = {array.name: _values(array, block.arrays) for array in EXPORTED}
    columns |= {axis: grid[axis].ravel() for axis in AXES}
    columns["direction"] = np.full(len(columns[_OUTCOME]), block.direction)
    columns[_OUTCOME] = outcomes[columns[_OUTCOME]]
    return pa.record_batch([pa.array(columns[name]) for name in table.names], schema=table)


def _values(array: schema.Array, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """One value per cell; of an array with a value per flight, the list of those that are kept."""
    values = arrays[array.name]
    return _lists(values, arrays["flights"].ravel()) if array.extra_dims else values.ravel()


def _lists(values: NDArray[Any], flights: NDArray[np.int32]) -> pa.Array:
    """(cells, keep) → for each cell the list of the flights that are kept."""
    keep = values.shape[-1]
    kept = np.minimum(flights, keep)
    offsets = np.concatenate([[0], np.cumsum(kept)]).astype(np.int32)
    flat = values.reshape(-1, keep)[np.arange(keep) < kept[:, None]]
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(flat))
