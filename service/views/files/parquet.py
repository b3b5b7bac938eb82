"""A whole study as Parquet: a row for each cell, each attractor of a cell, or each flight."""

from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
from pyarrow import parquet

from service.views.encode import record_batch, tables
from service.views.files.blocks import GROUP_BYTES, Block, dataset
from service.views.selection import Stored
from worker import schema
from worker.schema import Layout

#: A row group is written once it has as many rows, or GROUP_BYTES: large enough to be read fast, small enough
#: to be skipped, and held in memory until then.
GROUP_ROWS: Final = 2**17


def write(
    study: Stored[Any],
    layout: Layout,
    attributes: Mapping[str, str | int | float],
    blocks: Iterable[Block],
    path: Path,
    *,
    by_flight: bool = False,
) -> None:
    """Write the study's file. Raises OSError, and what `blocks` raises."""
    batches = (batch for block in blocks for batch in _rows(study.spec, layout, block, by_flight=by_flight))
    first = next(batches)
    table = first.schema.with_metadata({name: str(value) for name, value in attributes.items()})
    try:
        with parquet.ParquetWriter(path, table, compression="zstd") as file:
            for group in _groups(chain([first], batches)):
                file.write_table(pa.Table.from_batches(group).cast(table), row_group_size=GROUP_ROWS)
    finally:
        pa.default_memory_pool().release_unused()  # it keeps what it had for its next arrays


def _rows(spec: Any, layout: Layout, block: Block, *, by_flight: bool) -> Iterator[pa.RecordBatch]:
    found = dataset(spec, layout, block)
    maps = [name for name, variable in found.variables.items() if {"row", "column"} & {*variable.dims}]
    rows = "fraction" if "fraction" in found else schema.OUTCOME.name
    parts = tables(found.drop_vars(maps), "flight_time" if by_flight else rows, lists=not by_flight)
    return map(record_batch, parts)


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
