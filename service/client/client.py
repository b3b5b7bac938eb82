"""The entry point: a client of one service, which submits sweeps and returns jobs."""

import math
import os
import re
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from datetime import datetime
from functools import partial
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

from service.client import errors
from service.client.display import display_line
from service.client.job import Job, ResultReader, until_ended
from service.client.models import Estimate, Problem
from service.client.specification import Specification, body
from service.client.transport import MAX_OUTAGE, Transport, header_value, json_object, outlast
from service.formats import MOST_SHARED, Progress
from service.result_methods import SpringMethods
from service.tokens import default_url
from worker.spec.errors import BounceError

if TYPE_CHECKING:
    import httpx2
    import xarray

#: Jobs in one request for a list of jobs.
PAGE_SIZE: Final = 1000
#: Seconds between two looks at a budget.
BUDGET_DELAY: Final = 0.2

#: Hex digits of an id, and the fewest leading ones that select a job. No other text becomes part of an
#: address.
_ID_LENGTH: Final = 32
_SHORTEST_ID: Final = 4


class Client(ResultReader, SpringMethods, AbstractContextManager["Client"]):
    """A client of a running service.

        with Client() as client:
            job = client.submit({"gamma": {"start": 1, "stop": 6, "num": 1001}, "omega": 0.5, "xi": 0.26})
            diagram = job.wait().diagram()

    Exceptions raised on purpose are `BounceError`, of files `OSError`.

    Parameters
    ----------
    url
        Address of the service; by default BOUNCE_URL, else that of the user's own service, which runs on the
        data folder BOUNCE_DATA, by default ./bounce-data, else http://127.0.0.1:8000.
    token
        Access token, required unless the service listens on loopback only; by default BOUNCE_TOKEN, else the
        one that the user's own service has created (`bounce serve --token auto`).
    timeout
        Time limit of one request in seconds.
    http
        Sends the requests instead of the client's own connection (for proxies, certificates, or an
        application in this process); closing the client does not close it.
    """

    def __init__(
        self,
        url: str | None = None,
        token: str | None = None,
        timeout: float = 30.0,
        *,
        http: "httpx2.Client | None" = None,
    ) -> None:
        if not hasattr(timeout, "__float__") or not timeout > 0.0:
            raise BounceError(f"timeout: must be seconds above 0, not {timeout!r:.40}")
        token = os.environ.get("BOUNCE_TOKEN") if token is None else token
        self._transport = Transport(default_url() if url is None else url, token, timeout, http)

    @property
    def url(self) -> str:
        """The address of the service."""
        return self._transport.url

    @property
    def page(self) -> str:
        """The address of the service's page, with the access token, if any, in its fragment."""
        token = self._transport.token
        return f"{self.url}/" if token is None else f"{self.url}/#token={quote(token, safe='')}"

    def submit(self, spec: Specification, *, key: str | None = None) -> Job:
        """Submit a sweep.

        The same sweep is always the same job: submitted again, a done job is returned as it is, and a failed
        or cancelled one continues.

        Parameters
        ----------
        spec
            A mapping, a `SweepSpec`, or the path of a .json or .toml file.
        key
            Idempotency key: a repeated request changes nothing, whatever happened to the job since.

        Returns
        -------
        Job
            The accepted or existing job.

        Raises
        ------
        InvalidSpecification
            A field breaks a rule; the error names both.
        Conflict
            The key was used for another specification.
        TooLarge, Busy
        """
        headers = {"Idempotency-Key": header_value("an idempotency key", key)} if key is not None else None
        response = self._transport.post("/v1/jobs", body(spec), headers=headers)
        return Job(self._transport, json_object(response), response)

    def run(self, spec: Specification, *, budget: float, progress: bool = True) -> Job:
        """Compute the finest level of a sweep that fits into `budget` seconds, waiting for workers included.

        The service computes levels, sweeps from coarse to fine, one after another, even if this client goes
        away: plain jobs, whose results can be read while the next one is computed. Returns the last one that
        is done; `job.audit()` says at once how wrong it is, if the time sufficed. Raises InvalidSpecification
        if the time is too short for any level, BounceError if the service ended, and with it the budget. Also
        raises as `submit`.
        """
        response = self._transport.post("/v1/jobs", body(spec), query={"budget": budget})
        first, doing = Job(self._transport, json_object(response), response), ""
        while (reached := first.view.get("budget")) is not None:
            if progress and reached["doing"] != doing:
                doing = reached["doing"]
                display_line(doing if reached["over"] else f"{doing}, {reached['seconds_left']} s left")
            if reached["over"]:
                if reached["answer"] is None:
                    raise errors.InvalidSpecification.before_sending(reached["error"])
                return self.job(reached["answer"])
            time.sleep(BUDGET_DELAY)
            # budgets of others have the same first level
            first._refresh_in_time(shown=progress, budget=reached.get("id"))
        raise BounceError("the service has begun anew, which ends the budget: its levels are among the jobs")

    def import_shared(self, path: "str | PathLike[str]") -> Job:
        """Import the sweep of a file that `Job.share` wrote: a done job, the same to the last bit.

        Its audit and measured points stay behind. Raises BadRequest for a file of another kind, a damaged
        one, or one without all numbers, TooLarge, Conflict, Busy.
        """
        with Path(path).open("rb") as file:
            content = file.read(MOST_SHARED + 1)  # one more is refused
        headers = {"Content-Type": "application/octet-stream"}
        response = self._transport.post("/v1/imports", content, headers=headers, waits=True)
        return Job(self._transport, json_object(response), response)

    def estimate(self, spec: Specification) -> Estimate:
        """The estimated cost of a sweep, without submitting it. Raises as `submit`."""
        query = {"validate_only": "true"}
        answer = json_object(self._transport.post("/v1/jobs", body(spec), query=query))
        try:
            return Estimate(**{name: answer[name] for name in Estimate._fields if name in answer})
        except TypeError as error:
            raise errors.UnexpectedAnswer(f"the answer is not an estimate: {error!r}") from error

    def job(self, id: str) -> Job:
        """Find a job.

        Parameters
        ----------
        id
            The whole id, or enough of its beginning to select one job: at least four hex digits.

        Raises
        ------
        NotFound
            No job, or several, have an id that begins so.
        """
        id = str(id)
        if not re.fullmatch(f"[0-9a-f]{{{_SHORTEST_ID},{_ID_LENGTH}}}", id):
            raise _not_found(
                f"no job has the id {id!r}: an id is {_ID_LENGTH} hex digits, and its first {_SHORTEST_ID} "
                "or more select it where no other id begins so"
            )
        if len(id) < _ID_LENGTH:
            id = self._whole_id(id)
        response = self._transport.get(f"/v1/jobs/{id}")
        return Job(self._transport, json_object(response), response)

    def _whole_id(self, beginning: str) -> str:
        ids = [job.id for job in self.jobs(search=beginning) if job.id.startswith(beginning)]
        if not ids:
            raise _not_found(f"no job has an id that begins with {beginning}")
        if len(ids) > 1:
            named = ", ".join(sorted(ids)[:5])
            raise _not_found(f"{len(ids)} jobs have ids that begin with {beginning}, as {named}")
        return ids[0]

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
        """List the jobs that match every argument; by default all. Requests them page by page.

        Parameters
        ----------
        state
            State of the jobs.
        search
            Part of the name or beginning of the id.
        model, protocol
            Kinds, such as "rigid" and "ramp".
        pinned
            Whether the jobs are pinned.
        created_from, created_before
            Limits on the time of creation, in UTC if they name no zone.
        order
            "newest" (default), "oldest", "finished", "name" or "largest".
        """
        query: dict[str, Any] = {
            "state": state, "search": search, "model": model, "protocol": protocol, "pinned": pinned,
            "created_from": created_from, "created_before": created_before, "order": order,
            "limit": PAGE_SIZE,
        }  # fmt: skip
        while True:
            page = json_object(self._transport.get("/v1/jobs", query))
            if not isinstance(page.get("jobs"), list):
                raise errors.UnexpectedAnswer("the answer is not a list of jobs")
            for view in page["jobs"]:
                yield Job(self._transport, view)
            if not page.get("next"):
                return
            query["cursor"] = page["next"]

    def as_completed(self, jobs: Iterable[Job], timeout: float | None = None) -> Iterator[Job]:
        """Yield the jobs as they end: done, failed or cancelled; see `Job.state`.

        Parameters
        ----------
        jobs
            The jobs to wait for.
        timeout
            Seconds for all of them together.

        Raises
        ------
        WaitTimeout
            Has one of the jobs that continue.
        ServiceUnreachable
            As for `Job.wait`.
        """
        return until_ended(jobs, timeout, shown=True)

    def map(self, specs: Iterable[Specification], *, at_once: int = 16) -> Iterator[Job]:
        """Submit specifications and yield their jobs in order, each once it has ended.

        Parameters
        ----------
        specs
            As for `submit`. A long list neither fills the service's queue nor needs to be known in advance.
        at_once
            Limit on the jobs at the service that are not yet returned.

        Raises
        ------
        BounceError
            `at_once` is below 1. A specification raises as in `submit` when its turn comes, but waits for a
            full queue, and 30 seconds for a service that is away.
        """
        if at_once < 1:
            raise BounceError(f"at_once: must be at least 1, not {at_once}")
        remaining, submitted, away = iter(specs), deque[Job](), 0.0
        while True:
            for spec in islice(remaining, at_once - len(submitted)):
                submitted.append(outlast(partial(self.submit, spec), away=away, busy=math.inf, shown=True))
                away = MAX_OUTAGE  # once the service has answered
            if not submitted:
                return
            yield from until_ended([submitted.popleft()], None, shown=True)

    def plan(
        self,
        spec: Specification,
        *,
        budget: float | None = None,
        tolerance: float | None = None,
        seed: int = 0,
        timeout: float = 600.0,
        progress: Progress = True,
    ) -> "xarray.Dataset":
        """What efforts and grids of a sweep would cost, and how much of its picture would be wrong.

        Parameters
        ----------
        spec
            A sweep from rest.
        budget
            Seconds that the recommended setting takes at most.
        tolerance
            Share of the plane that it shows wrong at most, by default 0.05 without a budget.
        seed
            Of the pilot points.
        timeout, progress
            As for a result that workers compute.

        Returns
        -------
        xarray.Dataset
            A row for each `setting`: `effort`, `grid`, `cells`, `seconds` on the service's workers, `share`
            with `low` and `high`, `bytes`, `frontier`, `recommended`, `spec`.

        Raises
        ------
        BadRequest, Busy
        """
        from service.client.dataset import from_binary

        query = {"budget": budget, "tolerance": tolerance, "seed": seed}
        return from_binary(self.plan_file(spec, "bin", **query, timeout=timeout, progress=progress))

    def plan_file(self, spec: Specification, format: str, **query: Any) -> bytes:
        """The same as the content of a file: json, csv, nc, parquet, or a picture png, svg, pdf."""
        return self._transport.get_result("/v1/plans", format, content=body(spec), **query)

    def trajectory(self, cell: Mapping[str, Any]) -> "xarray.Dataset":
        """The motion of one cell, computed during the request.

        `cell` contains `gamma`, `omega`, `xi`, and optionally `model`, `settle` and `periods` (plate
        periods), `samples` per period, and `start`: a cycle, `{"periods"}`,
        `{"kind": "drop", "height", "phase"}`, or `{"kind": "contact", "elongation", "velocity"}`. Returns a
        Dataset as `Job.trajectory`. Raises BadRequest naming the field, TooLarge, Busy.
        """
        from service.client.dataset import from_binary

        return from_binary(self.trajectory_file(cell, "bin"))

    def trajectory_file(self, cell: Mapping[str, Any], format: str) -> bytes:
        """The same as the content of a file: json, csv, nc or parquet."""
        query = {"format": format}
        return self._transport.post("/v1/trajectories", body(cell), query=query, waits=True).content

    def close(self) -> None:
        """Close the connections. Jobs continue."""
        self._transport.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Client {self.url}>"


def _not_found(detail: str) -> errors.NotFound:
    return errors.NotFound(Problem(status=404, title="Not Found", detail=detail))
