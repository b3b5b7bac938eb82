"""Encodes a Dataset as JSON, binary, NetCDF, CSV, Parquet or a picture. Knows no result by name."""

import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from itertools import chain
from math import prod
from typing import Any, Final

import numpy as np
import orjson
import xarray
from numpy.typing import NDArray

from service.errors import NotInstalled
from service.pictures import DPI, STYLE, Figure, metadata

#: Rows of a table converted at a time.
ROWS: Final = 2**16
#: Rows or bytes with which a row group of Parquet is written: large enough to be read fast, small enough to
#: be skipped and held in memory.
GROUP_ROWS: Final = 2**17
GROUP_BYTES: Final = 16 * 2**20
#: Most numbers along further dimensions, such as exponents, that CSV spreads over columns. It omits more.
COLUMNS: Final = 8
#: Arrays begin at a multiple of this many bytes, as typed arrays of a browser require.
ALIGNMENT: Final = 8


def to_json(dataset: xarray.Dataset) -> bytes:
    """The form of `xarray.Dataset.to_dict` with the dtype of every variable. NaN and inf become null."""
    return orjson.dumps(_document(dataset, np.asarray), _for_json, orjson.OPT_SERIALIZE_NUMPY)


def _for_json(values: NDArray[Any]) -> Any:
    """Replace an array that orjson refuses: a text, a scalar, or one that is not contiguous or native."""
    if values.ndim == 0 or values.dtype.kind in "UOT":
        return values.tolist()
    return np.ascontiguousarray(values, values.dtype.newbyteorder("="))


def to_binary(dataset: xarray.Dataset) -> bytes:
    """A line with the JSON document, then the arrays, little-endian.

    In the document the data of an array are {"offset", "shape"}, the offset in bytes from the end of the
    line. Scalars and texts stay in the line.
    """
    arrays: list[bytes] = []
    end = 0

    def placed(values: NDArray[Any]) -> Any:
        nonlocal end
        if values.ndim == 0 or values.dtype.kind in "UOT":
            return values.tolist()
        content = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes()
        arrays.append(content.ljust(_aligned(len(content)), b"\0"))
        offset, end = end, end + len(arrays[-1])
        return {"offset": offset, "shape": values.shape}

    line = orjson.dumps(_document(dataset, placed), option=orjson.OPT_SERIALIZE_NUMPY)
    return b"".join([line.ljust(_aligned(len(line) + 1) - 1), b"\n", *arrays])


