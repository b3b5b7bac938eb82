"""How chunks that could not be computed are told."""

from collections.abc import Sequence

from pydantic import BaseModel, Field

from service.jobs.model import Failure


class FailureView(BaseModel):
    """A chunk that could not be computed, after so many tries."""

    chunk: int
    place: str = Field(description="its cells")
    error: str
    traceback: str | None = Field(description="null where a worker process died instead")
    tries: int


def failures_view(failures: Sequence[Failure]) -> list[FailureView]:
    """The failures of a job as its reader sees them."""
    return [FailureView(**failure._asdict()) for failure in failures]
