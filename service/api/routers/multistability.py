"""Endpoint of multistability."""

from typing import Annotated

from fastapi import APIRouter, Query, Response

from service.api import dependencies, parameters, schemas
from service.api.capacity import costly
from service.api.conditional import NOT_MODIFIED, ConditionalRoute, ResultsJob
from service.api.dependencies import ServiceDep
from service.api.schemas import content, problem_responses
from service.formats import MEDIA_TYPES, PICTURES, TABLES
from service.jobs.model import JobRecord
from service.render import answers
from service.results.multistability import plane_memory

router = APIRouter(prefix="/v1/jobs/{job_id}", route_class=ConditionalRoute, tags=["results"])


def _plane_memory(service: ServiceDep, job: JobRecord, query: parameters.MultistabilityQuery) -> int:
    return plane_memory(dependencies.multistability(service, job))


@router.get(
    "/multistability",
    summary="Read attractors over a grid",
    response_model=schemas.MultistabilityView,
    responses={**content(*TABLES, *PICTURES), **NOT_MODIFIED, **problem_responses(404, 413, 422)},
)
@costly(_plane_memory)
def get_multistability(
    service: ServiceDep, job: ResultsJob, query: Annotated[parameters.MultistabilityQuery, Query()]
) -> Response:
    """The attractors of every cell at one xi, matched from cell to cell, and their births and deaths.

    Of a job with the protocol `multistability`. One attractor has one id in all cells; ids are numbered from
    1 by the number of cells. With `omega` only the line along gamma nearest to it, with the flights of every
    attractor. As a picture, the plane is two maps, of the number of attractors and of the one that most drops
    reach; a line is its flights, each attractor in its colour. As CSV, the plane has a row for each attractor
    of a cell, a line one for each flight.
    """
    answer = service.background.run(
        answers.multistability,
        dependencies.multistability(service, job), query.xi, query.omega, query.format,
    )  # fmt: skip
    headers = {"Bounce-Complete": "true" if answer.complete else "false"}
    return Response(answer.content, media_type=MEDIA_TYPES[query.format], headers=headers)
