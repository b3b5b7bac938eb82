"""A job as the client sees it: the last view the service gave, and what can be asked of it."""

import time
from collections.abc import Iterator, Mapping
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
from service.client.live_display import job_html
from service.client.results import Results
from service.client.transport import Transport, document, seconds_to_wait

if TYPE_CHECKING:
    import httpx2

#: The states a job does not leave by itself.
FINISHED: Final = ("done", "failed", "cancelled")

#: Seconds between two looks at a job when the service names none: the first, and the longest.
FIRST_PAUSE: Final = 0.05
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


class Job(Results):
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

    def resume(self) -> "Job":
        """Let a job that failed or was cancelled go on where it stopped. Raises Conflict if it is done."""
        response = self._transport.post(self._path("resume"), repeat=True)
        self._take(document(response), response)
        return self

    def delete(self) -> None:
        """Have the service forget the job and all it computed. Raises Conflict while it is in work."""
        self._transport.delete(self._path())

    def follow(self) -> "Iterator[Job]":
        """This job, now and after every change, told by the service as it happens, until it is finished.

        Raises Busy if too many listen already, ServiceUnreachable if the service goes away.
        """
        for view in self._transport.events(self._path("events")):
            self._take({**view, "spec": view.get("spec") or self.view.get("spec")}, None)
            yield self

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
                pause = min(pause * 1.15, LONGEST_PAUSE)
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

    def __repr__(self) -> str:
        return f"<Job {summary(self)}>"

    def _repr_html_(self) -> str:
        return job_html(self)


_PROGRESS_FIELDS: Final = tuple(Progress.__dataclass_fields__)
