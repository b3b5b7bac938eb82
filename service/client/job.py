"""A job of the service: its status, waiting for it, and the requests that change it."""

import heapq
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final, get_args

from service.client.display import PartsCallback, display_job, display_parts, job_html, summary
from service.client.errors import (
    BounceError,
    Busy,
    JobCancelled,
    JobFailed,
    ServiceUnreachable,
    UnexpectedAnswer,
    WaitTimeout,
)
from service.client.models import JobStatus
from service.client.results import Results
from service.client.specification import body
from service.client.transport import Transport, json_object, retry_after

if TYPE_CHECKING:
    import httpx2
    import xarray
    from matplotlib.axes import Axes

    from service.client.plots import Kind

#: Seconds between two requests of a wait if the service sends no Retry-After: the first, and the longest.
FIRST_DELAY: Final = 0.05
MAX_DELAY: Final = 2.0

#: The longest time between two requests that a service may ask for, s.
LONGEST_DELAY: Final = 60.0

#: Seconds between two requests of a wait for several jobs.
REQUEST_DELAY: Final = 0.02

#: Seconds for which a wait retries while the service is away; a restarted service continues its jobs.
MAX_OUTAGE: Final = 30.0


class Job(Results):
    """A sweep at the service, as the service last described it; `refresh()` updates the description."""

    def __init__(self, transport: Transport, response: "httpx2.Response") -> None:
        self._transport = transport
        self._update_from(json_object(response), response)

    @classmethod
    def from_view(cls, transport: Transport, view: Mapping[str, Any]) -> "Job":
        """A job from its entry in a list of jobs; sends no request."""
        job = cls.__new__(cls)
        job._transport = transport
        job._update_from(view, None)
        return job

    def _update_from(self, view: Mapping[str, Any], response: "httpx2.Response | None") -> None:
        try:
            self._update(view)
        except (KeyError, TypeError) as error:
            raise UnexpectedAnswer(f"the answer of {self._transport.url} does not describe a job") from error
        self._etag = response.headers.get("ETag") if response is not None else None
        self._retry_after = retry_after(response) if response is not None else None

    @property
    def spec(self) -> dict[str, Any]:
        """The specification with its defaults; requested if a list of jobs left it out for its length."""
        if self.view.get("spec") is None:
            self.refresh()
        return dict(self.view["spec"])

    def refresh(self) -> "Job":
        """Request the current status; the service answers 304 if nothing changed."""
        headers = {"If-None-Match": self._etag} if self._etag else {}
        response = self._transport.get(self._path(), headers=headers)
        if response.status_code == 304:
            self._retry_after = retry_after(response)
        else:
            self._update_from(json_object(response), response)
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

    def resume(self) -> "Job":
        """Continue a failed or cancelled job where it stopped. Raises Conflict if it is done.

        A job of another kernel version starts anew as another job: this object then becomes that job,
        with its `id`, and `notice` says so.
        """
        return self._post("resume")

    def refine(
        self,
        gamma: tuple[float, float] | None = None,
        omega: tuple[float, float] | None = None,
        xi: float | None = None,
        *,
        finer: int = 4,
        by: str = "mode",
        margin: bool = False,
    ) -> "Job":
        """Submit an adaptive sweep of a window of this sweep's map.

        Parameters
        ----------
        gamma, omega
            Ends of the window; None for the whole axis.
        xi
            Selects the nearest grid value; None if there is only one.
        finer
            How many times as fine as the map's grid.
        by
            "mode" or "bouncing".
        margin
            Also compute the neighbours of blocks that change.

        Returns
        -------
        Job
            The new job, whose `spec["parent"]` is this job's id.

        Raises
        ------
        InvalidSpecification
            Names the field.
        TooLarge, Busy
        """
        fields = {"gamma": gamma, "omega": omega, "xi": xi, "finer": finer, "by": by, "margin": margin}
        response = self._transport.post(self._path("refine"), body(fields), idempotent=True)
        return Job(self._transport, response)

    def _post(self, action: str) -> "Job":
        response = self._transport.post(self._path(action), idempotent=True)
        self._update_from(json_object(response), response)
        return self

    def delete(self) -> None:
        """Delete the job and its results. Raises Conflict while it is queued or running."""
        self._transport.delete(self._path())

    def follow(self) -> "Iterator[Job]":
        """Yield this job now and after every change until it is finished; the service pushes the changes.

        Raises
        ------
        Busy
            The service has too many listeners.
        ServiceUnreachable
            The connection broke.
        """
        for view in self._transport.events(self._path("events")):
            self._update_from({**view, "spec": view.get("spec") or self.view.get("spec")}, None)
            yield self

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
            No answer for `MAX_OUTAGE` seconds.
        """
        deadline = time.monotonic() + (float("inf") if timeout is None else timeout)
        with display_job(progress) as show:
            show(self)
            delay = FIRST_DELAY
            while not self.has_ended() and (left := deadline - time.monotonic()) > 0:
                time.sleep(min(self.pause(delay), left))
                delay = min(delay * 1.15, MAX_DELAY)
                self.refresh_through_outage()
                show(self)
        raise_unless_done(self, timeout)
        return self

    def plot(
        self,
        kind: "Kind | None" = None,
        *,
        ax: "Axes | None" = None,
        branches: "xarray.Dataset | None" = None,
        **selection: Any,
    ) -> "Axes":
        """Plot the results with matplotlib.

        Parameters
        ----------
        kind
            "diagram", the flights along one axis; "modes", the map over (Γ, Ω); "threshold", over Ω. By
            default the map if Γ and Ω both have several values, else the diagram.
        ax
            By default the current axes of pyplot if it is in use, else those of a new figure.
        branches
            From `Client.orbits`, drawn over a diagram: solid where stable.
        **selection
            Arguments of `diagram`, `modes` or `threshold`. Maps of sweeps ramped both ways are hatched where
            the directions differ, unless `hysteresis` is False.

        Returns
        -------
        Axes

        Raises
        ------
        BounceError
            The kind is unknown, or the result's method raises it.
        """
        from service.client import plots

        spec = self.spec
        long = [axis for axis in plots.AXES if _length(spec[axis]) > 1]
        if kind is None:
            kind = "modes" if {"gamma", "omega"} <= set(long) and "along" not in selection else "diagram"
        if kind not in get_args(plots.Kind):
            raise BounceError(f"kind: must be one of {', '.join(get_args(plots.Kind))}, not {kind!r:.40}")
        if branches is not None and kind != "diagram":
            raise BounceError(f"branches: are drawn in a diagram, not in {kind}")
        ax = ax if ax is not None else plots.new_axes()
        if kind == "modes":
            both = spec["protocol"].get("direction") == "both"
            defaults: dict[str, Any] = {"hysteresis": True, "direction": "up"} if both else {}
            plots.draw_modes(ax, self.modes(**defaults | selection))
        elif kind == "threshold":
            plots.draw_thresholds(ax, self.threshold(progress=False, **selection))
        else:
            if "along" not in selection and long and "gamma" not in long:
                selection["along"] = long[0]
            plots.draw_diagram(ax, self.diagram(**selection))
            if branches is not None:
                plots.draw_branches(ax, branches)
        return ax

    def pause(self, otherwise: float) -> float:
        """Seconds that the service asks to wait (Retry-After), or `otherwise`."""
        return otherwise if self._retry_after is None else min(self._retry_after, LONGEST_DELAY)

    def has_ended(self) -> bool:
        """Whether the job is finished; first becomes the job that replaces it, if any."""
        while self.finished and self.state != "done" and self.replaced_by is not None:
            self.id, self._etag = self.replaced_by, None
            self.refresh_through_outage()
        return self.finished

    def refresh_through_outage(self) -> None:
        """Refresh, retrying for `MAX_OUTAGE` seconds while the service is away."""
        deadline = time.monotonic() + MAX_OUTAGE
        while True:
            try:
                self.refresh()
                return
            except (ServiceUnreachable, Busy):
                if time.monotonic() > deadline:
                    raise
            time.sleep(1.0)

    def __repr__(self) -> str:
        return f"<Job {summary(self)}>"

    def _repr_html_(self) -> str:
        return job_html(self)


def _length(axis: object) -> int:
    """Number of values of a specification's axis."""
    if isinstance(axis, Mapping):
        return int(axis["num"])
    return len(axis) if isinstance(axis, list) else 1


