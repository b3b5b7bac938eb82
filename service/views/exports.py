"""Exports a whole study as one file, chunk by chunk: NetCDF with the store's arrays, or Parquet with rows.

The file is unlinked before it is sent, so that it never stays on the disk, however the request ends.
"""

import errno
import io
import json
import math
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
import xarray
from numpy.typing import NDArray

from service.background import Background
from service.errors import InvalidRequest, NoSpace, TooLarge
from service.formats import ExportFormat, ExportLayout
from service.jobs.prepare import PreparedJob
from service.jobs.stores import sharing
from service.ledger.model import JobRecord, JobState
from service.views import shared
from service.views.encode import as_cf, check_format, record_batch, tables, write_parquet
from service.views.selection import LABEL, Stored, labelled, read_stored
from worker.studies import study_of
from worker.study import Array, Layout, Plan
from worker.study.layout import SOURCE, flat_attributes
from worker.sweep import SweepSpec, schema

#: A chunk: the cells it spans, by dimension in the order of the store, and its arrays by name.
_Block = tuple[Mapping[str, slice], Mapping[str, NDArray[Any]]]

#: Suffixes of the parts of a complex array.
_COMPLEX: Final = ("real", "imag")

#: Bytes of the disk that an export leaves to jobs and to the ledger.
SPARE: Final = 16 * 2**20


def attributes_of(job: JobRecord, prepared: PreparedJob) -> dict[str, str | int | float]:
    """Attributes of a file, the same in every format: texts and numbers, other values as JSON.

    The store's attributes depend on the specification alone. A file adds how it was computed: software,
    libraries, processor, times and core-seconds. Workers must have the versions of the service.
    """
    layout, runs = prepared.layout, json.loads(job.runs)
    software = [f"bouncing-spring {run['release']}, kernel version {job.kernel_version}" for run in runs]
    events = [(job.created, "accepted")]
    events += [(run["began"], f"computing with {text}") for run, text in zip(runs, software, strict=True)]
    if job.finished is not None and not job.repairing:
        is_own = job.core_seconds or job.state is not JobState.DONE  # neither imported nor adopted
        events.append((job.finished, str(job.state) if is_own else "taken in"))
    events.sort(key=itemgetter(0))  # an imported job was computed before it was accepted
    times = [f"{datetime.fromtimestamp(when, UTC):%Y-%m-%dT%H:%M:%SZ} {what}" for when, what in events]
    attributes = {**layout.attributes, **prepared.attributes, **layout.identity}
    attributes["spec"] = {**attributes["spec"], "name": job.name}
    attributes["title"] = job.name or attributes["title"]
    attributes |= {"job": job.id, "kernel_version": job.kernel_version, "history": "\n".join(times)}
    attributes["source"] = SOURCE.format(job.kernel_version)
    if runs:
        libraries = {"python": runs[-1]["python"], **runs[-1]["libraries"]}
        attributes |= {
            "software": software[-1], "libraries": libraries, "processor": runs[-1]["processor"],
        }  # fmt: skip
    if job.core_seconds:  # unknown for adopted results
        attributes["core_seconds"] = round(job.core_seconds, 3)
    return flat_attributes(attributes)


@dataclass(frozen=True)
class Export:
    """A study to be written as one file."""

    study: Stored[Any]
    plan: Plan
    format: ExportFormat
    layout: ExportLayout = "cells"  # what a row of a table is
    attributes: Mapping[str, str | int | float] = field(default_factory=dict)  # see `attributes_of`
    runs: str = "[]"  # of the job

    @cached_property
    def stored(self) -> Layout:
        """The layout of the study's store."""
        return study_of(self.study.spec).variables(self.study.spec, self.plan.chunk_shape)

    @property
    def arrays(self) -> tuple[Array, ...]:
        """The arrays of the file: all stored ones, and the label of a sweep with exponents."""
        spec = self.study.spec
        labels = (LABEL,) if isinstance(spec, SweepSpec) and spec.exponents else ()
        return tuple(part for row in (*self.stored.arrays, *labels) for part in _parts(row))


def _parts(row: Array) -> tuple[Array, ...]:
    """The arrays that replace an array in NetCDF: real and imaginary parts, and 0 and 1 for booleans."""
    if row.dtype == "|b1":
        return (row._replace(dtype="|u1"),)
    if row.dtype != "<c16":
        return (row,)
    attrs = {part: row.attrs | {"long_name": f"{row.attrs['long_name']}, {part} part"} for part in _COMPLEX}
    return tuple(Array(f"{row.name}_{part}", row.dims, "<f8", np.nan, attrs[part]) for part in _COMPLEX)


def check(
    spec: Any, plan: Plan, format: ExportFormat, layout: ExportLayout = "cells", max_bytes: float = math.inf
) -> None:
    """Check that a study can be exported.

    Raises InvalidRequest for a page of another study than a sweep, and for rows of flights that it lacks;
    NotInstalled for Parquet without its library; TooLarge for a study of more than `max_bytes`.
    """
    arrays = study_of(spec).variables(spec, plan.chunk_shape).arrays
    if format == "html" and not isinstance(spec, SweepSpec):
        rule = f"html, a page to share, is for sweeps, not for {spec.protocol.kind}: nc has all its results"
        raise InvalidRequest.of("format", rule)
    if layout == "flights" and format != "parquet":
        raise InvalidRequest.of("layout", f"flights is for parquet, whose rows they are, not for {format}")
    if layout == "flights" and not any(array.dims[-1] == "flight" for array in arrays):
        raise InvalidRequest.of("layout", "this study stores no flights")
    check_format(format)
    size = study_of(spec).estimate(spec, plan).bytes
    if size > max_bytes and format != "html":  # a page thins its flights
        raise TooLarge(
            f"the sweep holds {size:,} bytes; the limit for one file is {max_bytes:,}: "
            "open the store itself, which has no such limit"
        )


