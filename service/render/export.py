"""A whole sweep as one file: NetCDF for xarray, Parquet for tables; written chunk by chunk, then sent.

The file lies in a folder of its own while it is written and has no name any more while it is sent, so
that nothing is left of it whatever happens.
"""

import errno
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from enum import StrEnum
from pathlib import Path
from typing import IO, Any, Final

import h5netcdf
import h5py
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from kernel.params import KERNEL_VERSION, Outcome
from service.errors import NoSpace, TooLarge
from service.results.diagram import Sweep
from worker import schema as layout
from worker import store
from worker.plan import Chunk, Plan
from worker.spec import AXES, SweepSpec

#: Bytes sent at a time.
PIECE: Final = 256 * 1024

Arrays = dict[str, NDArray[Any]]


class FileFormat(StrEnum):
    """What an export comes as."""

    NETCDF = "nc"
    PARQUET = "parquet"


MEDIA_TYPES: Final[Mapping[FileFormat, str]] = {
    FileFormat.NETCDF: "application/x-netcdf",
    FileFormat.PARQUET: "application/vnd.apache.parquet",
}


def check_size(spec: SweepSpec, most: int) -> None:
    """Raise TooLarge for a sweep of more bytes than one file may hold."""
    size = int(np.prod(spec.shape)) * layout.bytes_per_cell(spec)
    if size > most:
        raise TooLarge(
            f"the sweep holds {size:,} bytes, at most {most:,} are exported as one file: "
            "open the store itself, which has no such limit"
        )


def make(sweep: Sweep, plan: Plan, format: FileFormat, folder: Path) -> IO[bytes]:
    """The sweep's file, open for reading, its name gone already. Raises NoSpace."""
    folder.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(suffix=f".{format}", dir=folder)
    os.close(handle)
    try:
        _WRITERS[format](sweep, plan, Path(name))
        return Path(name).open("rb")
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise NoSpace(f"there is no room for the file: {error.strerror}") from error
        raise
    finally:
        Path(name).unlink()


def sweep_leftovers(folder: Path) -> None:
    """Remove what a killed service left half written."""
    shutil.rmtree(folder, ignore_errors=True)


def pieces(file: IO[bytes]) -> Iterator[bytes]:
    """The file's bytes; closes it."""
    with file:
        while piece := file.read(PIECE):
            yield piece


def _blocks(sweep: Sweep, plan: Plan, names: tuple[str, ...]) -> Iterator[tuple[Chunk, Arrays]]:
    """Every chunk and what the store holds of it, fill values where nothing is computed yet."""
    for chunk in plan:
        try:
            yield chunk, store.read_chunk(sweep.url, chunk, names, complete=sweep.complete)
        except store.StoreMissing as error:
            if sweep.complete:
                raise store.StoreDamaged(str(error)) from error
            # The job is still queued.
            yield chunk, _nothing(sweep.spec, chunk)


def _nothing(spec: SweepSpec, chunk: Chunk) -> Arrays:
    length = layout.sizes(spec)
    found = {}
    for array in layout.arrays(spec):
        shape = (*chunk.shape, *(length[dim] for dim in array.extra_dims))
        found[array.name] = np.full(shape, array.fill, array.dtype)
    return found


def _write_netcdf(sweep: Sweep, plan: Plan, path: Path) -> None:
    """The store's arrays, dimensions and attributes, as NetCDF 4."""
    spec = sweep.spec
    stored = (*layout.RECORD, layout.OUTCOME)
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {
            name: size for name, size in layout.sizes(spec).items() if name in (*layout.CELL_DIMS, "flight")
        }
        for coordinate in layout.COORDINATES:
            _write_coordinate(file, coordinate, spec)
        for array in stored:
            _create_variable(file, array, spec, plan)
        for chunk, arrays in _blocks(sweep, plan, tuple(array.name for array in stored)):
            for array in stored:
                file.variables[array.name][chunk.slices] = arrays[array.name][np.newaxis]
        file.attrs.update(
            {
                "Conventions": "CF-1.11",
                "title": spec.name or "bouncing spring",
                "kernel_version": KERNEL_VERSION,
                "spec": json.dumps(spec.as_submitted()),
            }
        )