def raise_unless_done(job: JobStatus, timeout: float | None) -> None:
    """Raise JobFailed, JobCancelled, or WaitTimeout for a job that is not done after a wait."""
    if job.state == "failed":
        raise JobFailed(job)
    if job.state == "cancelled":
        raise JobCancelled(job)
    if not job.finished:
        raise WaitTimeout(job, timeout or 0.0)


def as_completed(jobs: Iterable[Job], timeout: float | None = None) -> Iterator[Job]:
    """The jobs as they end: done, failed or cancelled. As `Client.as_completed`."""
    deadline = time.monotonic() + (float("inf") if timeout is None else timeout)
    waiting = [(0.0, number, FIRST_DELAY, job) for number, job in enumerate(jobs)]
    while waiting:
        due, number, delay, job = heapq.heappop(waiting)
        time.sleep(max(0.0, min(due, deadline) - time.monotonic()))
        if due > 0.0:
            job.refresh_through_outage()
        if job.has_ended():
            yield job
        elif time.monotonic() >= deadline:
            raise WaitTimeout(job, timeout or 0.0)
        else:
            # Many jobs share the request rate of one.
            pause = max(job.pause(delay), REQUEST_DELAY * len(waiting))
            entry = (time.monotonic() + pause, number, min(delay * 1.15, MAX_DELAY), job)
            heapq.heappush(waiting, entry)


def wait_all(
    jobs: Iterable[Job], timeout: float | None, progress: "bool | PartsCallback" = True
) -> list[Job]:
    """The jobs, once all are done. As `Client.wait_all`."""
    jobs = list(jobs)
    show = display_parts(progress, "ended", "jobs")
    ended = 0
    show(ended, len(jobs))
    for _ in as_completed(jobs, timeout):
        ended += 1
        show(ended, len(jobs))
    for job in jobs:
        raise_unless_done(job, timeout)
    return jobs