def make(background: Background, export: Export, folder: Path) -> IO[bytes]:
    """Write the study's file in the background; returns it open for reading, and already unlinked.

    Raises NoSpace, another OSError, NotComputed, a `store.StoreError`.
    """
    folder.mkdir(0o700, parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(suffix=f".{export.format}", dir=folder) as made:
        background.run(write, export, Path(made.name))
        return Path(made.name).open("rb")


def write(export: Export, path: Path) -> None:
    """Write the study's file. Raises NoSpace, another OSError, a `store.StoreError`."""
    try:
        if export.format == "html":
            url = export.study.url
            name = json.loads(str(export.attributes["spec"]))["name"]
            numbers = ""
            if export.study.complete:
                numbers = sharing.packed(url, export.stored, export.plan, name, export.runs)
            path.write_text(shared.page(export.study, export.attributes, numbers))
        elif export.format == "nc":
            _write_netcdf(export, _blocks(export, path.parent), path)
        else:
            blocks = _blocks(export, path.parent)
            batches = chain.from_iterable(_record_batches(export, *block) for block in blocks)
            write_parquet(path, batches, {**export.attributes, **export.study.attributes})
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise NoSpace(f"no space left for the export file: {error.strerror}") from error
        raise


def _blocks(export: Export, folder: Path) -> Iterator[_Block]:
    """The chunks of the plan, with fill values in cells that are not computed yet.

    Raises NoSpace if the disk has no room for a chunk before compression.
    """
    study, layout = export.study, export.stored
    for chunk in export.plan:
        cells = dict(zip(layout.chunk_sizes, chunk.slices, strict=True))
        arrays = read_stored(study, layout.names, cells)
        if isinstance(study.spec, SweepSpec):
            arrays |= labelled(study.spec, arrays[schema.OUTCOME.name], arrays)
        for name, values in list(arrays.items()):
            if values.dtype.kind == "b":
                arrays[name] = values.view(np.uint8)
            elif values.dtype.kind == "c":
                arrays |= {f"{name}_real": values.real, f"{name}_imag": values.imag}
                del arrays[name]
        if shutil.disk_usage(folder).free < sum(array.nbytes for array in arrays.values()) + SPARE:
            raise NoSpace(f"no space left for the export file: less than {SPARE:,} bytes would stay free")
        yield cells, arrays


class _UnrefusedFile(io.FileIO):
    """A file that hides refused writes from libhdf5, which crashes after one, even long after."""

    refused: OSError | None = None

    def write(self, content: Any) -> int:
        left = memoryview(content)
        try:
            while left:
                left = left[super().write(left) :]
        except OSError as error:
            self.refused = error
        return len(content)


def _write_netcdf(export: Export, blocks: Iterable[_Block], path: Path) -> None:
    """NetCDF 4 with the dimensions, coordinates, arrays and attributes of the store."""
    import h5netcdf
    import h5py

    with _UnrefusedFile(path, "w+") as target:
        try:
            with h5py.File(target, "w", track_order=True) as file:
                with h5netcdf.File(file, "w") as described:
                    _define(described, export)
                datasets = {name: file[name] for name in file}  # h5netcdf takes longer to find and write one
                for cells, arrays in blocks:
                    for name, values in arrays.items():
                        datasets[name][tuple(cells.values())] = values
                    if target.refused:
                        break
        except OSError:
            if not target.refused:
                raise
        if target.refused:
            raise target.refused


def _define(file: Any, export: Export) -> None:
    import h5py

    layout = export.stored
    file.dimensions = {
        dim: n for row in export.arrays for dim, n in zip(row.dims, layout.shape(row), strict=True)
    }
    for name, values in layout.coordinates.items():
        if values.dtype.kind == "T":  # HDF5 has its own type for text of any length
            file.create_variable(name, (name,), h5py.string_dtype())[...] = values.astype(object)
        else:
            file.create_variable(name, (name,), data=values)
        file.variables[name].attrs.update(layout.coordinate_attrs[name])
    for name, code in layout.codes.items():
        file.create_variable(name, (code.dim,), data=code.values).attrs.update(as_cf(code.attrs, "|u1"))
    for row in export.arrays:
        dtype = np.dtype(row.dtype)
        created = file.create_variable(
            row.name, row.dims, dtype, chunks=layout.inner_shape(row) or layout.chunk_shape(row),
            # no fill value of counts: CF readers would turn them into floating point
            fillvalue=row.fill if dtype.kind == "f" else None,
            compression="gzip", compression_opts=1, shuffle=True,
        )  # fmt: skip
        created.attrs.update(as_cf(layout.array_attrs(row), row.dtype))
    file.attrs.update({**export.attributes, **export.study.attributes})


def _record_batches(
    export: Export, cells: Mapping[str, slice], arrays: Mapping[str, NDArray[Any]]
) -> Iterator[Any]:
    """The rows of a chunk: of its cells, of attractors of a cell, or of flights."""
    coords = {}
    for name, values in export.stored.coordinates.items():
        part = values[cells.get(name, slice(None))]
        coords[name] = (name, part.astype(object) if part.dtype.kind == "T" else part)
    variables = {row.name: (row.dims, arrays[row.name], row.attrs) for row in export.arrays}
    dataset = xarray.Dataset(variables, coords).drop_dims({"row", "column"}, errors="ignore")
    by_flight = export.layout == "flights"
    rows = "fraction" if "fraction" in dataset else schema.OUTCOME.name
    return map(record_batch, tables(dataset, "flight_time" if by_flight else rows, lists=not by_flight))
