"""Errors that the service raises on purpose, each with its HTTP status.

An invalid specification is the worker's `worker.spec.errors.SpecError`.
"""

from collections.abc import Sequence
from typing import ClassVar, Final

from worker.spec.errors import BounceError, Problem

#: The project's packages.
_OURS: Final = ("kernel", "service", "worker")


def missing_library(error: ModuleNotFoundError) -> str | None:
    """What to install where the client is installed alone; None if a module of the project is missing."""
    name = str(error.name).partition(".")[0]
    if name in _OURS:
        return None
    return f"needs {name}, which is not installed with the client alone: pip install -e ."


class ServiceError(BounceError):
    """Base class. The text may be shown to users; `problems` names fields and the rules that they break.

    `status` is the HTTP status: 500 for errors that no request causes.
    """

    status: ClassVar[int] = 500

    def __init_subclass__(cls, status: int | None = None) -> None:
        cls.status = cls.status if status is None else status

    def __init__(self, detail: str, problems: Sequence[Problem] = ()) -> None:
        super().__init__(detail)
        self.problems = tuple(problems)


class InvalidRequest(ServiceError, status=422):
    """A field of the request breaks a rule."""

    @classmethod
    def of(cls, field: str, rule: str) -> "InvalidRequest":
        """The error for one field."""
        return cls(f"{field}: {rule}", [Problem(field, rule)])


class TooLarge(ServiceError, status=413):
    """Body, sweep or response above a limit; the text says what would fit."""


class UnknownJob(ServiceError, status=404):
    """No job has this id."""

    @classmethod
    def of(cls, job_id: str) -> "UnknownJob":
        """The error for one id."""
        why = "was it deleted?" if len(job_id) == 32 else "an id is 32 hex digits"
        return cls(f"no job has the id {job_id[:64]!a}: {why}")


class KeyReused(ServiceError, status=409):
    """An Idempotency-Key was used before with another body."""


class IllegalTransition(ServiceError, status=409):
    """The job's state does not allow this."""


class OutdatedJob(ServiceError, status=409):
    """Another kernel version computed the job, and this would mix its numbers with this release's."""


class QueueFull(ServiceError, status=429):
    """Too many unfinished jobs."""


class Busy(ServiceError, status=429):
    """Too many concurrent costly requests."""


class NotComputed(ServiceError, status=503):
    """No worker could compute the answer."""


class RunFailed(ServiceError):
    """A study that `service.local` ran could not be computed."""


class NotInstalled(ServiceError, status=501):
    """An extra of the package is missing; the text names it and how to install it."""


class NoSpace(ServiceError, status=507):
    """No disk space for an export."""


class LedgerUnavailable(ServiceError, status=503):
    """The ledger cannot be read or written at the moment."""


class NotAdoptable(ServiceError):
    """A store cannot be adopted as a job."""


class NotStarted(ServiceError):
    """The service cannot start; the text says why."""


class DataFolderBusy(NotStarted):
    """Another service uses the data folder."""


class LedgerUnusable(NotStarted):
    """A newer version wrote the ledger, the file is not a ledger, or it has rows that no service writes."""
