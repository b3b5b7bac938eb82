"""Errors that the service raises on purpose. They know nothing of HTTP: `api.problems` maps them to statuses.

    ServiceError
    ├── InvalidRequest         a field breaks a rule; `problems` names both
    ├── WrongMediaType         the body is not declared as plain JSON
    ├── BodyTimeout            the body did not arrive in time
    ├── TooLarge               body, sweep or response above a limit; the text says what would fit
    ├── Unauthenticated        the access token is missing or wrong
    ├── HostNotAllowed         the Host header is not one of the service's names
    ├── CrossOriginRefused     a web page of another origin sent the request
    ├── UnknownJob             no job has this id
    ├── NotInStore             a job's store has nothing under this key
        ├── OutOfRange             the Range begins beyond the end
    ├── KeyReused              an Idempotency-Key was used before with another body
    ├── IllegalTransition      the job's state does not allow this
    ├── OutdatedJob            another kernel version computed it: this would mix two versions
    ├── QueueFull              too many unfinished jobs
    ├── Busy                   too many concurrent expensive requests
    ├── TooManyListeners       too many event streams
    ├── NotComputed            no worker could compute the response
    ├── RunFailed              a study without a service could not be computed
        ├── NotInstalled           an extra of the package is missing
    ├── NoSpace                no disk space for an export
    ├── LedgerUnavailable      the ledger cannot be read or written at the moment
        ├── NotAdoptable           a store cannot be adopted as a job
    └── NotStarted             the service cannot start; the text says why
        ├── DataFolderBusy     another service uses the data folder
        └── LedgerUnusable     a newer version wrote the ledger, or the file is no ledger

An invalid specification is the worker's `worker.spec.errors.SpecError`.
"""

from collections.abc import Sequence

from worker.spec.errors import Problem


class ServiceError(Exception):
    """Base class; the text is fit to show to a user, `problems` names fields and the rules they break."""

    def __init__(self, detail: str, problems: Sequence[Problem] = ()) -> None:
        super().__init__(detail)
        self.problems = tuple(problems)


class InvalidRequest(ServiceError):
    """A field of the request breaks a rule."""

    @classmethod
    def of(cls, field: str, rule: str) -> "InvalidRequest":
        """The error for one field."""
        return cls(f"{field}: {rule}", [Problem(field, rule)])


class WrongMediaType(ServiceError):
    """The body is not declared as plain JSON."""


class BodyTimeout(ServiceError):
    """The body did not arrive in time."""


class TooLarge(ServiceError):
    """Body, sweep or response above a limit."""


class Unauthenticated(ServiceError):
    """The access token is missing or wrong."""


class HostNotAllowed(ServiceError):
    """The Host header is not one of the service's names."""


class CrossOriginRefused(ServiceError):
    """A web page of another origin sent the request."""


class UnknownJob(ServiceError):
    """No job has this id."""

    @classmethod
    def of(cls, job_id: str) -> "UnknownJob":
        """The error for one id."""
        return cls(f"no job has the id {job_id[:64]!a}")


class NotInStore(ServiceError):
    """A job's store has nothing under this key."""


class OutOfRange(ServiceError):
    """The Range begins beyond the end of the bytes under a key; `size`: their number."""

    def __init__(self, size: int) -> None:
        super().__init__(f"the range starts beyond the end ({size} bytes)")
        self.size = size


class KeyReused(ServiceError):
    """An Idempotency-Key was used before with another body."""


class IllegalTransition(ServiceError):
    """The job's state does not allow this."""


class OutdatedJob(ServiceError):
    """Another kernel version computed the job, and this would mix its numbers with this release's."""


class QueueFull(ServiceError):
    """Too many unfinished jobs."""


class Busy(ServiceError):
    """Too many concurrent expensive requests."""


class TooManyListeners(ServiceError):
    """Too many event streams."""


class NotComputed(ServiceError):
    """No worker could compute the response."""


class RunFailed(ServiceError):
    """A study that `service.local` ran could not be computed."""


class NotInstalled(ServiceError):
    """An extra of the package is missing; the text names it and how to install it."""


class NoSpace(ServiceError):
    """No disk space for an export."""


class LedgerUnavailable(ServiceError):
    """The ledger cannot be read or written at the moment."""


class NotAdoptable(ServiceError):
    """A store cannot be adopted as a job."""


class NotStarted(ServiceError):
    """The service cannot start."""


class DataFolderBusy(NotStarted):
    """Another service uses the data folder."""


class LedgerUnusable(NotStarted):
    """A newer version wrote the ledger, or the file is no ledger."""
