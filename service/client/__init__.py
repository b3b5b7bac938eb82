"""The Python client of bouncing-spring. Importing it loads no server library and no numerical one."""

from service.client.client import Client
from service.client.errors import (
    BadRequest,
    Busy,
    Conflict,
    InvalidSpecification,
    JobCancelled,
    JobFailed,
    NotComputedYet,
    NotFound,
    Refused,
    ServiceError,
    ServiceUnreachable,
    StoreUnreachable,
    TooLarge,
    Unanswered,
    Unauthorized,
    UnexpectedAnswer,
    WaitTimeout,
)
from service.client.job import Job
from service.client.models import Estimate, JobStatus, Problem, Progress
from worker.spec.errors import BounceError, SpecInvalid
from worker.spec.errors import Problem as FieldProblem

__all__ = [
    "BadRequest", "BounceError", "Busy", "Client", "Conflict", "Estimate", "FieldProblem",
    "InvalidSpecification", "Job", "JobCancelled", "JobFailed", "JobStatus", "NotComputedYet", "NotFound",
    "Problem", "Progress", "Refused", "ServiceError", "ServiceUnreachable", "SpecInvalid",
    "StoreUnreachable", "TooLarge", "Unanswered", "Unauthorized", "UnexpectedAnswer", "WaitTimeout",
]  # fmt: skip
