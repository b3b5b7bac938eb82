"""The stored arrays of attractors, over a grid of cells."""

from typing import Final

from kernel.params import STATE_FIELDS
from worker.basins.spec import GridSpec
from worker.schema import OUTCOME_FLAGS, array, whether_computed
from worker.spec import AXES

_ID: Final = (*AXES, "id")

#: The arrays of each attractor of a cell.
OF_ATTRACTORS: Final = (
    array("fraction", _ID, "<f8", "share of the starts that reach the attractor"),
    array("attractor_outcome", _ID, "|u1", "what the attractor does", **OUTCOME_FLAGS),
    array("bounces", _ID, "<i4", "bounces in one cycle, 0 without a cycle"),
    array("periods", _ID, "<i4", "plate periods in one cycle, 0 without a cycle"),
    array("longest_flight", _ID, "<f8", "longest flight", "rad"),
    array("flight_time", (*_ID, "flight"), "<f8", "last flights of a window in order", "rad"),
    array("takeoff_phase", (*_ID, "flight"), "<f8", "plate phase at take-off, modulo 2 pi", "rad"),
    array("attractor_state", (*_ID, "state"), "<f8", "a state on the attractor, in the cell's own units",
          fields=" ".join(STATE_FIELDS)),
)  # fmt: skip

LIFETIME: Final = array("lifetime", _ID, "<f8", "plate periods until aperiodic motion ends; inf: none ended")

#: Of the cell; `outcome` is the last array of such a study.
COUNT: Final = array(
    "attractor_count", AXES, "<i4", "attractors of the cell, also those beyond the dimension id"
)
OUTCOME: Final = whether_computed(AXES, "undecided")


def sizes_of_attractors(spec: GridSpec, attractors: int) -> dict[str, int]:
    """Length of the dimensions of OF_ATTRACTORS."""
    return {"id": attractors, "flight": spec.keep, "state": len(STATE_FIELDS)}
