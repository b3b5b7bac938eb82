"""The process that writes a NetCDF file: `python -m service.views.files.netcdf_writer FILE`.

A full disk makes libhdf5 crash, also long after the failed write. So it runs in a process of its own, which
gets a `Head` and then `Part`s through its input, pickled, and ends without a chance for libhdf5 to clean up.
It prints one line of JSON: null, or the error's number and text.
"""

import json
import os
import pickle
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import IO, Any, NamedTuple, NoReturn

import h5netcdf
import h5py
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Variable:
    """An array of the file."""

    dims: tuple[str, ...]
    dtype: str
    chunks: tuple[int, ...]
    fill: float | None  # of cells that are not written; None for zeros
    attrs: Mapping[str, Any]


class Along(NamedTuple):
    """Values along one dimension; lists of text of any length."""

    dim: str
    values: list[str] | NDArray[Any]
    attrs: Mapping[str, Any]


@dataclass(frozen=True)
class Head:
    """What the file is, before its numbers."""

    sizes: Mapping[str, int]  # by dimension
    coordinates: Mapping[str, Along]  # by name
    variables: Mapping[str, Variable]  # by name
    attrs: Mapping[str, Any]


@dataclass(frozen=True)
class Part:
    """The numbers of one block of cells."""

    where: tuple[slice, ...]
    arrays: Mapping[str, NDArray[Any]]  # by name


def write(file: Any, head: Head, parts: Iterator[Part]) -> None:
    """Write into a new h5netcdf file. Raises what h5py raises."""
    file.dimensions = dict(head.sizes)
    for name, (dim, values, attrs) in head.coordinates.items():
        if isinstance(values, list):  # text of any length, which HDF5 has as a type of its own
            file.create_variable(name, (dim,), h5py.string_dtype())[...] = np.array(values, object)
        else:
            file.create_variable(name, (dim,), data=values)
        file.variables[name].attrs.update(attrs)
    for name, variable in head.variables.items():
        created = file.create_variable(
            name, variable.dims, np.dtype(variable.dtype), fillvalue=variable.fill,
            chunks=variable.chunks, compression="gzip", compression_opts=1, shuffle=True,
        )  # fmt: skip
        created.attrs.update(variable.attrs)
    for part in parts:
        for name, values in part.arrays.items():
            file.variables[name][part.where] = values
    file.attrs.update(head.attrs)
    file.flush()


def received(source: IO[bytes]) -> Iterator[Any]:
    """The objects that come until None; without it, whoever sends them has died."""
    while (one := pickle.load(source)) is not None:
        yield one


def main() -> None:
    """Write one file and end at once."""
    try:
        objects = received(sys.stdin.buffer)
        file = h5netcdf.File(sys.argv[1], "w")
        write(file, next(objects), objects)
        file.close()
    except Exception as error:  # noqa: BLE001 - for the process that waits for the report
        finish({"errno": number(error), "text": f"{type(error).__name__}: {error}"})
    finish(None)


def number(error: Exception) -> int | None:
    """The system's error number, which h5py may have in the text only; None if the system refused nothing."""
    found = re.search(r"\berrno = (\d+)", str(error))
    return getattr(error, "errno", None) or (int(found[1]) if found else None)


def finish(report: Any) -> NoReturn:
    """Print the report and end without closing anything: there libhdf5 crashes after a refused write."""
    sys.stdout.write(json.dumps(report))
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
