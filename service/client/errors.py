"""Every exception that the client raises on purpose (docs/python-client.md).

`Refused` and its subclasses carry the problem document (RFC 9457) as `problem`.
"""

from typing import Final

from service.client.models import JobStatus, Problem
from worker.spec.errors import BounceError
from worker.spec.errors import Problem as FieldProblem


class ServiceUnreachable(BounceError):
    """Nothing answered at `url`."""

    _said = "no service answers at {} ({}); start one with: bounce serve"

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(self._said.format(url, reason))
        self.url = url


class Unanswered(ServiceUnreachable):
    """The service at `url` took the request but did not answer: it may be busy."""

    _said = "the service at {} did not answer: {}"


class UnexpectedAnswer(BounceError):
    """The answer is not one of this service."""


class Refused(BounceError):
    """The service answered with a problem document, `problem`, or a proxy in its place."""

    def __init__(self, problem: Problem, *, retry_after: float | None = None, of_proxy: bool = False) -> None:
        super().__init__(str(problem))
        self.problem = problem
        self.retry_after = retry_after
        self.of_proxy = of_proxy

    @property
    def status(self) -> int:
        """The HTTP status."""
        return self.problem.status

    @property
    def fields(self) -> tuple[FieldProblem, ...]:
        """The fields at fault, in the order of the problem document; empty if there are none."""
        return self.problem.fields


class BadRequest(Refused):
    """A field of the request breaks a rule."""


class InvalidSpecification(BadRequest):
    """A field of the sweep specification breaks a rule."""

    @classmethod
    def before_sending(cls, detail: str, fields: tuple[FieldProblem, ...] = ()) -> "InvalidSpecification":
        """The exception for a specification that the client itself rejects."""
        return cls(Problem(status=422, title="invalid specification", detail=detail, fields=fields))


class Unauthorized(Refused):
    """The service requires an access token, or another one."""


class NotFound(Refused):
    """The service has no such job or resource."""


class Conflict(Refused):
    """The job's state does not allow the request."""


class TooLarge(Refused):
    """The body, the sweep or the answer is above one of the service's limits."""


class Busy(Refused):
    """The service cannot take the request now; `retry_after` is in seconds, None if not given."""


class ServiceError(Refused):
    """The service failed."""


class JobFailed(BounceError):
    """The job ended as failed; `job.error` is the reason."""

    def __init__(self, job: JobStatus) -> None:
        super().__init__(f"job {job.id} failed: {job.error or 'no reason given'}; resume it to go on")
        self.job = job


class JobCancelled(BounceError):
    """The job was cancelled before it was done."""

    def __init__(self, job: JobStatus) -> None:
        super().__init__(f"job {job.id} was cancelled at {job.progress.whole_percent}%; resume it to go on")
        self.job = job


class WaitTimeout(BounceError, TimeoutError):
    """The wait ended before the job; the job continues."""

    def __init__(self, job: JobStatus, seconds: float) -> None:
        super().__init__(
            f"job {job.id} is {job.state} at {job.progress.whole_percent}% after {seconds:g} s; "
            "the job continues"
        )
        self.job = job


class NotComputedYet(BounceError, TimeoutError):
    """The wait ended before the workers had the answer; they continue for a minute."""

    def __init__(self, done: int, total: int, seconds: float) -> None:
        super().__init__(
            f"{done} of {total} parts computed after {seconds:g} s; the computation continues for a minute: "
            "repeat the request until then"
        )


class StoreUnreachable(BounceError):
    """The job's zarr store cannot be opened."""


_CLASS_BY_STATUS: Final[dict[int, type[Refused]]] = {
    400: BadRequest,
    401: Unauthorized,
    403: Unauthorized,
    404: NotFound,
    409: Conflict,
    410: NotFound,
    413: TooLarge,
    422: BadRequest,
    429: Busy,
    503: Busy,
}


def error_class(status: int) -> type[Refused]:
    """The exception class for an HTTP status of 400 or more."""
    return _CLASS_BY_STATUS.get(status) or (ServiceError if status >= 500 else Refused)