def _aligned(size: int) -> int:
    return -(-size // ALIGNMENT) * ALIGNMENT


def _document(dataset: xarray.Dataset, data: Callable[[NDArray[Any]], Any]) -> dict[str, Any]:
    # from `variables`, as making a DataArray takes fifty times as long
    def described(names: Iterable[Any]) -> dict[str, Any]:
        return {
            str(name): {"dims": v.dims, "attrs": v.attrs, "dtype": _dtype(v.dtype), "data": data(v.values)}
            for name, v in ((name, dataset.variables[name]) for name in names)
        }

    return {
        "coords": described(dataset.coords), "data_vars": described(dataset.data_vars),
        "dims": dict(dataset.sizes), "attrs": dataset.attrs,
    }  # fmt: skip


def _dtype(dtype: np.dtype[Any]) -> str:
    return "str" if dtype.kind in "UOT" else dtype.name


def to_netcdf(dataset: xarray.Dataset) -> bytes:
    """NetCDF 4. Booleans, which NetCDF lacks, become integers; only data of floats have a fill value."""
    written = dataset.copy()
    written.attrs = {name: int(x) if isinstance(x, bool) else x for name, x in dataset.attrs.items()}
    for variable in written.variables.values():
        variable.attrs = as_cf(variable.attrs, variable.dtype)
    filled = {name for name, v in written.data_vars.items() if v.dtype.kind == "f"}
    encoding = {name: {"_FillValue": None} for name in written.variables.keys() - filled}
    return bytes(written.to_netcdf(engine="h5netcdf", encoding=encoding))


def as_cf(attrs: Mapping[Any, Any], dtype: Any) -> dict[Any, Any]:
    """Attributes as CF requires: flag values have the type of their variable, and units are of UDUNITS.

    To it A is an ampere, and m a metre. The long name tells other units.
    """
    described = {name: np.array(x, dtype) if isinstance(x, list) else x for name, x in attrs.items()}
    if (units := attrs.get("units", "1")) not in ("1", "rad"):
        described |= {"long_name": f"{attrs['long_name']}, in {units}", "units": "1"}
    return described


def to_csv(dataset: xarray.Dataset, rows: str) -> bytes:
    """A header and one line per row of `tables`; NaN is empty."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    for i, part in enumerate(tables(dataset, rows, lists=False)):
        if i == 0:
            writer.writerow(part)
        writer.writerows(zip(*map(_texts, part.values()), strict=True))
    return file.getvalue().encode()


def _texts(values: NDArray[Any]) -> list[Any]:
    """The values for lines of CSV, with empty texts for NaN."""
    if values.dtype.kind == "f" and (missing := np.isnan(values)).any():
        values = np.where(missing, "", values.astype(object))
    return list(values.tolist())


def to_parquet(dataset: xarray.Dataset, rows: str) -> bytes:
    """The rows of `tables` with lists; attributes are metadata of the table."""
    file = io.BytesIO()
    write_parquet(file, map(record_batch, tables(dataset, rows, lists=True)), dataset.attrs)
    return file.getvalue()


def check_format(format: str) -> None:
    """Raise NotInstalled for Parquet without its library."""
    if format == "parquet" and find_spec("pyarrow") is None:
        raise NotInstalled('Parquet needs the extra parquet: pip install -e ".[parquet]"')


def write_parquet(target: Any, batches: Iterator[Any], attributes: Mapping[Any, Any]) -> None:
    """Write record batches, at least one, to a file or its path, with the attributes as metadata."""
    import pyarrow as pa
    from pyarrow import parquet

    first = next(batches)
    schema = first.schema.with_metadata({name: str(x) for name, x in attributes.items()})
    try:
        repeating = [x.name for x in schema if not pa.types.is_list(x.type)]  # hardly any flight repeats
        with parquet.ParquetWriter(target, schema, compression="zstd", use_dictionary=repeating) as file:
            for group in _groups(chain([first], batches)):
                file.write_table(pa.Table.from_batches(group).cast(schema), row_group_size=GROUP_ROWS)
    finally:
        pa.default_memory_pool().release_unused()  # else it keeps it for its next arrays


def _groups(batches: Iterable[Any]) -> Iterator[list[Any]]:
    """The batches in groups that are large enough, except perhaps the last."""
    group: list[Any] = []
    rows = size = 0
    for batch in batches:
        group.append(batch)
        rows, size = rows + batch.num_rows, size + batch.nbytes
        if rows >= GROUP_ROWS or size >= GROUP_BYTES:
            yield group
            group, rows, size = [], 0, 0
    if group:
        yield group


def record_batch(columns: Mapping[str, Any]) -> Any:
    """The columns as a `pyarrow.RecordBatch`; columns of objects are texts, even without rows."""
    import pyarrow as pa

    objects = {name: x for name, x in columns.items() if isinstance(x, np.ndarray) and x.dtype.kind == "O"}
    return pa.record_batch({**columns, **{name: pa.array(x, pa.string()) for name, x in objects.items()}})


DATASETS: Final = {"json": to_json, "bin": to_binary, "nc": to_netcdf}
TABLES: Final[dict[str, Callable[..., bytes]]] = {"csv": to_csv, "parquet": to_parquet}


#: The rows of a table: which places of the variable that defines them.
Rows = NDArray[Any] | slice


def tables(dataset: xarray.Dataset, rows: str, *, lists: bool) -> Iterator[dict[str, Any]]:
    """Tables with one row for each number of the variable `rows`, without NaN, some thousand rows each.

    Columns are the coordinates and the variables over dimensions of `rows`, as arrays. A variable with a
    further dimension is a column of lists, a `pyarrow.ListArray`; without `lists`, one column for each
    position along it. Codes appear as their `flag_meanings`.
    """
    dims = tuple(map(str, dataset.variables[rows].dims))
    for part in _parts(dataset, dims):
        counted = part.variables[rows].values.ravel()
        selected: Rows = np.flatnonzero(~np.isnan(counted)) if counted.dtype.kind == "f" else slice(None)
        yield dict(_columns(part, dims, selected, lists))


def _parts(dataset: xarray.Dataset, dims: tuple[str, ...]) -> Iterator[xarray.Dataset]:
    """The Dataset cut along `dims`, the first slowest, into parts of about ROWS rows."""
    first, *others = dims
    rows = prod(dataset.sizes[dim] for dim in others)
    step = max(1, ROWS // max(1, rows))
    for low in range(0, max(1, dataset.sizes[first]), step):
        part = dataset.isel({first: slice(low, low + step)})
        yield from _parts(part, tuple(others)) if rows > ROWS else [part]


def _columns(
    part: xarray.Dataset, dims: tuple[str, ...], selected: Rows, lists: bool
) -> Iterator[tuple[str, Any]]:
    for dim in dims:
        if dim not in part.coords:
            yield dim, _repeated(part, (dim,), np.arange(part.sizes[dim], dtype=np.int32), dims)[selected]
    for name in map(str, (*part.coords, *part.data_vars)):
        variable = part.variables[name]
        extra = [str(dim) for dim in variable.dims if dim not in dims]
        if not extra:
            yield name, _column(part, variable, dims, selected)
        elif len(extra) == variable.ndim:  # the same for all rows, such as a map of starts
            continue
        elif lists:
            yield name, _list_column(part, variable, dims, selected)
        elif prod(sizes := [part.sizes[dim] for dim in extra]) <= COLUMNS:
            for index in np.ndindex(*sizes):
                numbers = "_".join(str(i + 1) for i in index)
                cell = variable.isel(dict(zip(extra, index, strict=True)))
                yield f"{name}_{numbers}", _column(part, cell, dims, selected)


def _column(
    part: xarray.Dataset, variable: xarray.Variable, dims: tuple[str, ...], selected: Rows
) -> NDArray[Any]:
    values = _repeated(part, variable.dims, variable.values, dims)[selected]
    if "flag_values" in variable.attrs:
        codes = [int(code) for code in variable.attrs["flag_values"]]
        meanings = dict(zip(codes, variable.attrs["flag_meanings"].split(), strict=True))
        values = np.array([meanings.get(code, "") for code in range(max(codes) + 1)], object)[values]
    return np.asarray(values, object if values.dtype.kind in "UT" else None)


def _list_column(
    part: xarray.Dataset, variable: xarray.Variable, dims: tuple[str, ...], selected: Rows
) -> Any:
    """The numbers of each row along the other dimensions, in lists; flights without the NaN at the end."""
    import pyarrow as pa

    rows = _repeated(part, variable.dims, variable.values, dims)[selected]
    numbers = rows.reshape(len(rows), prod(rows.shape[1:]))
    most = numbers.shape[1]
    lengths = np.full(len(rows), most)
    if variable.dims[-1] == "flight" and numbers.dtype.kind == "f":
        finite = ~np.isnan(numbers)
        lengths = np.where(finite.any(axis=1), most - finite[:, ::-1].argmax(axis=1), 0)
    ends = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
    return pa.ListArray.from_arrays(ends, pa.array(numbers[np.arange(most) < lengths[:, None]]))


def _repeated(
    part: xarray.Dataset, own: tuple[Any, ...], values: NDArray[Any], dims: tuple[str, ...]
) -> NDArray[Any]:
    """Values over the dimensions `own`, as one entry or one array for each row of all `dims`."""
    extra = [dim for dim in own if dim not in dims]
    variable: Any = xarray.Variable(own, values)
    wide = variable.set_dims({dim: part.sizes[dim] for dim in (*dims, *extra)})
    return np.asarray(wide.values.reshape(prod(wide.shape[: len(dims)]), *wide.shape[len(dims) :]))


#: The fonts of an SVG. Lines with a formula name the first alone otherwise; the last before any is as narrow.
_FONTS: Final = ", ".join(
    [*(f"'{name}'" for name in STYLE["font.serif"]), "'DejaVu Serif Condensed'", "serif"]
)

#: The one thread that draws: matplotlib's settings belong to the process, its open font files to the thread.
_THREAD: Final = ThreadPoolExecutor(1, thread_name_prefix="pictures")


def picture(
    size: tuple[float, float], draw: Callable[[Figure], None], format: str, origin: Mapping[str, str]
) -> bytes:
    """The bytes of a picture; the same drawing gives the same bytes.

    size: inches. origin: job, specification and versions by name, for the file's metadata.
    """
    return _THREAD.submit(_picture, size, draw, format, origin).result()


def _picture(
    size: tuple[float, float], draw: Callable[[Figure], None], format: str, origin: Mapping[str, str]
) -> bytes:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=size, dpi=DPI, layout="constrained")
        draw(figure)
        file = io.BytesIO()
        figure.savefig(file, format=format, metadata=metadata(format, origin))
    if format == "svg":
        return re.sub(
            rb"font-family: 'STIXGeneral'[^\";]*", f"font-family: {_FONTS}".encode(), file.getvalue()
        )
    return file.getvalue()
