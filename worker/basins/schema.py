"""The stored variables of basins and of multistability: attractors over a grid of cells."""

from typing import Final

import numpy as np

from kernel.params import STATE_FIELDS
from worker.basins.specification import BasinSpec, GridSpec, MultistabilitySpec
from worker.study.layout import OUTCOME_FLAGS, Array, Layout, array, grid_layout, whether_computed
from worker.sweep import AXES
from worker.sweep.schema import LYAPUNOV_ERROR

#: Stored attractors of a cell, the largest basins first. Starts of others count as undecided.
MAX_ATTRACTORS: Final = 32
#: Stored attractors of a multistability study's cell: first those that most drops reach, then those found by
#: following others.
MAX_FOLLOWED: Final = 8

#: Side of the boxes for the entropies, in starts.
BOX: Final = 8

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

#: Arrays of a cell; `outcome` is the last array of both studies.
COUNT: Final = array(
    "attractor_count", AXES, "<i4", "attractors of the cell, also those beyond the dimension id"
)
OUTCOME: Final = whether_computed(AXES, "undecided")


def sizes_of_attractors(spec: GridSpec, attractors: int) -> dict[str, int]:
    """Length of the dimensions of OF_ATTRACTORS."""
    return {"id": attractors, "flight": spec.keep, "state": len(STATE_FIELDS)}


def basin_arrays(spec: BasinSpec) -> tuple[Array, ...]:
    """The stored arrays in the order they are written."""
    exponents = [
        array("lyapunov", (*AXES, "id", "exponent"), "<f8", "Lyapunov exponents, the largest first",
              comment="per plate period, natural logarithm"),
        array("lyapunov_error", (*AXES, "id"), "<f8", LYAPUNOV_ERROR.attrs["long_name"]),
    ]  # fmt: skip
    return (
        array("attractor", (*AXES, "row", "column"), "|u1", "attractor that a start reaches",
              comment="0: undecided, or of an attractor beyond the dimension id"),
        *OF_ATTRACTORS[:5],
        LIFETIME,
        *OF_ATTRACTORS[5:],
        *(exponents if spec.exponents else ()),
        COUNT,
        array("undecided", AXES, "<f8", "share of the starts without an attractor"),
        array("basin_entropy", AXES, "<f8", f"basin entropy, of boxes of {BOX} by {BOX} starts",
              comment="natural logarithm; NaN: fewer starts than a box has"),
        array("boundary_entropy", AXES, "<f8", f"boundary basin entropy, of boxes of {BOX} by {BOX} starts",
              comment="mean over the boxes with more than one attractor; 0 without such boxes"),
        OUTCOME,
    )  # fmt: skip


def basin_sizes(spec: BasinSpec) -> dict[str, int]:
    plane = spec.protocol
    return {"row": plane.rows, "column": plane.columns, "exponent": spec.exponents,
            **sizes_of_attractors(spec, MAX_ATTRACTORS)}  # fmt: skip


#: Attributes of the rows and columns of each plane.
SIDES: Final = {
    "drop": (
        {"long_name": "height of the lower mass above the plate, in plate amplitudes", "units": "1"},
        {"long_name": "plate phase at which the spring is let go", "units": "rad"},
    ),
    "contact": (
        {"long_name": "elongation beyond the static one, in plate amplitudes", "units": "1"},
        {"long_name": "velocity of the elongation times omega, in plate amplitudes", "units": "1"},
    ),
}


def basin_layout(spec: BasinSpec, chunk_shape: tuple[int, ...]) -> Layout:
    """Layout of the store with chunks of `chunk_shape` cells along (xi, omega, gamma)."""
    plane = spec.protocol
    row, column = SIDES[plane.plane]
    coordinates = {
        "row": (plane.row_values, row),
        "column": (plane.column_values, column),
        "id": (np.arange(1, MAX_ATTRACTORS + 1, dtype="<i4"),
               {"long_name": "attractor, by the share of the starts that reach it"}),
    }  # fmt: skip
    title = "bouncing spring: basins of attraction"
    return grid_layout(
        spec, chunk_shape, basin_arrays(spec), basin_sizes(spec), coordinates, title, spec.model.kind
    )


#: The arrays of a multistability study in the order they are written.
FOLLOWED_ARRAYS: Final = (
    *OF_ATTRACTORS,
    array("next_up", (*AXES, "id"), "|i1", "attractor of the next larger gamma that this one leads to",
          comment="0: none that is known; -1: no such cell"),
    array("next_down", (*AXES, "id"), "|i1", "attractor of the next smaller gamma that this one leads to",
          comment="0: none that is known; -1: no such cell"),
    COUNT,
    array("undecided", AXES, "<f8", "share of the drops without an attractor"),
    OUTCOME,
)  # fmt: skip


def multistability_layout(spec: MultistabilitySpec, chunk_shape: tuple[int, ...]) -> Layout:
    """Layout of the store with chunks of `chunk_shape` cells along (xi, omega, gamma)."""
    about = {"long_name": "attractor of a cell, by the share of the drops that reach it"}
    coordinates = {"id": (np.arange(1, MAX_FOLLOWED + 1, dtype="<i4"), about)}
    sizes, title = sizes_of_attractors(spec, MAX_FOLLOWED), "bouncing spring: multistability"
    return grid_layout(spec, chunk_shape, FOLLOWED_ARRAYS, sizes, coordinates, title, spec.model.kind)
