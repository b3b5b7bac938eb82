"""A job of the service: its status and results, waiting for it, and the requests that change it."""

import heapq
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

from service.client import errors
from service.client.display import display_job, job_html, summary
from service.client.models import JobStatus
from service.client.specification import body
from service.client.transport import Transport, json_object, outlast, retry_after
from service.formats import EXPORTS, ExportLayout
from service.result_methods import ResultMethods
from worker.spec.errors import BounceError

if TYPE_CHECKING:
    import httpx2
    import xarray
    from matplotlib.axes import Axes

    from service.client.measured import Data

#: Seconds between two requests of a wait if the service sends no Retry-After: the first, and the longest.
FIRST_DELAY: Final = 0.05
MAX_DELAY: Final = 2.0

#: The longest time between two requests that a service may ask for, s.
LONGEST_DELAY: Final = 60.0

#: Seconds between two requests of a wait for several jobs.
REQUEST_DELAY: Final = 0.02


Kind = Literal["diagram", "modes", "threshold", "orbits", "return", "exponents"]


class ResultReader:
    """Reads results by name, of a job or of a spring alone."""

    _transport: Transport

    def result(self, name: str, /, **query: Any) -> "xarray.Dataset":
        """The result of this name, such as "basins", as returned by the method of that name.

        Raises BadRequest naming the parameter, UnexpectedAnswer.
        """
        from service.client.dataset import from_binary

        if "other" in query:  # a Job, or its id
            query["other"] = getattr(query["other"], "id", query["other"])
        return from_binary(self.result_file(name, "bin", **query))

    def result_file(self, name: str, format: str, /, **query: Any) -> bytes:
        """A result as the content of a file: png, svg, pdf, csv, nc, parquet or json.

        `timeout` and `progress` in `query` are those of `Transport.get_result`. Raises as `result`.
        """
        return self._transport.get_result(f"{self._path}/{name}", format, **query)

    @property
    def _path(self) -> str:
        """The path above those of the results: of springs, unless a job has its own."""
        return "/v1"


