"""The chunks of a whole study in order, as its files hold them."""

from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
import xarray
from numpy.typing import NDArray

from service.views.selection import LABEL, Stored, labelled, read_stored
from worker import schema
from worker.schema import Layout
from worker.spec import SweepSpec
from worker.studies import Plan

#: Bytes of a table's rows that are held in memory until they are written together.
GROUP_BYTES: Final = 16 * 2**20


class Block(NamedTuple):
    """One chunk of a study."""

    cells: Mapping[str, slice]  # the cells it spans, by dimension in the order of the store
    arrays: Mapping[str, NDArray[Any]]  # by name, along `cells` and then the extra dimensions


def exported(spec: Any, layout: Layout) -> tuple[schema.Array, ...]:
    """All stored arrays, and the label of a sweep with exponents."""
    labels = (LABEL,) if isinstance(spec, SweepSpec) and spec.exponents else ()
    return (*layout.arrays, *labels)


def blocks(study: Stored[Any], plan: Plan, layout: Layout) -> Iterator[Block]:
    """Every chunk of the plan; cells that are not computed yet hold fill values.

    Raises a `store.StoreError`.
    """
    for chunk in plan:
        cells = dict(zip(layout.chunk_sizes, chunk.slices, strict=True))
        arrays = read_stored(study, layout.names, cells)
        if isinstance(study.spec, SweepSpec):
            arrays |= labelled(study.spec, arrays[schema.OUTCOME.name], arrays)
        yield Block(cells, arrays)


def dataset(spec: Any, layout: Layout, block: Block) -> xarray.Dataset:
    """A block with its coordinates."""
    coords = {}
    for name, values in layout.coordinates.items():
        part = values[block.cells[name]] if name in block.cells else values
        coords[name] = (name, np.array(part.tolist()) if part.dtype.kind == "T" else part)
    variables = {row.name: (row.dims, block.arrays[row.name], row.attrs) for row in exported(spec, layout)}
    return xarray.Dataset(variables, coords)
