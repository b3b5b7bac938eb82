"""The Python client of bouncing-spring. Importing it loads no server library and no numerical one.

The specifications and their parts can be imported from here too: they load numpy and pydantic when used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Final

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
from service.client.models import Estimate, FieldProblem, JobStatus, Problem, Progress
from worker.spec.errors import BounceError, SpecInvalid

if TYPE_CHECKING:
    from worker.spec.axes import Range
    from worker.spec.contact_models import Auto, Ball, Rigid, Soft, Stepped
    from worker.spec.refine import Refine
    from worker.sweep import SweepSpec
    from worker.sweep.protocols import OnCycle, Ramp, Rest

__all__ = [
    "Auto", "BadRequest", "Ball", "BounceError", "Busy", "Client", "Conflict", "Estimate",
    "FieldProblem", "InvalidSpecification", "Job", "JobCancelled", "JobFailed", "JobStatus",
    "NotComputedYet", "NotFound", "OnCycle", "Problem", "Progress", "Ramp", "Range", "Refine", "Refused",
    "Rest", "Rigid", "ServiceError", "ServiceUnreachable", "Soft", "SpecInvalid", "Stepped",
    "StoreUnreachable", "SweepSpec", "TooLarge", "Unanswered", "Unauthorized", "UnexpectedAnswer",
    "WaitTimeout",
]  # fmt: skip

#: The modules of the specifications' classes.
_SPECIFICATIONS: Final = {
    "SweepSpec": "worker.sweep",
    "Range": "worker.spec.axes",
    **dict.fromkeys(("Auto", "Ball", "Rigid", "Soft", "Stepped"), "worker.spec.contact_models"),
    **dict.fromkeys(("OnCycle", "Ramp", "Rest"), "worker.sweep.protocols"),
    "Refine": "worker.spec.refine",
}


def __getattr__(name: str) -> object:
    if name not in _SPECIFICATIONS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_SPECIFICATIONS[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