def _write_coordinate(file: Any, coordinate: layout.Coordinate, spec: SweepSpec) -> None:
    name = coordinate.name
    if name == "direction":
        variable = file.create_variable(name, (name,), h5py.string_dtype())
        variable[...] = np.array(spec.directions, dtype=object)
    else:
        variable = file.create_variable(name, (name,), data=spec.axis_values(name))
    variable.attrs.update(coordinate.attrs)


def _create_variable(file: Any, array: layout.Array, spec: SweepSpec, plan: Plan) -> None:
    length = layout.sizes(spec)
    extra = tuple(length[dim] for dim in array.extra_dims)
    variable = file.create_variable(
        array.name, array.dims, np.dtype(array.dtype), fillvalue=None if array.dtype != "<f8" else np.nan,
        chunks=(1, *plan.chunk_shape, *extra), compression="gzip", compression_opts=1, shuffle=True,
    )  # fmt: skip
    variable.attrs.update({name: _attribute(value, array.dtype) for name, value in array.attrs.items()})


def _attribute(value: object, dtype: str) -> object:
    """An attribute as NetCDF wants it: flag values are of the variable's own type."""
    return np.array(value, dtype) if isinstance(value, list) else value


_FLIGHTS: Final = pa.list_(pa.float64())
_TABLE: Final = pa.schema(
    [
        ("direction", pa.string()),
        *((axis, pa.float64()) for axis in ("gamma", "omega", "xi")),
        ("outcome", pa.string()),
        ("flights", pa.int32()),
        ("bounces", pa.int16()),
        ("periods", pa.int16()),
        ("flight_time", _FLIGHTS),
        ("takeoff_phase", _FLIGHTS),
    ]
)  # fmt: skip


def _write_parquet(sweep: Sweep, plan: Plan, path: Path) -> None:
    """One row a cell, chunk after chunk; its flights as lists."""
    spec = json.dumps(sweep.spec.as_submitted())
    schema = _TABLE.with_metadata({"spec": spec, "kernel_version": KERNEL_VERSION})
    names = tuple(array.name for array in (*layout.RECORD, layout.OUTCOME))
    with parquet.ParquetWriter(path, schema, compression="zstd") as file:
        for chunk, arrays in _blocks(sweep, plan, names):
            file.write_batch(_rows(sweep.spec, chunk, arrays, schema))


def _rows(spec: SweepSpec, chunk: Chunk, arrays: Arrays, schema: pa.Schema) -> pa.RecordBatch:
    values = [spec.axis_values(axis)[slice(*getattr(chunk, axis))] for axis in AXES]
    grid = dict(zip(AXES, np.meshgrid(*values, indexing="ij"), strict=True))
    flights = arrays["flights"].ravel()
    columns = {
        "direction": np.full(chunk.cells, spec.directions[chunk.direction]),
        **{axis: grid[axis].ravel() for axis in AXES},
        "outcome": np.array([outcome.name.lower() for outcome in Outcome])[arrays["outcome"].ravel()],
        **{name: arrays[name].ravel() for name in ("flights", "bounces", "periods")},
        **{name: _lists(arrays[name], flights) for name in ("flight_time", "takeoff_phase")},
    }
    return pa.record_batch([pa.array(columns[name]) for name in schema.names], schema=schema)


def _lists(values: NDArray[np.float64], flights: NDArray[np.int32]) -> pa.Array:
    """The flights that are kept of each cell, (cells, keep) → a list for every cell."""
    keep = values.shape[-1]
    kept = np.minimum(flights, keep)
    offsets = np.concatenate([[0], np.cumsum(kept)]).astype(np.int32)
    flat = values.reshape(-1, keep)[np.arange(keep) < kept[:, None]]
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(flat))


_WRITERS: Final[Mapping[FileFormat, Callable[[Sweep, Plan, Path], None]]] = {
    FileFormat.NETCDF: _write_netcdf,
    FileFormat.PARQUET: _write_parquet,
}
