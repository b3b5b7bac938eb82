"""A study as NetCDF 4: the dimensions, coordinates, arrays and attributes of its store, chunk by chunk.

The file is written by another process, see `netcdf_writer`.
"""

import json
import os
import pickle
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from service.errors import ExportFailed
from service.views.files import netcdf_writer
from service.views.files.blocks import Block, exported
from service.views.files.netcdf_writer import Along, Head, Part, Variable
from service.views.selection import Stored
from worker.schema import Array, Layout

#: -P: no module is imported from the current folder.
_WRITER: Final = (sys.executable, "-P", "-m", netcdf_writer.__name__)


def write(
    study: Stored[Any],
    layout: Layout,
    attributes: Mapping[str, str | int | float],
    blocks: Iterable[Block],
    path: Path,
) -> None:
    """Write the study's file. Raises OSError, ExportFailed, and what `blocks` raises."""
    with subprocess.Popen(
        [*_WRITER, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={name: value for name, value in os.environ.items() if not name.startswith("BOUNCE_")},
        # Ctrl-C is for the service, which waits for the file when it stops. Not a session of its own: Linux
        # shares the processors among sessions first, so that its niceness would count for nothing.
        process_group=0,
    ) as process:
        assert process.stdin
        assert process.stdout
        try:
            _send(
                chain([_head(study, layout, attributes)], _parts(blocks), [None]),
                process.stdin,
            )
        except BaseException:
            process.kill()
            raise
        answer = process.stdout.read()
    _check(answer, process.returncode)


def _send(objects: Iterable[Any], pipe: IO[bytes]) -> None:
    """Send all that the writer takes: one that has met an error takes no more."""
    try:
        for one in objects:
            try:
                pickle.dump(one, pipe, pickle.HIGHEST_PROTOCOL)
            except BrokenPipeError:
                return
    finally:
        with suppress(BrokenPipeError):
            pipe.close()


def _parts(blocks: Iterable[Block]) -> Iterator[Part]:
    for block in blocks:
        yield Part(tuple(block.cells.values()), block.arrays)


def _check(answer: bytes, returncode: int) -> None:
    """Raise the error that the writer reports, or ExportFailed if it has died."""
    if not answer:
        raise ExportFailed(f"the process that writes the file has died ({returncode})")
    report = json.loads(answer)
    if report is None:
        return
    if report["errno"] is not None:
        raise OSError(report["errno"], os.strerror(report["errno"]))
    raise ExportFailed(report["text"])


def _head(study: Stored[Any], layout: Layout, attributes: Mapping[str, str | int | float]) -> Head:
    arrays, attrs = exported(study.spec, layout), layout.coordinate_attrs
    return Head(
        sizes={
            dim: size for array in arrays for dim, size in zip(array.dims, layout.shape(array), strict=True)
        },
        coordinates={
            name: Along(name, values.tolist() if values.dtype.kind == "T" else values, attrs[name])
            for name, values in layout.coordinates.items()
        }
        | {
            name: Along(code.dim, code.values, _with_flags(code.attrs, "|u1"))
            for name, code in layout.codes.items()
        },
        variables={array.name: _variable(array, layout) for array in arrays},
        attrs=dict(attributes),
    )


def _variable(array: Array, layout: Layout) -> Variable:
    # Counts have no fill value: CF readers would turn them into floating point.
    fill = array.fill if np.dtype(array.dtype).kind == "f" else None
    attrs = _with_flags(layout.array_attrs(array), array.dtype)
    return Variable(array.dims, array.dtype, layout.chunk_shape(array), fill, attrs)


def _with_flags(attrs: Mapping[str, Any], dtype: str) -> dict[str, Any]:
    """Attributes as CF wants them: flag values have the type of their variable."""
    return {
        name: np.array(value, dtype) if isinstance(value, list) else value for name, value in attrs.items()
    }
