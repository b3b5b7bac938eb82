"""What the files of a whole sweep share: which arrays they hold, the chunks in order, and the attributes."""

import json
from collections.abc import Iterator
from typing import Any, Final

from numpy.typing import NDArray

from kernel.params import KERNEL_VERSION
from service.results.selection import Sweep, read
from worker import schema
from worker.plan import Chunk, Plan
from worker.spec import AXES, SweepSpec

#: The exported arrays: all but the states that a ramp carries on from.
EXPORTED: Final = (*schema.RECORD, schema.OUTCOME)

Arrays = dict[str, NDArray[Any]]


def blocks(sweep: Sweep, plan: Plan) -> Iterator[tuple[Chunk, Arrays]]:
    """Every chunk and its exported arrays, of shape chunk.shape plus the extra dimension.

    Cells that are not computed yet hold fill values. Raises a `store.StoreError`.
    """
    names = [array.name for array in EXPORTED]
    for chunk in plan:
        cells = {axis: slice(*getattr(chunk, axis)) for axis in AXES}
        yield chunk, read(sweep, names, sweep.spec.directions[chunk.direction], cells)


def attributes(spec: SweepSpec) -> dict[str, str]:
    """What a file says of its origin: the specification as JSON and the kernel's version."""
    return {"kernel_version": KERNEL_VERSION, "spec": json.dumps(spec.as_submitted())}
