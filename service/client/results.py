"""What a job has found, asked of the service."""

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from service.client.display import Parts
from service.client.errors import BounceError
from service.client.transport import Transport, document

if TYPE_CHECKING:
    import httpx2
    import xarray


class Results:
    """The results of one job; `Job` is one of these."""

    id: str
    _transport: Transport

    @property
    def name(self) -> str:
        """The label given in the specification, or an empty text."""
        raise NotImplementedError

    def diagram(
        self,
        along: str = "gamma",
        *,
        gamma: float | None = None,
        omega: float | None = None,
        xi: float | None = None,
        direction: str | None = None,
        min_flight: float | None = None,
        every: int | None = None,
    ) -> "xarray.Dataset":
        """The bifurcation diagram along one axis, the others fixed at the nearest value of the grid.

        Returns a Dataset with dims (`along`, flight): `flight_time` and `takeoff_phase` in rad, NaN where
        there is no flight; `flights`, `outcome`, `bounces`, `periods` along the axis. Its attribute
        `complete` is 0 while cells are still missing. `direction` is up or down for a ramp both ways (up if
        left out); flights shorter than `min_flight` (rad) are left out; `every` takes every n-th cell only.
        Raises BadRequest naming the parameter, TooLarge naming the `every` that fits.
        """
        from service.client.datasets import diagram_dataset

        answer = self._diagram(
            along=along, gamma=gamma, omega=omega, xi=xi,
            direction=direction, min_flight=min_flight, every=every,
        )  # fmt: skip
        return diagram_dataset(document(answer), self.id, self.name)

    def picture(
        self,
        along: str = "gamma",
        *,
        format: str = "png",
        gamma: float | None = None,
        omega: float | None = None,
        xi: float | None = None,
        direction: str | None = None,
        min_flight: float | None = None,
        every: int | None = None,
    ) -> bytes:
        """The same diagram as the bytes of a file: `format` is png, svg, csv or json.

        A ramp both ways shows both directions unless one is named. Raises as `diagram`.
        """
        return self._diagram(
            along=along, gamma=gamma, omega=omega, xi=xi,
            direction=direction, min_flight=min_flight, every=every, format=format,
        ).content  # fmt: skip

    def threshold(
        self,
        xi: float | None = None,
        *,
        tolerance: float | None = None,
        patience: float = 300.0,
        progress: bool | Parts = True,
    ) -> "xarray.Dataset":
        """Where bouncing begins, per Ω: `analytic` by Eq. 25, `up` and `down` as computed.

        To the sweep's grid in Γ; with a `tolerance` (in Γ) workers refine them from its stored states, for
        which this waits up to `patience` seconds; `progress` as in `Client.tradeoff`. NaN where the sweep
        does not hold the answer. Raises BadRequest, as for a ξ outside the grid, TooLarge, NotComputedYet,
        Busy.
        """
        from service.client.datasets import threshold_dataset

        query = {"xi": xi, "tolerance": tolerance}
        answer = self._transport.get_when_computed(
            self._path("threshold"), query, patience=patience, progress=progress
        )
        return threshold_dataset(document(answer), self.id)

    def modes(
        self, xi: float | None = None, direction: str | None = None, *, every: int | None = None
    ) -> "xarray.Dataset":
        """The mode map at the grid's ξ nearest to the one given: `outcome`, `bounces`, `periods`.

        Returns a Dataset with dims (omega, gamma); its attribute `complete` is 0 while cells are missing.
        `every` takes every n-th value of both axes only. Raises BadRequest naming the parameter, TooLarge
        naming the `every` that fits.
        """
        from service.client.datasets import modes_dataset

        query = {"xi": xi, "direction": direction, "every": every}
        return modes_dataset(document(self._transport.get(self._path("modes"), query)), self.id)

    def export(self, path: str | PathLike[str]) -> Path:
        """The whole sweep as one file: NetCDF if its name ends in .nc, Parquet if in .parquet.

        The file appears whole or not at all. Raises TooLarge, Busy, BounceError for another ending.
        """
        target = Path(path)
        if target.suffix not in (".nc", ".parquet"):
            raise BounceError(f"{target}: the name of an export ends in .nc or .parquet")
        self._transport.download(self._path("export"), {"format": target.suffix[1:]}, target)
        return target

    def open(self) -> "xarray.Dataset":
        """The whole store, read over the same connection where it is used. Raises StoreUnreachable."""
        from service.client.zarr_store import open_remote

        return open_remote(self._transport, self._path("zarr"), self.id)

    def _diagram(self, **query: str | float | None) -> "httpx2.Response":
        return self._transport.get(self._path("diagram"), query)

    def _path(self, *parts: str) -> str:
        return "/".join(("/v1/jobs", self.id, *parts))
