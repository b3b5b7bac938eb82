"""The variables of results, with dimensions, types, units and long names; and Datasets of them."""

from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np
import xarray
from numpy.typing import NDArray

from worker.study import Array
from worker.study.layout import CELL_DIMS, COORDINATES


def row(
    name: str, dims: tuple[str, ...], dtype: str, long_name: str, units: str = "1", **attrs: Any
) -> Array:
    """A variable over cells and the dimensions `dims`."""
    return Array(name, (*CELL_DIMS, *dims), dtype, 0, {"long_name": long_name, "units": units, **attrs})


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
