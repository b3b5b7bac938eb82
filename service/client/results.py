"""The results of a job: diagrams, thresholds, mode maps, exports, the store."""

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.client.display import PartsCallback
from service.client.errors import BounceError
from service.client.models import JobStatus
from service.client.transport import Transport, json_object
from service.formats import EXPORTS, ExportLayout
from service.result_methods import ResultMethods

if TYPE_CHECKING:
    import xarray


class Results(ResultMethods, JobStatus):
    """What can be read from a job, also while it runs. `Job` adds what changes it."""

    _transport: Transport

    def result(self, name: str, /, **query: Any) -> "xarray.Dataset":
        """The result of this name, such as "basins", as the method of that name returns it.

        Raises BadRequest naming the parameter, UnexpectedAnswer.
        """
        from service.client.dataset import from_binary

        return from_binary(self.result_file(name, "bin", **query))

    def result_file(self, name: str, format: str, /, **query: Any) -> bytes:
        """A result as the content of a file: png, svg, pdf, csv, nc, parquet or json.

        `timeout` and `progress` in `query` are those of `Transport.get_result`. Raises as `result`.
        """
        return self._transport.get_result(self._path(name), format, **query)

    def orbits(
        self,
        omega: float | None = None,
        xi: float | None = None,
        direction: str | None = None,
        *,
        gamma_max: float | None = None,
        energy: bool = False,
        timeout: float = 300.0,
        progress: bool | PartsCallback = True,
    ) -> "xarray.Dataset":
        """Branches of the cycles that the cells along Γ settled to, stable and unstable, with their events.

        `omega` and `xi` take the nearest grid value; `direction` is up or down for a sweep ramped both ways.
        A worker follows the branches up to `gamma_max` (default 8); this waits up to `timeout` seconds, with
        `progress` as in `Client.curves`. Of the rigid contact without restitution.

        Returns a Dataset with dims (branch, point): `gamma`, `multiplier`, `other_multiplier`, `stable`,
        `admissible`, with `energy` the energy balance, `plate_contact` and so on; with dims (branch, point,
        flight): `flight_time`, `takeoff_phase`, `impact_velocity`; coordinates `word`, `bounces`, `periods`;
        NaN beyond the ends. With dim event: `event_branch`, `event_kind`, `event_gamma` and so on; with dim
        cell the periodic cells left out: `skipped_gamma`, `skipped_reason`. Raises BadRequest,
        NotComputedYet, Busy.
        """
        from service.client.datasets import words_dataset

        query: dict[str, str | float | None] = {
            "omega": omega, "xi": xi, "direction": direction, "gamma_max": gamma_max,
            "energy": "true" if energy else None,
        }  # fmt: skip
        answer = self._transport.get_when_computed(
            self._path("orbits"), query, timeout=timeout, progress=progress
        )
        return words_dataset(json_object(answer), self.id)

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
