"""The way in: one service, its jobs and its closed forms."""

import re
from collections.abc import Iterator
from math import inf
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

from service.client.display import Parts
from service.client.errors import NotFound, Problem, UnexpectedAnswer
from service.client.job import Job
from service.client.specification import Specification, body
from service.client.transport import Transport, document, word

if TYPE_CHECKING:
    from collections.abc import Mapping

    import httpx2
    import xarray

DEFAULT_URL: Final = "http://127.0.0.1:8000"

#: Jobs asked for at a time.
PAGE: Final = 1000


class Estimate(NamedTuple):
    """What a sweep would take."""

    cells: int
    chunks: int
    bytes: int  # of stored arrays before compression
    core_seconds: float
    basis: str  # measured: by the speed of the service's last jobs with the same contact model; or table


class Client:
    """A running service.

        with Client() as client:
            job = client.submit({"gamma": {"start": 1, "stop": 6, "num": 1001}, "omega": 0.5, "xi": 0.26})
            diagram = job.wait().diagram()

    `url` is where it listens, `token` what it asks for when it does not listen on loopback, `timeout` the
    seconds one answer may take. `http` carries the requests instead of the client's own connection (for
    proxies, certificates, or an application in this process); it stays open when the client is closed.
    Every error raised on purpose is a `BounceError`.
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
        """Where the service is."""
        return self._transport.url

    def submit(self, spec: Specification, *, key: str | None = None) -> Job:
        """Hand in a sweep: a mapping, a `worker.spec.SweepSpec`, or the path of a .json or .toml file.

        The same sweep is the same job, however often it is handed in: one that is done comes back done, one
        that failed or was cancelled goes on. Under an idempotency `key` a repeated request changes nothing,
        whatever became of the job since. Raises InvalidSpecification naming field and rule, TooLarge, Busy,
        or Conflict for a key that was used for something else.
        """
        headers = {"Idempotency-Key": word("an idempotency key", key)} if key is not None else None
        return Job(
            self._transport, self._transport.post("/v1/jobs", body(spec), headers=headers, repeat=True)
        )

    def estimate(self, spec: Specification) -> Estimate:
        """What a sweep would cost, without handing it in. Raises as `submit`."""
        query: dict[str, str | float | None] = {"validate_only": "true"}
        answer = document(self._transport.post("/v1/jobs", body(spec), query=query, repeat=True))
        try:
            return Estimate(**{name: answer[name] for name in Estimate._fields})
        except KeyError as error:
            raise UnexpectedAnswer(
                f"the service answered with something that is no estimate: {error!r}"
            ) from error

    def job(self, id: str) -> Job:
        """The job with this id. Raises NotFound."""
        return Job(self._transport, self._transport.get(f"/v1/jobs/{_job_id(id)}"))

    def jobs(self, state: str | None = None) -> Iterator[Job]:
        """All jobs, newest first, or those in one state; fetched page by page."""
        query: dict[str, Any] = {"state": state, "limit": PAGE}
        while True:
            page = document(self._transport.get("/v1/jobs", query))
            for view in _views(page):
                yield Job.listed(self._transport, view)
            if not page.get("next"):
                return
            query["cursor"] = page["next"]

    def threshold(self, omega: float, xi: float) -> float:
        """Γ_th, above which a spring at rest begins to bounce (Eq. 25); infinite where none does.

        Raises BadRequest.
        """
        answer = document(self._transport.get("/v1/threshold", {"omega": omega, "xi": xi}))
        found = answer.get("threshold")
        return inf if found is None else float(found)

    def trajectory(self, cell: "Mapping[str, Any]") -> "xarray.Dataset":
        """The motion of one cell, sample by sample, computed while this waits.

        `cell` holds `gamma`, `omega`, `xi`, and if wanted `model`, `settle` and `periods` (plate periods)
        and `samples` per period. Returns a Dataset: `plate`, `z1`, `z2` in plate amplitudes, `force` and
        `in_flight` over `phase`; `takeoff`, `takeoff_phase`, `flight_time` of each flight, in rad; attribute
        `rest_length`. Raises BadRequest naming the field, TooLarge, Busy.
        """
        from service.client.motion import motion_dataset

        return motion_dataset(document(self._transport.post("/v1/trajectories", body(cell), repeat=True)))

    def tradeoff(self, *, patience: float = 900.0, progress: bool | Parts = True) -> dict[str, Any]:
        """What every contact model costs and how far off it is: `rows`, and `advice` in a sentence.

        Measured by the service's workers when first asked for, a minute or so; waits up to `patience`
        seconds. `progress`: True tells on standard error how far they are; a function is called with the
        number of parts done and of all. Raises NotComputedYet, Busy.
        """
        path = "/v1/tradeoff"
        return document(self._transport.get_when_computed(path, patience=patience, progress=progress))

    def tradeoff_picture(
        self, format: str = "png", *, patience: float = 900.0, progress: bool | Parts = True
    ) -> bytes:
        """The same as a picture, png or svg. Raises BadRequest, NotComputedYet, Busy."""
        path, query = "/v1/tradeoff", {"format": format}
        return self._transport.get_when_computed(path, query, patience=patience, progress=progress).content

    def metrics(self) -> str:
        """The service's figures, in Prometheus's text form."""
        return self._transport.get("/metrics").text

    def close(self) -> None:
        """Close the connections. The jobs go on."""
        self._transport.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Client {self.url}>"


def _views(page: dict[str, Any]) -> list[Any]:
    if not isinstance(page.get("jobs"), list):
        raise UnexpectedAnswer("the service answered with something that is not a list of jobs")
    return list(page["jobs"])


def _job_id(text: str) -> str:
    """The id if it can be one, so that no text given as an id reaches another address."""
    if not re.fullmatch("[0-9a-f]{32}", text):
        detail = f"no job has the id {text!r}: an id is 32 hex digits"
        raise NotFound(Problem(status=404, title="Not Found", detail=detail))
    return text
