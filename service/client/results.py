"""The results of a job: diagrams, thresholds, mode maps, exports, the store."""

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.client.display import PartsCallback
from service.client.errors import BounceError
from service.client.models import JobStatus
from service.client.result_methods import ResultMethods
from service.client.transport import Transport, json_object
from service.formats import EXPORTS, ExportLayout, MultistabilityFormat, Predict

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

    def threshold(
        self,
        xi: float | None = None,
        *,
        tolerance: float | None = None,
        predict: Predict = "some",
        timeout: float = 300.0,
        progress: bool | PartsCallback = True,
    ) -> "xarray.Dataset":
        """The bouncing threshold per Ω: `analytic` by Eq. 25, `up` and `down` as computed.

        `up_status` and `down_status` tell what the sweep says: "found", or why `up` or `down` is NaN: "below
        the grid" (the lowest Γ bounces already), "above the grid", "never bounces", "not ramped", "not
        refined", or the outcome of the cell that decides: "missing", "unresolved", "diverged", "settling".

        Without `tolerance`, `up` and `down` are values of the Γ grid. With a `tolerance` (in Γ) workers
        refine them from the stored states; this waits up to `timeout` seconds, with `progress` as in
        `Client.curves`.

        `predicted_jump`, `predicted_down` and `cause` are those of the closed form for up to 200 values of Ω.
        With `predict` "all" workers predict every Ω; with "words" they also follow the cycles of the lowest
        settled cells where the closed form alone is unresolved. `predicted_down` is the lowest Γ at which
        anything bounces for ever, `down` where the descent of this sweep ends: there or above.

        Raises BadRequest, as for a ξ outside the grid, TooLarge, NotComputedYet, Busy.
        """
        from service.client.datasets import threshold_dataset

        query = {"xi": xi, "tolerance": tolerance, "predict": predict}
        answer = self._transport.get_when_computed(
            self._path("threshold"), query, timeout=timeout, progress=progress
        )
        return threshold_dataset(json_object(answer), self.id)

    def multistability(self, xi: float | None = None, *, omega: float | None = None) -> "xarray.Dataset":
        """The attractors over (omega, gamma) of a job with the protocol multistability, matched over cells.

        `xi` and `omega` take the nearest grid value; with `omega` only that line. Returns a Dataset with dims
        (omega, gamma): `count`, -1 where a cell is not computed; with dims (omega, gamma, place) the
        attractors of each cell: `id`, 0 where there is none, `label`, `fraction`, `longest_flight` (rad);
        with dim attractor: `attractor_label`, `cells`; with dim event: `kind` (birth, death, mode),
        `event_attractor`, `event_omega`, `gamma_below`, `gamma_above`, `below`, `above`, `leads_to`, 0 for
        none. With `omega` also `flight_time` (rad) over (omega, gamma, place, flight). Attributes: `several`
        and `several_by_drops`, the shares of cells with two attractors or more; `complete`. Raises
        BadRequest, TooLarge.
        """
        from service.client.datasets import multistability_dataset

        query = {"xi": xi, "omega": omega}
        answer = json_object(self._transport.get(self._path("multistability"), query))
        return multistability_dataset(answer, self.id)

    def multistability_picture(
        self,
        format: MultistabilityFormat = "png",
        *,
        xi: float | None = None,
        omega: float | None = None,
    ) -> bytes:
        """Attractors over a plane, or with `omega` a line, as PNG, SVG, JSON or CSV. Raises BadRequest."""
        query = {"xi": xi, "omega": omega, "format": format}
        return self._transport.get(self._path("multistability"), query).content

    def trajectory(
        self,
        gamma: float | None = None,
        omega: float | None = None,
        xi: float | None = None,
        *,
        direction: str | None = None,
        periods: int = 4,
        samples: int = 200,
    ) -> "xarray.Dataset":
        """The motion of one cell as the sweep has it: settled from rest, or from where its ramp left it.

        `gamma`, `omega`, `xi` take the nearest grid value; one that has only one value may be left out.
        `direction` is up or down for a sweep ramped both ways (default: up). `periods` plate periods of
        `samples` each. Returns a Dataset as `Client.trajectory`. Raises BadRequest, Conflict while the cell
        is not computed, TooLarge, Busy.
        """
        from service.client.datasets import trajectory_dataset

        query = {
            "gamma": gamma, "omega": omega, "xi": xi, "direction": direction,
            "periods": periods, "samples": samples,
        }  # fmt: skip
        return trajectory_dataset(json_object(self._transport.get(self._path("trajectory"), query)))

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
