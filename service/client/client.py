"""The entry point: a client of one service, which submits sweeps and returns jobs."""

import re
from collections import deque
from collections.abc import Iterator
from datetime import datetime
from itertools import islice
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self
from urllib.parse import quote

from service.client.display import PartsCallback
from service.client.errors import NotFound, UnexpectedAnswer
from service.client.job import Job, as_completed, wait_all
from service.client.models import Estimate, Problem
from service.client.specification import Specification, body
from service.client.transport import Transport, header_value, json_object
from service.result_methods import SpringMethods

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import httpx2
    import xarray

DEFAULT_URL: Final = "http://127.0.0.1:8000"

#: Jobs in one request for a list of jobs.
PAGE_SIZE: Final = 1000

#: Hex digits of an id, and the fewest of its first ones that select a job. No other text becomes a part of an
#: address.
_ID_LENGTH: Final = 32
_SHORTEST_ID: Final = 4


class Client(SpringMethods):
    """A client of a running service.

        with Client() as client:
            job = client.submit({"gamma": {"start": 1, "stop": 6, "num": 1001}, "omega": 0.5, "xi": 0.26})
            diagram = job.wait().diagram()

    `url` is the address of the service; `token` is its access token, which it requires unless it listens on
    loopback only. Without one, the client looks for the token that a service of the same user has made
    (`bounce serve --token auto`) in the data folder BOUNCE_DATA, by default ./bounce-data. `timeout` is the
    time limit of one request in seconds. `http` sends the requests instead of a connection of the client's
    own (for proxies, certificates, or an application in this process); closing the client does not close it.
    Every exception raised on purpose is a `BounceError`.
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

    @property
    def page(self) -> str:
        """The address of the service's page, with the access token, if there is one, in its fragment."""
        token = self._transport.token
        return f"{self.url}/" if token is None else f"{self.url}/#token={quote(token, safe='')}"

    def submit(self, spec: Specification, *, key: str | None = None) -> Job:
        """Submit a sweep: a mapping, a `worker.spec.SweepSpec`, or the path of a .json, .toml or .yaml file.

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
            return Estimate(**{name: answer[name] for name in Estimate._fields if name in answer})
        except TypeError as error:
            raise UnexpectedAnswer(f"the answer is not an estimate: {error!r}") from error

    def job(self, id: str) -> Job:
        """The job with this id, or the only one whose id begins with it: four hex digits or more.

        Raises NotFound, also where several ids begin so.
        """
        if not re.fullmatch(f"[0-9a-f]{{{_SHORTEST_ID},{_ID_LENGTH}}}", id):
            raise _not_found(
                f"no job has the id {id!r}: an id is {_ID_LENGTH} hex digits, and its first {_SHORTEST_ID} "
                "or more select it where no other id begins so"
            )
        if len(id) < _ID_LENGTH:
            id = self._whole_id(id)
        return Job(self._transport, self._transport.get(f"/v1/jobs/{id}"))

    def _whole_id(self, beginning: str) -> str:
        """The only id that begins so."""
        found = [job.id for job in self.jobs(search=beginning) if job.id.startswith(beginning)]
        if not found:
            raise _not_found(f"no job has an id that begins with {beginning}")
        if len(found) > 1:
            named = ", ".join(sorted(found)[:5])
            raise _not_found(f"{len(found)} jobs have ids that begin with {beginning}, as {named}")
        return found[0]

    def result(self, name: str, /, **query: Any) -> "xarray.Dataset":
        """The result of a spring alone, as the method of that name returns it. Raises BadRequest."""
        from service.client.dataset import from_binary

        return from_binary(self.result_file(name, "bin", **query))

    def result_file(self, name: str, format: str, /, **query: Any) -> bytes:
        """A result of a spring alone as the content of a file. Raises BadRequest."""
        return self._transport.get_result(f"/v1/{name}", format, **query)

    def jobs(
        self,
        state: str | None = None,
        *,
        search: str | None = None,
        model: str | None = None,
        protocol: str | None = None,
        pinned: bool | None = None,
        created_from: datetime | str | None = None,
        created_before: datetime | str | None = None,
        order: str | None = None,
    ) -> Iterator[Job]:
        """All jobs, or those that every argument allows; requested page by page.

        `search` is part of the name or the beginning of the id; `model` and `protocol` are kinds, such as
        "rigid" and "ramp"; times are in UTC if they name no zone; `order` is "newest" (the default),
        "oldest", "finished", "name" or "largest".
        """
        query: dict[str, Any] = {
            "state": state,
            "search": search,
            "model": model,
            "protocol": protocol,
            "pinned": pinned,
            "created_from": _time(created_from),
            "created_before": _time(created_before),
            "order": order,
            "limit": PAGE_SIZE,
        }
        while True:
            page = json_object(self._transport.get("/v1/jobs", query))
            if not isinstance(page.get("jobs"), list):
                raise UnexpectedAnswer("the answer is not a list of jobs")
            for view in page["jobs"]:
                yield Job.from_view(self._transport, view)
            if not page.get("next"):
                return
            query["cursor"] = page["next"]

    def as_completed(self, jobs: "Iterable[Job]", timeout: float | None = None) -> Iterator[Job]:
        """The jobs as they end: done, failed or cancelled; see `Job.state`.

        `timeout` is in seconds for all of them. Raises WaitTimeout, with one of the jobs that continue, and
        ServiceUnreachable as `Job.wait`.
        """
        return as_completed(jobs, timeout)

    def wait_all(
        self, jobs: "Iterable[Job]", timeout: float | None = None, progress: bool | PartsCallback = True
    ) -> list[Job]:
        """Wait until all jobs have ended, and return them in their order.

        `progress`: True writes how many have ended to standard error; a function is called with their number
        and that of all. Raises JobFailed or JobCancelled for the first that is not done, WaitTimeout, and
        ServiceUnreachable as `Job.wait`.
        """
        return wait_all(jobs, timeout, progress)

    def map(self, specs: "Iterable[Specification]", *, at_once: int = 16) -> Iterator[Job]:
        """Submit specifications and return their jobs in order, each once it has ended.

        At most `at_once` jobs that are not returned yet are at the service, so that a long list neither fills
        its queue nor needs to be known in advance. Raises as `submit` does when the specification's turn
        comes, ValueError for `at_once` below 1.
        """
        if at_once < 1:
            raise ValueError(f"at_once: must be at least 1, not {at_once}")
        return self._map(iter(specs), at_once)

    def _map(self, specs: "Iterator[Specification]", at_once: int) -> Iterator[Job]:
        submitted: deque[Job] = deque()
        while True:
            for spec in islice(specs, at_once - len(submitted)):
                submitted.append(self.submit(spec))
            if not submitted:
                return
            job = submitted.popleft()
            yield next(as_completed([job]))

    def trajectory(self, cell: "Mapping[str, Any]") -> "xarray.Dataset":
        """The motion of one cell, computed during the request.

        `cell` contains `gamma`, `omega`, `xi`, and optionally `model`, `settle` and `periods` (plate
        periods), `samples` per period, and `start`: a cycle of the closed form, or
        `{"kind": "drop", "height", "phase"}`, or `{"kind": "contact", "elongation", "velocity"}`. Returns a
        Dataset as `Job.trajectory`. Raises BadRequest naming the field, TooLarge, Busy.
        """
        from service.client.dataset import from_binary

        return from_binary(self.trajectory_file(cell, "bin"))

    def trajectory_file(self, cell: "Mapping[str, Any]", format: str) -> bytes:
        """The same as the content of a file: json, csv, nc or parquet."""
        query = {"format": format}
        return self._transport.post(
            "/v1/trajectories", body(cell), query=query, idempotent=True, waits=True
        ).content

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


def _not_found(detail: str) -> NotFound:
    return NotFound(Problem(status=404, title="Not Found", detail=detail))


def _time(time: datetime | str | None) -> str | None:
    return time.isoformat() if isinstance(time, datetime) else time
