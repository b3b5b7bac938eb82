"""The answer to a request whose result workers are still computing: 202 with their progress."""

from typing import Any, Final, Literal

from fastapi import Request, Response
from pydantic import BaseModel

from service.jobs.on_demand import Pending

#: Seconds after which a caller should ask again.
RETRY_AFTER: Final = 1


class PartsView(BaseModel):
    """How far an answer is."""

    parts_done: int
    parts_total: int
    percent: float


class PendingView(BaseModel):
    """Workers are computing the answer: ask again after Retry-After."""

    state: Literal["running"] = "running"
    progress: PartsView


#: What the API document says of calls that may answer so.
RESPONSES: Final[dict[int | str, dict[str, Any]]] = {
    202: {"model": PendingView, "description": "Not computed yet: ask again after Retry-After"}
}


def underway(_: Request, error: Exception) -> Response:
    """202 with how far the workers are."""
    assert isinstance(error, Pending)  # as it is registered
    parts = PartsView(
        parts_done=error.done, parts_total=error.total, percent=round(100.0 * error.done / error.total, 1)
    )
    content = PendingView(progress=parts).model_dump_json()
    return Response(content, 202, {"Retry-After": str(RETRY_AFTER)}, "application/json")
