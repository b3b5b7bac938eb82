"""The entry point: a client of one service, which submits sweeps and returns jobs."""

import re
from collections.abc import Iterator
from math import inf
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self

from service.client.display import PartsCallback
from service.client.errors import NotFound, UnexpectedAnswer
from service.client.job import Job
from service.client.models import Estimate, Problem
from service.client.specification import Specification, body
from service.client.transport import Transport, header_value, json_object

if TYPE_CHECKING:
    from collections.abc import Mapping

    import httpx2
    import xarray

DEFAULT_URL: Final = "http://127.0.0.1:8000"

#: Jobs in one request for a list of jobs.
PAGE_SIZE: Final = 1000


class Client:
    """A client of a running service.

        with Client() as client:
            job = client.submit({"gamma": {"start": 1, "stop": 6, "num": 1001}, "omega": 0.5, "xi": 0.26})
            diagram = job.wait().diagram()

    `url` is the address of the service; `token` is its access token, which it requires unless it listens on
    loopback only; `timeout` is the time limit of one request in seconds. `http` sends the requests instead of
    a connection of the client's own (for proxies, certificates, or an application in this process); closing
    the client does not close it. Every exception raised on purpose is a `BounceError`.
    """

    def __init__(
        self,
        url: str = DEFAULT_URL,
        token: str | None = None,
        timeout: float = 30.0,
        *,
        http: "httpx2.Client | None" = None,
    ) -> None:
        self._transport = Transport(url, token=token, timeout=timeout, http=http)

    @property
    def url(self) -> str:
        """The address of the service."""
        return self._transport.url

    def submit(self, spec: Specification, *, key: str | None = None) -> Job:
        """Submit a sweep: a mapping, a `worker.spec.SweepSpec`, or the path of a .json or .toml file.

        The same sweep is always the same job: submitted again, a job that is done is returned as it is, and
        one that failed or was cancelled continues. With an idempotency `key`, a repeated request changes
        nothing, whatever happened to the job since. Raises InvalidSpecification naming field and rule,
        TooLarge, Busy, or Conflict if the key was used for another specification.
        """
        headers = {"Idempotency-Key": header_value("an idempotency key", key)} if key is not None else None
        response = self._transport.post("/v1/jobs", body(spec), headers=headers, idempotent=True)
        return Job(self._transport, response)

    def estimate(self, spec: Specification) -> Estimate:
        """The estimated cost of a sweep, without submitting it. Raises as `submit`."""
        query = {"validate_only": "true"}
        answer = json_object(self._transport.post("/v1/jobs", body(spec), query=query, idempotent=True))
        try:
            return Estimate(**{name: answer[name] for name in Estimate._fields})
        except KeyError as error:
            raise UnexpectedAnswer(f"the answer is not an estimate: {error!r}") from error

    def job(self, id: str) -> Job:
        """The job with this id. Raises NotFound."""
        return Job(self._transport, self._transport.get(f"/v1/jobs/{_valid_id(id)}"))

    def jobs(self, state: str | None = None) -> Iterator[Job]:
        """All jobs, or those in one state, newest first; requested page by page."""
        query: dict[str, Any] = {"state": state, "limit": PAGE_SIZE}
        while True:
            page = json_object(self._transport.get("/v1/jobs", query))
            if not isinstance(page.get("jobs"), list):
                raise UnexpectedAnswer("the answer is not a list of jobs")
            for view in page["jobs"]:
                yield Job.from_view(self._transport, view)
            if not page.get("next"):
                return
            query["cursor"] = page["next"]

    def threshold(self, omega: float, xi: float) -> float:
        """Γ_th, above which a spring at rest begins to bounce (Eq. 25); infinite if it never does.

        Raises BadRequest.
        """
        answer = json_object(self._transport.get("/v1/threshold", {"omega": omega, "xi": xi}))
        gamma = answer.get("threshold")
        return inf if gamma is None else float(gamma)

    def trajectory(self, cell: "Mapping[str, Any]") -> "xarray.Dataset":
        """The motion of one cell, computed during the request.

        `cell` contains `gamma`, `omega`, `xi`, and optionally `model`, `settle` and `periods` (plate
        periods), `samples` per period, and `start`, a cycle of the closed form. Returns a Dataset with dim
        phase: `plate`, `z1`, `z2` in plate amplitudes, `force`, `in_flight`; with dim flight: `takeoff`,
        `takeoff_phase`, `flight_time` in rad; attribute `rest_length` in plate amplitudes. Raises
        BadRequest naming the field, TooLarge, Busy.
        """
        from service.client.datasets import trajectory_dataset

        response = self._transport.post("/v1/trajectories", body(cell), idempotent=True)
        return trajectory_dataset(json_object(response))

    def tradeoff(self, *, timeout: float = 900.0, progress: bool | PartsCallback = True) -> dict[str, Any]:
        """The cost and the accuracy of every contact model: `rows`, and `advice` as text.

        The service's workers measure them at the first request, which takes a minute or two; this waits up to
        `timeout` seconds. `progress`: True writes lines to standard error; a function is called with the
        numbers of parts computed and of all parts. Raises NotComputedYet, Busy.
        """
        path = "/v1/tradeoff"
        return json_object(self._transport.get_when_computed(path, timeout=timeout, progress=progress))

    def tradeoff_picture(
        self, format: str = "png", *, timeout: float = 900.0, progress: bool | PartsCallback = True
    ) -> bytes:
        """The same as a picture, png or svg. Raises BadRequest, NotComputedYet, Busy."""
        path, query = "/v1/tradeoff", {"format": format}
        return self._transport.get_when_computed(path, query, timeout=timeout, progress=progress).content

    def metrics(self) -> str:
        """The service's metrics in Prometheus's text format."""
        return self._transport.get("/metrics").text

    def close(self) -> None:
        """Close the connections. Jobs continue."""
        self._transport.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Client {self.url}>"


def _valid_id(text: str) -> str:
    """The id, if it has the form of one: no other text may become part of an address. Raises NotFound."""
    if not re.fullmatch("[0-9a-f]{32}", text):
        detail = f"no job has the id {text!r}: an id is 32 hex digits"
        raise NotFound(Problem(status=404, title="Not Found", detail=detail))
    return text