class Job(ResultReader, ResultMethods, JobStatus):
    """A sweep at the service, as the service last described it; `refresh()` updates the description.

    Results can be read while it runs.
    """

    def __init__(
        self, transport: Transport, view: Mapping[str, Any], response: "httpx2.Response | None" = None
    ) -> None:
        self._transport = transport
        self._describe(view, response)

    def _describe(self, view: Mapping[str, Any], response: "httpx2.Response | None" = None) -> None:
        try:
            self._update(view)
        except (KeyError, TypeError) as error:
            raise errors.UnexpectedAnswer(
                f"the answer of {self._transport.url} does not describe a job"
            ) from error
        self._etag = response.headers.get("ETag") if response is not None else None
        self._retry_after = retry_after(response) if response is not None else None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Job) and (self.id, self._transport.url) == (other.id, other._transport.url)

    def __hash__(self) -> int:
        return hash((self.id, self._transport.url))

    @property
    def _path(self) -> str:
        return f"/v1/jobs/{self.id}"

    @property
    def spec(self) -> dict[str, Any]:
        """The specification with its defaults; requested if a list of jobs left it out for its length."""
        if self.view.get("spec") is None:
            self.refresh()
        return dict(self.view["spec"])

    def refresh(self) -> "Job":
        """Request the current status; the service answers 304 if nothing changed."""
        return self._refresh()

    def _refresh(self, **query: str | None) -> "Job":
        headers = {"If-None-Match": self._etag} if self._etag else {}
        response = self._transport.get(self._path, query, headers=headers)
        if response.status_code == 304:
            self._retry_after = retry_after(response)
        else:
            self._describe(json_object(response), response)
        return self

    def cancel(self) -> "Job":
        """Request the job to stop; repeating the request is harmless. Raises Conflict if it is done."""
        return self._post("cancel")

    def pin(self) -> "Job":
        """Pin the job, for `Client.jobs(pinned=True)` and the top of the page's list."""
        return self._post("pin")

    def unpin(self) -> "Job":
        """Unpin the job."""
        return self._post("unpin")

    def rename(self, name: str) -> "Job":
        """Give the job another name; its id and its numbers stay. Raises BadRequest."""
        return self._post("rename", body({"name": name}))

    def resume(self) -> "Job":
        """Continue a failed or cancelled job where it stopped. Raises Conflict if it is done.

        A job of another kernel version starts anew as another job: this object then becomes that job,
        with its `id`, and `notice` says so.
        """
        return self._post("resume")

    def _post(self, action: str, content: bytes | None = None) -> "Job":
        response = self._transport.post(f"{self._path}/{action}", content)
        self._describe(json_object(response), response)
        return self

    def delete(self) -> None:
        """Delete the job and its results. Raises Conflict while it is queued or running."""
        self._transport.delete(self._path)

    def wait(self, progress: "bool | Callable[[Job], None]" = True, timeout: float | None = None) -> "Job":
        """Wait until the job is done, polling at the service's interval (Retry-After).

        If a service of another kernel version replaces the job, this object becomes the new job and waits
        for that.

        Parameters
        ----------
        progress
            True shows a bar on a terminal and plain lines elsewhere, on standard error; a function is called
            with the job after every request.
        timeout
            In seconds.

        Returns
        -------
        Job
            This job.

        Raises
        ------
        JobFailed, JobCancelled
        WaitTimeout
            The job continues.
        ServiceUnreachable
            No answer for 30 seconds.
        """
        with display_job(progress) as show:
            for _ in until_ended([self], timeout, show, shown=progress is True):
                pass
        if self.state == "failed":
            raise errors.JobFailed(self)
        if self.state == "cancelled":
            raise errors.JobCancelled(self)
        return self

    def export(self, path: str | PathLike[str], *, layout: ExportLayout = "cells") -> Path:
        """Write the whole sweep to a file, .nc (NetCDF), .parquet or .html (a page), and return its path.

        The page shows diagrams, map and thresholds in any browser, without service and network.

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
        self._transport.download(f"{self._path}/export", query, target)
        return target

    def share(self, path: str | PathLike[str], data: "Data | None" = None) -> Path:
        """Write the sweep as a page (.html) for others, and return its path. Raises as `export`.

        data: measured points that it draws, as in `plot`; raises BounceError for a wrong table.
        """
        from service.client.measured import element

        target = Path(path)
        if target.suffix != ".html":
            raise BounceError(f"{path}: the name of a page ends in .html")
        points = "" if data is None else element(data)
        self._transport.download(f"{self._path}/export", {"format": "html"}, target, points.encode())
        return target

    def open(self, chunks: Any = None) -> "xarray.Dataset":
        """The whole store as a lazy Dataset, read over the client's connection. Raises StoreUnreachable.

        chunks: as `xarray.open_zarr` takes it; `{}` for dask arrays with the chunks that are stored. Such a
        Dataset can be sent to workers of a Dask cluster, with the address of the service and the token.
        """
        from service.client.zarr_store import open_store

        return open_store(self._transport, f"{self._path}/zarr", self.id, chunks=chunks)

    @property
    def store_url(self) -> str:
        """Where the service has the store: a folder of its machine, or s3://BUCKET/PREFIX.

        `xarray.open_zarr` reads it there, if this machine can. Damage is not reported to the service then.
        Raises StoreUnreachable, UnexpectedAnswer.
        """
        from service.client.zarr_store import store_url

        return store_url(self._transport, f"{self._path}/zarr", self.id)

    def plot(
        self,
        kind: Kind | None = None,
        *,
        ax: "Axes | None" = None,
        branches: "xarray.Dataset | bool | None" = None,
        data: "Data | None" = None,
        frequency: float | None = None,
        **selection: Any,
    ) -> "Axes":
        """Plot the results with matplotlib.

        Parameters
        ----------
        kind
            "diagram", the flights along one axis; "modes", the map over (Γ, Ω); "threshold", over Ω;
            "orbits", the branches of cycles; "return", each flight of a cell over the one before;
            "exponents", the Lyapunov exponents along one axis. By default the branches of a study of orbits,
            the map of a sweep if Γ and Ω both have several values, else or with `data` or a value of
            one of them the diagram.
        ax
            By default those of a new figure, or the current ones of pyplot while they are empty.
        branches
            From `Client.orbits`, drawn over a diagram: solid where stable. True: as `diagram` has them.
        data
            Measured points over a diagram or thresholds, with their residuals to the nearest flight or
            threshold: a CSV file, a pandas table or a mapping. Columns: the axis (`gamma` or `omega`),
            `flight_time` in rad or `flight_time_ms`, over thresholds `omega` and `gamma`; and `error`, half
            an error bar, if known.
        frequency
            Of the plate in Hz, for `flight_time_ms` without a column `frequency`.
        **selection
            Arguments of the result's method. Maps of sweeps ramped both ways are hatched where
            the directions differ, unless `hysteresis` is False.

        Raises
        ------
        BounceError
            The kind is unknown, or the result's method raises it.
        """
        spec = self.spec
        long = [axis for axis in ("gamma", "omega", "xi") if _length(spec.get(axis)) > 1]
        study = spec["protocol"]["kind"]
        if study in ("basin", "multistability"):
            name = "basins" if study == "basin" else study
            raise BounceError(f"kind: sweeps and cycles are plotted; {name} by result_file('{name}', 'png')")
        if kind is None:
            is_line = data is not None or not selection.keys().isdisjoint(("along", "gamma", "omega"))
            is_map = {"gamma", "omega"} <= set(long) and not is_line
            kind = "orbits" if study == "orbits" else "modes" if is_map else "diagram"
        if kind not in get_args(Kind):
            raise BounceError(f"kind: must be one of {', '.join(get_args(Kind))}, not {kind!r:.40}")
        if not (branches is None or branches is False or kind == "diagram"):
            raise BounceError(f"branches: are drawn in a diagram, not in {kind}")
        if data is not None and kind not in ("diagram", "threshold"):
            raise BounceError(f"data: are drawn in a diagram or over thresholds, not in {kind}")
        if kind == "modes" and spec["protocol"].get("direction") == "both":
            selection = {"hysteresis": True, "direction": "up", **selection}
        elif kind in ("threshold", "orbits"):
            selection = {"progress": False, **selection}
        elif kind in ("diagram", "exponents") and "along" not in selection and long and "gamma" not in long:
            selection["along"] = long[0]
        if kind == "return":
            gamma = selection.pop("gamma", None)
            if gamma is None and "gamma" in long:
                raise BounceError("gamma: is required, of the cell whose flights are drawn")
            axes: Axes = self._cell_at(gamma, selection).bounce.plot_returns(ax=ax)
        elif kind == "exponents":
            axes = self.result("diagram", **selection).bounce.plot_exponents(ax=ax)
        else:
            own = {"branches": True, "progress": False} if branches is True else {}
            given = None if isinstance(branches, bool) else branches
            accessor = self.result(kind, **own | selection).bounce
            axes = accessor.plot(ax=ax, branches=given, data=data, frequency=frequency)
        return axes

    def _cell_at(self, gamma: float | None, selection: Mapping[str, Any]) -> "xarray.Dataset":
        """The diagram of the cell at gamma. Raises BounceError."""
        try:
            return self.diagram(**selection, start=gamma, stop=gamma)
        except errors.BadRequest as error:  # names the limits of a window
            raise BounceError(re.sub("^st(art|op):", "gamma:", str(error))) from None

    def _refresh_in_time(self, *, shown: bool, **query: str | None) -> None:
        """Refresh, waiting for an absent service; become the job that replaces this one, if any."""
        while True:
            if self._is_replaced():
                self.id, self._etag = str(self.replaced_by), None
            outlast(partial(self._refresh, **query), shown=shown)
            if not self._is_replaced():
                return

    def _is_replaced(self) -> bool:
        return self.finished and self.state != "done" and self.replaced_by is not None

    def __repr__(self) -> str:
        return f"<Job {summary(self)}>"

    def _repr_html_(self) -> str:
        return job_html(self)


def _length(axis: object) -> int:
    if isinstance(axis, Mapping):
        return int(axis["num"])
    return len(axis) if isinstance(axis, list) else 1


def until_ended(
    jobs: Iterable[Job], timeout: float | None, show: Callable[[Job], None] = lambda job: None,
    shown: bool = False,
) -> Iterator[Job]:  # fmt: skip
    """The jobs as they end; calls `show` with a job now and after every request. shown: as in `outlast`.

    Raises WaitTimeout, ServiceUnreachable.
    """
    deadline = time.monotonic() + (float("inf") if timeout is None else timeout)
    waiting = [(0.0, number, FIRST_DELAY, job) for number, job in enumerate(jobs)]
    while waiting:
        due, number, delay, job = heapq.heappop(waiting)
        if due > 0.0:
            time.sleep(max(0.0, min(due, deadline) - time.monotonic()))
        if due > 0.0 or job._is_replaced():
            job._refresh_in_time(shown=shown)
        show(job)
        if job.finished:
            yield job
        elif time.monotonic() >= deadline:
            raise errors.WaitTimeout(job, timeout or 0.0)
        else:
            asked = job._retry_after
            pause = delay if asked is None else min(asked, LONGEST_DELAY)
            pause = max(pause, REQUEST_DELAY * len(waiting))  # many jobs share the request rate of one
            entry = (time.monotonic() + pause, number, min(delay * 1.15, MAX_DELAY), job)
            heapq.heappush(waiting, entry)
