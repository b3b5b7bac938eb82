"""The results of a job: diagrams, thresholds, mode maps, exports, the store."""

from abc import ABC, abstractmethod
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.client.errors import BounceError
from service.client.models import JobStatus
from service.client.transport import Transport
from service.formats import EXPORTS, ExportLayout
from service.result_methods import ResultMethods

if TYPE_CHECKING:
    import xarray


class ResultReader(ABC):
    """Reads results by name, of a job or of a spring alone."""

    _transport: Transport

    def result(self, name: str, /, **query: Any) -> "xarray.Dataset":
        """The result of this name, such as "basins", as returned by the method of that name.

        Raises BadRequest naming the parameter, UnexpectedAnswer.
        """
        from service.client.dataset import from_binary

        return from_binary(self.result_file(name, "bin", **query))

    def result_file(self, name: str, format: str, /, **query: Any) -> bytes:
        """A result as the content of a file: png, svg, pdf, csv, nc, parquet or json.

        `timeout` and `progress` in `query` are those of `Transport.get_result`. Raises as `result`.
        """
        return self._transport.get_result(self._path(name), format, **query)

    @abstractmethod
    def _path(self, *parts: str) -> str:
        """The path of a result."""


class Results(ResultReader, ResultMethods, JobStatus):
    """What can be read from a job, also while it runs. `Job` adds what changes it."""

    def export(self, path: str | PathLike[str], *, layout: ExportLayout = "cells") -> Path:
        """Write the whole sweep to a file, NetCDF (.nc) or Parquet (.parquet), and return its path.

        `layout`: what a row of Parquet is, a cell with lists of its flights, or with "flights" each flight.
        The file is written completely or not at all. Raises TooLarge, Busy, BadRequest for another layout,
        BounceError for another suffix.
        """
        target = Path(path)
        format = target.suffix.removeprefix(".")
        if format not in EXPORTS:
            endings = " or ".join(f".{ending}" for ending in EXPORTS)
            raise BounceError(f"{target}: the name of an export ends in {endings}")
        query = {"format": format, "layout": None if layout == "cells" else layout}
        self._transport.download(self._path("export"), query, target)
        return target

    def open(self, chunks: Any = None, direct: bool | None = None) -> "xarray.Dataset":
        """The whole store as a lazy Dataset, read over the client's connection. Raises StoreUnreachable.

        chunks: as `xarray.open_zarr` takes it; `{}` for dask arrays with the chunks that are stored. Such a
        Dataset can be sent to workers of a Dask cluster, with the address of the service and the token.
        direct: whether to read chunks where the service has them (`store_url`), if that can be read from
        here; by default with `chunks`. Damage that is read directly is not reported to the service.
        """
        from service.client.zarr_store import open_store

        return open_store(
            self._transport,
            self._path("zarr"),
            self.id,
            chunks=chunks,
            direct=chunks is not None if direct is None else direct,
        )

    @property
    def store_url(self) -> str:
        """Where the service has the store: a folder of its machine, or s3://BUCKET/PREFIX.

        Raises StoreUnreachable, UnexpectedAnswer.
        """
        from service.client.zarr_store import store_url

        return store_url(self._transport, self._path("zarr"), self.id)

    def _path(self, *parts: str) -> str:
        return "/".join(("/v1/jobs", self.id, *parts))
