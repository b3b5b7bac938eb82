"""The stored arrays of attractors, over a grid of cells."""

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.params import KERNEL_VERSION, STATE_FIELDS, Outcome
from worker.basins.spec import GridSpec
from worker.schema import COORDINATES, OUTCOME, OUTCOME_FLAGS, Array, Layout, common_attributes
from worker.spec import AXES


def array(
    name: str, extra: tuple[str, ...], dtype: str, long_name: str, units: str = "1", **attrs: Any
) -> Array:
    """An array over the cells and the dimensions `extra`."""
    fill = math.nan if dtype == "<f8" else 0
    return Array(name, (*AXES, *extra), dtype, fill, {"long_name": long_name, "units": units, **attrs})


#: The arrays of each attractor of a cell.
OF_ATTRACTORS: Final = (
    array("fraction", ("id",), "<f8", "share of the starts that reach the attractor"),
    array("attractor_outcome", ("id",), "|u1", "what the attractor does", **OUTCOME_FLAGS),
    array("bounces", ("id",), "<i4", "bounces in one cycle, 0 without a cycle"),
    array("periods", ("id",), "<i4", "plate periods in one cycle, 0 without a cycle"),
    array("longest_flight", ("id",), "<f8", "longest flight", "rad"),
    array("flight_time", ("id", "flight"), "<f8", "last flights of a window in order", "rad"),
    array("takeoff_phase", ("id", "flight"), "<f8", "plate phase at take-off, modulo 2 pi", "rad"),
    array("attractor_state", ("id", "state"), "<f8", "a state on the attractor, in the cell's own units",
          fields=" ".join(STATE_FIELDS)),
)  # fmt: skip

LIFETIME: Final = array(
    "lifetime", ("id",), "<f8", "plate periods until aperiodic motion ends; inf: none ended"
)

#: The last array of such a study.
COMPUTED_OR_UNDECIDED: Final = OUTCOME._replace(
    dims=AXES,
    attrs={
        "long_name": "whether the cell is computed",
        "units": "1",
        "flag_values": [Outcome.MISSING.value, Outcome.PERIODIC.value, Outcome.UNRESOLVED.value],
        "flag_meanings": "missing computed undecided",
    },
)


def sizes_of_attractors(spec: GridSpec, attractors: int) -> dict[str, int]:
    """Length of the dimensions of OF_ATTRACTORS."""
    return {"id": attractors, "flight": spec.keep, "state": len(STATE_FIELDS)}


def bytes_per_cell(arrays: tuple[Array, ...], sizes: Mapping[str, int]) -> int:
    """Stored bytes per cell before compression."""
    return sum(np.dtype(a.dtype).itemsize * math.prod(sizes[dim] for dim in a.extra_dims) for a in arrays)


def grid_layout(
    spec: GridSpec,
    chunk_shape: tuple[int, ...],
    arrays: tuple[Array, ...],
    sizes: Mapping[str, int],
    coordinates: Mapping[str, tuple[NDArray[Any], dict[str, Any]]],
    title: str,
) -> Layout:
    """Layout of the store with chunks of `chunk_shape` cells along (xi, omega, gamma).

    `coordinates`: values and attributes of the other dimensions with coordinates.
    """
    attrs: dict[str, Any] = {row.name: row.attrs for row in COORDINATES if row.name in AXES}
    values: dict[str, NDArray[Any]] = {axis: spec.axis_values(axis).astype("<f8") for axis in AXES}
    return Layout(
        chunk_sizes=dict(zip(AXES, chunk_shape, strict=True)),
        coordinates=values | {name: along for name, (along, _) in coordinates.items()},
        extra_sizes=sizes,
        arrays=arrays,
        coordinate_attrs=attrs | {name: about for name, (_, about) in coordinates.items()},
        attributes=common_attributes(spec, title, spec.model.kind),
        identity={"job": spec.job_id(KERNEL_VERSION), "chunk_shape": list(chunk_shape)},
    )
