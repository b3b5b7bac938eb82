"""A sweep as NetCDF 4: the store's arrays, dimensions and attributes, chunk by chunk."""

from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np

from service.render.blocks import EXPORTED, attributes, blocks
from service.results.selection import Sweep
from worker import schema
from worker.plan import Plan
from worker.spec import SweepSpec


def write(sweep: Sweep, plan: Plan, path: Path) -> None:
    """Write the sweep's file. Raises OSError, a `store.StoreError`."""
    spec = sweep.spec
    used = {dim for array in EXPORTED for dim in array.dims}
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {dim: size for dim, size in schema.sizes(spec).items() if dim in used}
        for coordinate in schema.COORDINATES:
            _write_coordinate(file, coordinate, spec)
        for array in EXPORTED:
            _create_variable(file, array, spec, plan)
        for chunk, arrays in blocks(sweep, plan):
            for array in EXPORTED:
                file.variables[array.name][chunk.slices] = arrays[array.name][np.newaxis]
        file.attrs.update(
            {"Conventions": "CF-1.11", "title": spec.name or "bouncing spring", **attributes(spec)}
        )


def _write_coordinate(file: Any, coordinate: schema.Coordinate, spec: SweepSpec) -> None:
    name = coordinate.name
    if name == "direction":
        variable = file.create_variable(name, (name,), h5py.string_dtype())
        variable[...] = np.array(spec.directions, dtype=object)
    else:
        variable = file.create_variable(name, (name,), data=spec.axis_values(name))
    variable.attrs.update(coordinate.attrs)


def _create_variable(file: Any, array: schema.Array, spec: SweepSpec, plan: Plan) -> None:
    sizes = schema.sizes(spec)
    extra = tuple(sizes[dim] for dim in array.extra_dims)
    # Counts have no fill value: CF readers would turn them into floating point.
    fill = array.fill if np.dtype(array.dtype).kind == "f" else None
    variable = file.create_variable(
        array.name, array.dims, np.dtype(array.dtype), fillvalue=fill,
        chunks=(1, *plan.chunk_shape, *extra), compression="gzip", compression_opts=1, shuffle=True,
    )  # fmt: skip
    variable.attrs.update({name: _attribute(value, array.dtype) for name, value in array.attrs.items()})


def _attribute(value: object, dtype: str) -> object:
    """An attribute as CF wants it: flag values have the type of their variable."""
    return np.array(value, dtype) if isinstance(value, list) else value
