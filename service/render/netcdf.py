"""A sweep as NetCDF 4: the dimensions, coordinates, arrays and attributes of its store, chunk by chunk."""

import json
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np
from numpy.typing import NDArray

from service.render.blocks import blocks, exported
from service.results.selection import Sweep
from worker.schema import Array, Layout
from worker.studies import Plan, study_of


def write(sweep: Sweep, plan: Plan, path: Path) -> None:
    """Write the sweep's file. Raises OSError, a `store.StoreError`."""
    layout = study_of(sweep.spec).variables(sweep.spec, plan.chunk_shape)
    arrays = exported(sweep.spec)
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {
            dim: size for array in arrays for dim, size in zip(array.dims, layout.shape(array), strict=True)
        }
        for name, values in layout.coordinates.items():
            _write_coordinate(file, name, values)
            file.variables[name].attrs.update(layout.coordinate_attrs[name])
        for array in arrays:
            _create_variable(file, array, layout)
        for block in blocks(sweep, plan):
            where = (sweep.spec.directions.index(block.direction), *block.cells.values())
            for array in arrays:
                file.variables[array.name][where] = block.arrays[array.name]
        attributes = {**layout.attributes, **sweep.attributes}
        file.attrs.update({name: _text(value) for name, value in attributes.items()})


def _write_coordinate(file: Any, name: str, values: NDArray[Any]) -> None:
    if values.dtype.kind == "T":  # text of any length, which HDF5 has as a type of its own
        variable = file.create_variable(name, (name,), h5py.string_dtype())
        variable[...] = values.astype(object)
    else:
        file.create_variable(name, (name,), data=values)


def _create_variable(file: Any, array: Array, layout: Layout) -> None:
    # Counts have no fill value: CF readers would turn them into floating point.
    fill = array.fill if np.dtype(array.dtype).kind == "f" else None
    variable = file.create_variable(
        array.name, array.dims, np.dtype(array.dtype), fillvalue=fill,
        chunks=layout.chunk_shape(array), compression="gzip", compression_opts=1, shuffle=True,
    )  # fmt: skip
    variable.attrs.update({name: _flags(value, array.dtype) for name, value in array.attrs.items()})


def _flags(value: object, dtype: str) -> object:
    """An attribute as CF wants it: flag values have the type of their variable."""
    return np.array(value, dtype) if isinstance(value, list) else value


def _text(value: object) -> str:
    """An attribute of the file: NetCDF has no nested values, so they are JSON."""
    return value if isinstance(value, str) else json.dumps(value)
