"""A whole study as one file: written chunk by chunk into a temporary file, then sent.

The file is unlinked before it is sent, so that nothing of it stays on the disk however the request ends.
"""

import errno
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from service.background import Background
from service.errors import ExportFailed, InvalidRequest, NoSpace, NotInstalled, TooLarge
from service.formats import ExportFormat, ExportLayout
from service.views.files import netcdf
from service.views.files.blocks import Block, blocks
from service.views.selection import Stored
from worker.schema import Layout
from worker.studies import Plan, study_of

#: Bytes sent at a time.
PIECE: Final = 256 * 1024
#: Bytes of the disk that an export leaves to jobs and to the ledger.
SPARE: Final = 16 * 2**20

#: A disk with fewer bytes free counts as full when a file could not be written.
FULL: Final = 2**20


@dataclass(frozen=True)
class Export:
    """A study to be written as one file."""

    study: Stored[Any]
    plan: Plan
    format: ExportFormat
    layout: ExportLayout = "cells"  # what a row of a table is
    #: What the file says of the job, as `service.views.provenance.attributes_of` gives it.
    attributes: Mapping[str, str | int | float] = field(default_factory=dict)

    @property
    def stored(self) -> Layout:
        """What is stored of the study."""
        return study_of(self.study.spec).variables(self.study.spec, self.plan.chunk_shape)


def check(spec: Any, plan: Plan, format: ExportFormat, layout: ExportLayout = "cells") -> None:
    """Raise InvalidRequest for complex arrays, which no such file holds, and for rows that there are not.

    Raises NotInstalled for Parquet without its library.
    """
    arrays = study_of(spec).variables(spec, plan.chunk_shape).arrays
    for array in arrays:
        if np.dtype(array.dtype).kind == "c":
            rule = f"{array.name} of this study is complex, and no such file holds that: open its store"
            raise InvalidRequest.of("format", rule)
    if layout == "flights" and format != "parquet":
        raise InvalidRequest.of("layout", f"flights is for parquet, whose rows they are, not for {format}")
    if layout == "flights" and not any(array.dims[-1] == "flight" for array in arrays):
        raise InvalidRequest.of("layout", "this study stores no flights")
    if format == "parquet" and find_spec("pyarrow") is None:
        raise NotInstalled('Parquet needs the extra parquet: pip install "bouncing-spring[parquet]"')


def check_size(study: Stored[Any], plan: Plan, max_bytes: int) -> None:
    """Raise TooLarge for a study of more bytes than one file may hold."""
    size = study_of(study.spec).estimate(study.spec, plan).bytes
    if size > max_bytes:
        raise TooLarge(
            f"the sweep holds {size:,} bytes; the limit for one file is {max_bytes:,}: "
            "open the store itself, which has no such limit"
        )


def make(background: Background, export: Export, folder: Path) -> IO[bytes]:
    """The study's file, written in the background; open for reading and already unlinked.

    Raises NoSpace, another OSError, ExportFailed, NotComputed, a `store.StoreError`.
    """
    folder.mkdir(0o700, parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(suffix=f".{export.format}", dir=folder)
    os.close(handle)
    try:
        background.run(write, export, Path(name))
        return Path(name).open("rb")
    finally:
        Path(name).unlink()


def write(export: Export, path: Path) -> None:
    """Write the study's file. Raises NoSpace, another OSError, ExportFailed, a `store.StoreError`."""
    folder, study, layout = path.parent, export.study, export.stored
    attributes = {**export.attributes, **study.attributes}
    try:
        parts = _while_there_is_room(blocks(study, export.plan, layout), folder)
        if export.format == "nc":
            netcdf.write(study, layout, attributes, parts, path)
        else:
            from service.views.files import parquet

            parquet.write(study, layout, attributes, parts, path, by_flight=export.layout == "flights")
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise NoSpace(f"no space left for the export file: {error.strerror}") from error
        raise
    except ExportFailed as error:  # libhdf5 does not always say why
        if shutil.disk_usage(folder).free < FULL:
            raise NoSpace("no space left for the export file") from error
        raise


def _while_there_is_room(blocks: Iterable[Block], folder: Path) -> Iterator[Block]:
    """The blocks, each if the disk has room for it before compression. Raises NoSpace."""
    for block in blocks:
        size = sum(array.nbytes for array in block.arrays.values())
        if shutil.disk_usage(folder).free < size + SPARE:
            raise NoSpace(f"no space left for the export file: less than {SPARE:,} bytes would stay free")
        yield block


def remove_unfinished(folder: Path) -> None:
    """Remove the files that a killed service left."""
    shutil.rmtree(folder, ignore_errors=True)


def pieces(file: IO[bytes]) -> Iterator[bytes]:
    """The file's bytes."""
    while piece := file.read(PIECE):
        yield piece
