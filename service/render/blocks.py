"""What the files of a whole study share: which arrays they hold, and the chunks in order."""

from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.results.counting import LABEL, labelled
from service.results.selection import Stored, read, read_stored
from worker import schema
from worker.schema import Layout
from worker.spec import SweepSpec
from worker.studies import Plan

#: Bytes of a table's rows that are held in memory until they are written together.
GROUP_BYTES: Final = 16 * 2**20


def exported(study: Stored[Any], layout: Layout) -> tuple[schema.Array, ...]:
    """The exported arrays: of a sweep `of_sweep`, of any other study all that is stored."""
    return of_sweep(study.spec) if isinstance(study.spec, SweepSpec) else layout.arrays


def of_sweep(spec: SweepSpec) -> tuple[schema.Array, ...]:
    """All arrays of the store, and labels where there are any."""
    stored = tuple(schema.arrays(spec))
    return (*stored, LABEL) if spec.exponents else stored


def is_of_flights(array: schema.Array) -> bool:
    """Whether an array has a value for each flight of a cell, or of an attractor of a cell."""
    return array.dims[-1] == "flight"


class Block(NamedTuple):
    """One chunk of a study."""

    direction: str | None  # of a sweep
    cells: Mapping[str, slice]  # the grid indices it spans, by axis in the order of the store
    arrays: Mapping[str, NDArray[Any]]  # `exported` by name: along `cells`, then the extra dimensions


def blocks(study: Stored[Any], plan: Plan, layout: Layout) -> Iterator[Block]:
    """Every chunk of the plan; cells that are not computed yet hold fill values.

    Raises a `store.StoreError`.
    """
    names = [array.name for array in exported(study, layout) if array is not LABEL]
    for chunk in plan:
        cells = dict(zip(layout.chunk_sizes, chunk.slices, strict=True))
        if isinstance(study.spec, SweepSpec):
            direction = study.spec.directions[cells.pop("direction").start]
            arrays = read(study, names, direction, cells)
            arrays |= labelled(study.spec, arrays[schema.OUTCOME.name], arrays)
            yield Block(direction, cells, arrays)
        else:
            empty = _fill_values(layout, cells)
            yield Block(None, cells, read_stored(study, names, cells, lambda empty=empty: empty))  # type: ignore[misc]


def _fill_values(layout: Layout, cells: Mapping[str, slice]) -> dict[str, NDArray[Any]]:
    """What the arrays of a chunk hold before any cell is computed."""
    return {
        array.name: np.full(
            [
                cells[dim].stop - cells[dim].start if dim in cells else layout.extra_sizes[dim]
                for dim in array.dims
            ],
            array.fill,
            array.dtype,
        )
        for array in layout.arrays
    }
