"""What the files of a whole sweep share: which arrays they hold, and the chunks in order."""

from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple

from numpy.typing import NDArray

from service.results.selection import Sweep, read
from worker import schema
from worker.studies import Plan

#: The exported arrays: all but the states that a ramp carries on from.
EXPORTED: Final = (*schema.RECORD, schema.OUTCOME)


class Block(NamedTuple):
    """One chunk of a sweep."""

    direction: str
    cells: Mapping[str, slice]  # the grid indices it spans, by axis in the order of the store
    arrays: Mapping[str, NDArray[Any]]  # EXPORTED by name: (xi, omega, gamma), then the extra dimension


def blocks(sweep: Sweep, plan: Plan) -> Iterator[Block]:
    """Every chunk of the plan; cells that are not computed yet hold fill values.

    Raises a `store.StoreError`.
    """
    names = [array.name for array in EXPORTED]
    for chunk in plan:
        cells = dict(zip(schema.CELL_DIMS, chunk.slices, strict=True))
        direction = sweep.spec.directions[cells.pop("direction").start]
        yield Block(direction, cells, read(sweep, names, direction, cells))
