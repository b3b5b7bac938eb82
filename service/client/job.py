"""A job as the client sees it: the last view the service gave, and what can be asked of it."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from service.client.display import Show, display, summary
from service.client.errors import (
    Busy,
    JobCancelled,
    JobFailed,
    ServiceUnreachable,
    UnexpectedAnswer,
    WaitTimeout,
)
from service.client.notebook import job_html
from service.client.transport import Transport, document, seconds_to_wait

if TYPE_CHECKING:
    import httpx2
    import xarray

#: The states a job does not leave by itself.
FINISHED: Final = ("done", "failed", "cancelled")

#: Seconds between two looks at a job when the service names none: the first, and the longest.
FIRST_PAUSE: Final = 0.1
LONGEST_PAUSE: Final = 2.0

#: Seconds for which a wait bears with a service that does not answer: it picks its jobs up when restarted.
PATIENCE: Final = 30.0


@dataclass(frozen=True)
class Progress:
    """How far a job is. `eta_seconds` is None while nothing is known."""

    chunks_done: int
    chunks_total: int
    cells_done: int
    cells_total: int
    percent: float
    eta_seconds: float | None = None

    @property
    def whole_percent(self) -> int:
        """Percent rounded down: 100 means all."""
        return int(self.percent)


class Job:
    """One sweep in the service's hands, as it was at the last look: `refresh()` looks again."""

    def __init__(self, transport: Transport, response: "httpx2.Response") -> None:
        self._transport = transport
        self._take(document(response), response)

    @classmethod
    def listed(cls, transport: Transport, view: Mapping[str, Any]) -> "Job":
        """A job from its view in a list, without an exchange of its own."""
        job = cls.__new__(cls)
        job._transport = transport
        job._take(view, None)
        return job

    def _take(self, view: Mapping[str, Any], response: "httpx2.Response | None") -> None:
        try:
            self.id = str(view["id"])
            self.state = str(view["state"])
            self.progress = Progress(**{name: view["progress"].get(name) for name in _PROGRESS_FIELDS})
        except (KeyError, TypeError, AttributeError) as error:
            raise UnexpectedAnswer(
                f"{self._transport.url} answered with something that is not a job"
            ) from error
        self.view = dict(view)
        self._etag = response.headers.get("ETag") if response is not None else None
        self._retry_after = seconds_to_wait(response) if response is not None else None

    @property
    def name(self) -> str:
        """The label given in the specification, or an empty text."""
        return str(self.view.get("name") or "")

    @property
    def error(self) -> str | None:
        """Why the job failed."""
        return self.view.get("error")

    @property
    def spec(self) -> dict[str, Any]:
        """The specification as the service holds it; fetched if a list left it out for being long."""
        if self.view.get("spec") is None:
            self.refresh()
        return dict(self.view["spec"])

    @property
    def links(self) -> dict[str, str]:
        """Where else to look: addresses by name."""
        return dict(self.view.get("links") or {})

    @property
    def finished(self) -> bool:
        """Whether the job is done, failed or cancelled."""
        return self.state in FINISHED

    def refresh(self) -> "Job":
        """Look again. An unchanged job costs the service no more than its ETag."""
        headers = {"If-None-Match": self._etag} if self._etag else {}
        response = self._transport.get(self._path(), headers=headers)
        if response.status_code == 304:
            self._retry_after = seconds_to_wait(response)
        else:
            self._take(document(response), response)
        return self

    def cancel(self) -> "Job":
        """Ask the service to stop the job; asking twice is fine. Raises Conflict if it is done."""
        response = self._transport.post(self._path("cancel"), repeat=True)
        self._take(document(response), response)
        return self

    def wait(self, progress: bool | Show = True, timeout: float | None = None) -> "Job":
        """Return once the job is done, looking as often as the service asks for (Retry-After).

        `progress`: True shows a bar on a terminal and plain lines elsewhere, on standard error; a function
        is called with the job after every look. `timeout` is in seconds. Raises JobFailed, JobCancelled,
        WaitTimeout (the job goes on), or ServiceUnreachable after `PATIENCE` seconds without an answer.
        """
        deadline = time.monotonic() + (float("inf") if timeout is None else timeout)
        with display(progress) as show:
            show(self)
            pause = FIRST_PAUSE
            while not self.finished and (left := deadline - time.monotonic()) > 0:
                time.sleep(min(pause if self._retry_after is None else self._retry_after, left))
                pause = min(pause * 1.5, LONGEST_PAUSE)
                self._refresh_patiently()
                show(self)
        return self._outcome(timeout)

    def _refresh_patiently(self) -> None:
        """Refresh, again and again while the service is away, for `PATIENCE` seconds."""
        give_up = time.monotonic() + PATIENCE
        while True:
            try:
                self.refresh()
                return
            except (ServiceUnreachable, Busy):
                if time.monotonic() > give_up:
                    raise
            time.sleep(1.0)

    def _outcome(self, timeout: float | None) -> "Job":
        if self.state == "failed":
            raise JobFailed(self)
        if self.state == "cancelled":
            raise JobCancelled(self)
        if not self.finished:
            raise WaitTimeout(self, timeout or 0.0)
        return self

    def diagram(
        self,
        along: str = "gamma",
        *,
        gamma: float | None = None,
        omega: float | None = None,
        xi: float | None = None,
        direction: str | None = None,
        min_flight: float | None = None,
    ) -> "xarray.Dataset":
        """The bifurcation diagram along one axis, the others fixed at the nearest value of the grid.

        Returns a Dataset with dims (`along`, flight): `flight_time` and `takeoff_phase` in rad, NaN where
        there is no flight; `flights`, `outcome`, `bounces`, `periods` along the axis. Its attribute
        `complete` is 0 while cells are still missing. `direction` is up or down for a ramp both ways (up if
        left out); flights shorter than `min_flight` (rad) are left out. Raises BadRequest naming the
        parameter, TooLarge.
        """
        from service.client.datasets import diagram_dataset

        query = _line(
            along=along, gamma=gamma, omega=omega, xi=xi, direction=direction, min_flight=min_flight
        )
        return diagram_dataset(
            document(self._transport.get(self._path("diagram"), query)), self.id, self.name
        )

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
    ) -> bytes:
        """The same diagram as the bytes of a file: `format` is png, svg, csv or json.

        A ramp both ways shows both directions unless one is named. Raises as `diagram`.
        """
        query = {
            **_line(along=along, gamma=gamma, omega=omega, xi=xi, direction=direction, min_flight=min_flight),
            "format": format,
        }
        return self._transport.get(self._path("diagram"), query).content

    def threshold(
        self, xi: float | None = None, *, tolerance: float | None = None, patience: float = 300.0
    ) -> "xarray.Dataset":
        """Where bouncing begins, per Ω: `analytic` by Eq. 25, `up` and `down` as computed.

        To the sweep's grid in Γ; with a `tolerance` (in Γ) workers refine them from its stored states, for
        which this waits up to `patience` seconds. NaN where the sweep does not hold the answer. Raises
        BadRequest, as for a ξ outside the grid; TooLarge, Busy.
        """
        from service.client.datasets import threshold_dataset

        query = {"xi": xi, "tolerance": tolerance}
        answer = self._transport.get_when_computed(self._path("threshold"), query, patience=patience)
        return threshold_dataset(document(answer), self.id)

    def open(self) -> "xarray.Dataset":
        """The whole store, loaded where it is used. Raises StoreUnreachable if it is not on this machine."""
        from service.client.datasets import open_store

        return open_store(self.links.get("store"), self.id)

    def _path(self, *parts: str) -> str:
        return "/".join(("/v1/jobs", self.id, *parts))

    def __repr__(self) -> str:
        return f"<Job {summary(self)}>"

    def _repr_html_(self) -> str:
        return job_html(self)


_PROGRESS_FIELDS: Final = tuple(Progress.__dataclass_fields__)


def _line(
    *,
    along: str,
    gamma: float | None,
    omega: float | None,
    xi: float | None,
    direction: str | None,
    min_flight: float | None,
) -> dict[str, str | float | None]:
    """The query that chooses one line of the grid."""
    return {
        "along": along,
        "gamma": gamma,
        "omega": omega,
        "xi": xi,
        "direction": direction,
        "min_flight": min_flight,
    }
