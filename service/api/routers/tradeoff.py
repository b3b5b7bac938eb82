"""Speed against accuracy: every contact model and setting, measured by the workers when first asked for."""

from concurrent.futures import Future
from enum import StrEnum
from typing import Annotated, Final

from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, Field

from service.api import schemas
from service.api.dependencies import TheService
from service.api.pending import RESPONSES as PENDING
from service.api.schemas import problem_responses
from service.render import work_precision
from service.results.work_precision import advice
from worker.analysis import work_precision as measuring
from worker.analysis.work_precision import Measured
from worker.executors.base import Executor

router = APIRouter(prefix="/v1")


class Form(StrEnum):
    """What the answer comes as."""

    JSON = "json"
    PNG = "png"
    SVG = "svg"


class TradeoffQuery(schemas.Query):
    """Table or picture."""

    format: Form = Form.JSON


class Tradeoff(BaseModel):
    """Costs in core-µs a cell and plate period, errors in rad of flight time."""

    rows: list[Measured]
    cells: int = Field(description="of which errors count where the reference repeats")
    periods: int = Field(description="plate periods of each")
    micro_flight: float = Field(description="rad; shorter flights do not count")
    references: dict[str, str] = Field(description="what the errors of each purpose are measured from")
    advice: str


#: What each purpose's errors are measured from.
REFERENCES: Final = {
    "contact": "the exact soft contact, d = 1e-3, e = 0.01: this very contact is meant",
    "plate": "the exact soft contact, d = 1e-7, e = 0: a hard plate without rebound is meant",
}

_PICTURES: Final = {Form.PNG: "image/png", Form.SVG: "image/svg+xml"}


@router.get(
    "/tradeoff",
    response_model=Tradeoff,
    responses={
        200: {"content": {"image/png": {}, "image/svg+xml": {}}},
        **PENDING,
        **problem_responses(422, 429, 503),
    },
)
def tradeoff(service: TheService, query: Annotated[TradeoffQuery, Query()]) -> Response:
    """What each contact model costs and how far off it is, over a fixed set of cells, extremes among them.

    Measured once while the service runs, by a minute of computing: until then 202 with how far it is.
    """
    found = table(service.answers.get("tradeoff", _begin))
    if query.format is Form.JSON:
        return Response(found.model_dump_json(), media_type="application/json")
    return Response(work_precision.draw(found.rows, query.format), media_type=_PICTURES[query.format])


def table(rows: list[Measured]) -> Tradeoff:
    """The answer made of measurements."""
    return Tradeoff(
        rows=rows,
        cells=len(measuring.LINES) * measuring.CELLS_A_LINE,
        periods=measuring.SETTLE + measuring.OBSERVE,
        micro_flight=measuring.MICRO_FLIGHT,
        references=REFERENCES,
        advice=advice([row.model_dump() for row in rows]),
    )


def _begin(executor: Executor) -> list[Future[Measured]]:
    return [executor.call(measuring.measure, rung) for rung in measuring.RUNGS]
