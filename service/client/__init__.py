"""The Python client of bouncing-spring. Importing it loads no server library."""

from service.client.client import Client, Estimate
from service.client.errors import (
    BadRequest,
    BounceError,
    Busy,
    Conflict,
    FieldProblem,
    InvalidSpecification,
    JobCancelled,
    JobFailed,
    NotFound,
    Problem,
    Refused,
    ServiceError,
    ServiceUnreachable,
    StoreUnreachable,
    TooLarge,
    Unauthorized,
    UnexpectedAnswer,
    WaitTimeout,
)
from service.client.job import Job, Progress

__all__ = [
    "BadRequest",
    "BounceError",
    "Busy",
    "Client",
    "Conflict",
    "Estimate",
    "FieldProblem",
    "InvalidSpecification",
    "Job",
    "JobCancelled",
    "JobFailed",
    "NotFound",
    "Problem",
    "Progress",
    "Refused",
    "ServiceError",
    "ServiceUnreachable",
    "StoreUnreachable",
    "TooLarge",
    "Unauthorized",
    "UnexpectedAnswer",
    "WaitTimeout",
]
