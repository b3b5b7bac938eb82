"""Everything the client raises on purpose.

    BounceError
    ├── ServiceUnreachable          nothing answered at the address
    ├── UnexpectedAnswer            something answered, but not this service
    ├── Refused                     the service answered with a problem document
    │   ├── BadRequest              400, 422: a field breaks a rule; `fields` names both
    │   │   └── InvalidSpecification    ... of a sweep (also raised before sending)
    │   ├── Unauthorized            401, 403: no token, or the wrong one
    │   ├── NotFound                404
    │   ├── Conflict                409: the job is not in a state that allows it
    │   ├── TooLarge                413: body, sweep or answer above a cap
    │   ├── Busy                    429, 503: try again after `retry_after` seconds
    │   └── ServiceError            any other 5xx
    ├── JobFailed                   the job ended as failed; `job` is the job
    ├── JobCancelled                the job ended as cancelled
    ├── WaitTimeout                 the wait ended, the job did not (also a TimeoutError)
    ├── NotComputedYet              the wait ended, the workers' computing did not (also a TimeoutError)
    └── StoreUnreachable            the job's zarr store cannot be opened from here

`Refused` and its children carry the problem document (RFC 9457) as `problem`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

if TYPE_CHECKING:
    from service.client.job import Job


class FieldProblem(NamedTuple):
    """One field and the rule it breaks."""

    field: str
    rule: str


@dataclass(frozen=True)
class Problem:
    """A problem document: what the service says went wrong."""

    status: int
    title: str
    detail: str = ""
    type: str = "about:blank"
    instance: str | None = None
    fields: tuple[FieldProblem, ...] = ()

    @classmethod
    def from_json(cls, document: Mapping[str, Any], *, status: int, reason: str) -> "Problem":
        """Read what is there and fill in the rest: a problem document may leave out any member."""
        return cls(
            status=status,
            title=str(document.get("title") or reason or f"status {status}"),
            detail=str(document.get("detail") or ""),
            type=str(document.get("type") or "about:blank"),
            instance=document.get("instance"),
            fields=_fields(document.get("errors")),
        )

    def __str__(self) -> str:
        """Detail in one line, then a line for each field that the detail does not already tell."""
        text = self.detail or self.title
        return "\n".join(
            [text, *(f"  {field}: {rule}" for field, rule in self.fields if f"{field}: {rule}" not in text)]
        )


class BounceError(Exception):
    """Root of everything the client raises on purpose; its text is fit to show to a user."""


class ServiceUnreachable(BounceError):
    """Nothing answered at `url`."""

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(f"no service answers at {url} ({reason}); start one with: bounce serve")
        self.url = url


class UnexpectedAnswer(BounceError):
    """Something answered that does not speak this service's language."""


class Refused(BounceError):
    """The service answered with a problem; `problem` says which field broke which rule."""

    def __init__(self, problem: Problem, *, retry_after: float | None = None) -> None:
        super().__init__(str(problem))
        self.problem = problem
        self.retry_after = retry_after

    @property
    def status(self) -> int:
        """The HTTP status."""
        return self.problem.status

    @property
    def fields(self) -> tuple[FieldProblem, ...]:
        """The fields at fault, in the order the service named them; empty if it named none."""
        return self.problem.fields


class BadRequest(Refused):
    """A field of the request breaks a rule."""


class InvalidSpecification(BadRequest):
    """A field of the sweep specification breaks a rule."""

    @classmethod
    def local(cls, detail: str, fields: tuple[FieldProblem, ...] = ()) -> "InvalidSpecification":
        """The same error found before anything was sent."""
        return cls(Problem(status=422, title="invalid specification", detail=detail, fields=fields))


class Unauthorized(Refused):
    """The service wants a token, or another one."""


class NotFound(Refused):
    """The service knows no such thing."""


class Conflict(Refused):
    """The job is not in a state that allows this."""


class TooLarge(Refused):
    """The body, the sweep or the answer is above one of the service's caps."""


class Busy(Refused):
    """The service cannot take this now; `retry_after` is in seconds where it said."""


class ServiceError(Refused):
    """The service itself failed."""


class JobFailed(BounceError):
    """The job ended as failed; `job.error` is its reason."""

    def __init__(self, job: "Job") -> None:
        super().__init__(f"job {job.id} failed: {job.error or 'no reason given'}")
        self.job = job


class JobCancelled(BounceError):
    """The job was cancelled before it was done."""

    def __init__(self, job: "Job") -> None:
        super().__init__(
            f"job {job.id} was cancelled at {job.progress.whole_percent}%; submit the same sweep to resume it"
        )
        self.job = job


class WaitTimeout(BounceError, TimeoutError):
    """The wait ended before the job did; the job goes on."""

    def __init__(self, job: "Job", seconds: float) -> None:
        super().__init__(
            f"job {job.id} is {job.state} at {job.progress.whole_percent}% after {seconds:g} s; it goes on"
        )
        self.job = job


class NotComputedYet(BounceError, TimeoutError):
    """The wait ended before the workers had the answer; they go on, so that asking again costs nothing."""

    def __init__(self, done: int, total: int, seconds: float) -> None:
        super().__init__(f"{done} of {total} parts computed after {seconds:g} s; it goes on: ask again")


class StoreUnreachable(BounceError):
    """The job's store cannot be opened from this machine."""


_BY_STATUS: Final[dict[int, type[Refused]]] = {
    400: BadRequest,
    401: Unauthorized,
    403: Unauthorized,
    404: NotFound,
    409: Conflict,
    413: TooLarge,
    422: BadRequest,
    429: Busy,
    503: Busy,
}


def refusal(status: int) -> type[Refused]:
    """The class that stands for an HTTP status of 400 or more."""
    return _BY_STATUS.get(status) or (ServiceError if status >= 500 else Refused)


def _fields(errors: object) -> tuple[FieldProblem, ...]:
    """The `errors` member, each entry naming a field and a rule; entries of another shape are left out."""
    entries = errors if isinstance(errors, list) else []
    return tuple(
        FieldProblem(str(entry.get("field") or ""), str(entry.get("rule") or ""))
        for entry in entries
        if isinstance(entry, dict)
    )
