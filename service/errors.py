"""What the service refuses on purpose. `api.problems` says which HTTP status each has.

    ServiceError
    ├── WrongMediaType         the body is declared as something else
    ├── BodyTimeout            the body did not arrive in time
    ├── InvalidRequest         a field breaks a rule; names both
    ├── Unauthenticated           no token came with the request, or a wrong one
    ├── HostNotAllowed              the Host header names no name of this service
    ├── CrossOriginRefused            a page from elsewhere asks for a change
    ├── UnknownJob             no job has this id
    ├── NotInStore             a job's store has nothing under this key
    ├── KeyReused              an Idempotency-Key came again with another body
    ├── IllegalTransition      the job is not in a state that allows this
    ├── TooLarge               body, sweep or answer above a cap; says what would fit
    ├── QueueFull              too many jobs wait already
    ├── Busy                   too many costly requests are being answered already
    ├── NotComputed            no worker is there to answer, or those that did were lost
    ├── NoSpace                there is no room for a file of an answer
    ├── DataFolderBusy         another service uses the data folder (only at start)
    ├── LedgerUnusable         the ledger is none, or was written by a newer version (only at start)
    └── LedgerUnavailable      the ledger's file cannot be read or written now

A specification that cannot be used is the worker's `SpecError`, told in its own words.
"""

from collections.abc import Sequence

from worker.spec.errors import Problem


class ServiceError(Exception):
    """Root of what the service refuses on purpose; the text is fit to show to a user."""

    def __init__(self, detail: str, rules: Sequence[Problem] = ()) -> None:
        super().__init__(detail)
        self.problems = tuple(rules)


class WrongMediaType(ServiceError):
    """The body is declared as something else than JSON."""


class BodyTimeout(ServiceError):
    """The body did not arrive in time."""


class InvalidRequest(ServiceError):
    """A field of the request breaks a rule."""

    @classmethod
    def of(cls, field: str, rule: str) -> "InvalidRequest":
        """The error for one field."""
        return cls(f"{field}: {rule}", [Problem(field, rule)])


class Unauthenticated(ServiceError):
    """No token came with the request, or a wrong one."""


class HostNotAllowed(ServiceError):
    """The Host header names no name of this service."""


class CrossOriginRefused(ServiceError):
    """A page from elsewhere asks for a change."""


class NotInStore(ServiceError):
    """A job's store has nothing under this key."""


class KeyReused(ServiceError):
    """An Idempotency-Key came again with another body."""


class UnknownJob(ServiceError):
    """No job has this id."""

    @classmethod
    def of(cls, job_id: str) -> "UnknownJob":
        """The error for one id."""
        return cls(f"no job has the id {job_id[:64]!a}")


class IllegalTransition(ServiceError):
    """The job is not in a state that allows this."""


class TooLarge(ServiceError):
    """Body, sweep or answer above a cap."""


class QueueFull(ServiceError):
    """Too many jobs wait already."""


class Busy(ServiceError):
    """Too many costly requests are being answered already."""


class NotComputed(ServiceError):
    """No worker is there to compute an answer, or those that did were lost."""


class NoSpace(ServiceError):
    """There is no room for a file of an answer."""


class DataFolderBusy(ServiceError):
    """Another service uses the data folder."""


class LedgerUnusable(ServiceError):
    """The ledger was written by a newer version, or the file is no ledger."""


class LedgerUnavailable(ServiceError):
    """The ledger's file cannot be read or written now."""
