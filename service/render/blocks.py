"""What the files of a whole sweep share: which arrays they hold, and the chunks in order."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from numpy.typing import NDArray

from service.results.counting import LABEL, labelled
from service.results.selection import Sweep, read
from worker import schema
from worker.spec import SweepSpec
from worker.studies import Plan


def exported(spec: SweepSpec) -> tuple[schema.Array, ...]:
    """The exported arrays: all but the states that a ramp carries on from, and labels where there are any."""
    stored = tuple(array for array in schema.arrays(spec) if array is not schema.END_STATE)
    return (*stored, LABEL) if spec.exponents else stored


class Block(NamedTuple):
    """One chunk of a sweep."""

    direction: str
    cells: Mapping[str, slice]  # the grid indices it spans, by axis in the order of the store
    arrays: Mapping[str, NDArray[Any]]  # `exported` by name: (xi, omega, gamma), then the extra dimension


def blocks(sweep: Sweep, plan: Plan) -> Iterator[Block]:
    """Every chunk of the plan; cells that are not computed yet hold fill values.

    Raises a `store.StoreError`.
    """
    names = [array.name for array in exported(sweep.spec) if array is not LABEL]
    for chunk in plan:
        cells = dict(zip(schema.CELL_DIMS, chunk.slices, strict=True))
        direction = sweep.spec.directions[cells.pop("direction").start]
        arrays = read(sweep, names, direction, cells)
        arrays |= labelled(sweep.spec, arrays[schema.OUTCOME.name], arrays)
        yield Block(direction, cells, arrays)
