"""The variables of results: names, dimensions, types, units and long names, once; and Datasets of them.

Stored variables come from `worker.sweep.schema` and `worker.basins.schema`. This module adds derived ones.
"""

from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np
import xarray
from numpy.typing import NDArray

from worker.basins.schema import LIFETIME, OF_ATTRACTORS
from worker.study import Array
from worker.study.layout import CELL_DIMS, COORDINATES

#: The stored dimension of the attractors of a cell. Results call it `attractor`.
_STORED_ATTRACTOR: Final = "id"


def of_attractor(array: Array) -> Array:
    """A stored array as results name it: `fraction` (id) is `attractor_fraction` (attractor)."""
    if _STORED_ATTRACTOR not in array.dims:
        return array
    dims = tuple("attractor" if dim == _STORED_ATTRACTOR else dim for dim in array.dims)
    return array._replace(name=f"attractor_{array.name.removeprefix('attractor_')}", dims=dims)


def row(
    name: str, dims: tuple[str, ...], dtype: str, long_name: str, units: str = "1", **attrs: Any
) -> Array:
    """A variable over cells and the dimensions `dims`."""
    return Array(name, (*CELL_DIMS, *dims), dtype, 0, {"long_name": long_name, "units": units, **attrs})


_DERIVED: Final = (
    row("attractor_of_start", ("row", "column"), "|u1", "attractor that a start reaches",
         comment="0: undecided"),
    row("hysteresis", (), "|u1", "how the ramps up and down compare", flag_values=[0, 1, 2],
         flag_meanings="none other_mode other_flights"),
    row("attractor_label", ("attractor",), "U", "what the attractor does"),
    of_attractor(LIFETIME)._replace(attrs={
        "long_name": "life of aperiodic motion that was seen to end", "units": "plate periods",
        "comment": "NaN: no such motion was seen to end",
    }),
)  # fmt: skip

#: The energy balance of a cycle.
ENERGY: Final = tuple(
    row(name, (), "<f8", long_name, units)
    for name, long_name, units in (
        ("plate_contact", "work of the plate in contact", "m A² ω²"),
        ("plate_impact", "work of the plate at the impact", "m A² ω²"),
        ("dashpot", "energy that the dashpot takes", "m A² ω²"),
        ("impact", "energy that the impact takes", "m A² ω²"),
        ("force", "momentum that the contact force gives", "m A ω"),
        ("impulse", "momentum that the impact gives", "m A ω"),
        ("weight", "momentum that gravity takes, 4π periods/Γ", "m A ω"),
    )
)

#: Every variable by name.
VARIABLES: Final[Mapping[str, Array]] = {
    array.name: array for array in (*map(of_attractor, OF_ATTRACTORS), *_DERIVED)
}


def variable(dims: tuple[str, ...], values: Any, row: Array) -> xarray.Variable:
    """A variable over the cell dimensions `dims` and the further dimensions of its row."""
    return xarray.Variable((*dims, *row.extra_dims), np.asarray(values, row.dtype), row.attrs)


def variables(
    rows: Iterable[Array], values: Mapping[str, Any], dims: tuple[str, ...] = ()
) -> dict[str, xarray.Variable]:
    """The variables, by name, of the rows with values; dims: as in `variable`."""
    return {row.name: variable(dims, values[row.name], row) for row in rows if row.name in values}


def coordinate(name: str, values: Any, **attrs: Any) -> xarray.Variable:
    """A coordinate: values along the dimension `name`, or one value."""
    data = np.asarray(values)
    return xarray.Variable((name,) if data.ndim else (), data, {**COORDINATES.get(name, {}), **attrs})


def dataset(
    data: Mapping[str, xarray.Variable], coords: Mapping[str, xarray.Variable], attrs: Mapping[str, Any]
) -> xarray.Dataset:
    """A Dataset without indexes, which would take half of the time to make it."""
    return xarray.Dataset(data, xarray.Coordinates(coords, indexes={}), attrs)


def cells_dataset(
    cells: Mapping[str, Mapping[str, NDArray[Any]]], coords: Mapping[str, xarray.Variable],
    rows: Iterable[Array], attrs: Mapping[str, Any],
) -> xarray.Dataset:  # fmt: skip
    """A Dataset of arrays of cells over `coords`, by direction, which is a dimension if there are several."""
    directions, arrays = list(cells), list(cells.values())
    both = len(directions) > 1
    dims = ("direction",) * both + tuple(name for name, along in coords.items() if along.ndim)
    named = {row.name: row for row in rows}
    data = {
        name: variable(dims, np.stack([way[name] for way in arrays]) if both else values, named[name])
        for name, values in arrays[0].items()
    }
    direction = coordinate("direction", directions if both else directions[0])
    return dataset(data, {"direction": direction, **coords}, attrs)
